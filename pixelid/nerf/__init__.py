"""Reconstruction: a radiance field from events seen through the identified pixel (Low & Lee, arXiv 2409.17988).

`options` states what may be asked for, and `reconstruct` joins the rooms.  `data` reads a folder, `events` turns its
events into changes of light, `field` renders rays, `pixel` turns light into what a comparator sees, `training` compares
and steps, `effects` looks for what the pixel lacks, `shown` scores, keeps and renders.
"""
