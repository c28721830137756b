"""A result folder as one self-contained page."""
