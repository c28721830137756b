"""From a folder of raw recordings to a model one can trust: read, align, fit, search, fit again, say what is next."""
