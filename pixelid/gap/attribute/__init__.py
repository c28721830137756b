"""Attribute: what each missing effect would gain, and whether the leading one may be named."""
