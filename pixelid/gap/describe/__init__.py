"""Describe: what no effect of the library explains, as an equation."""
