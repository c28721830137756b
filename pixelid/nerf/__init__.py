"""Reconstruction: a radiance field from events seen through the identified pixel (Low & Lee, arXiv 2409.17988)."""
