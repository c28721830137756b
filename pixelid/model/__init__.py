"""Models: circuits as immutable values, read from and written to `models/*.toml`."""
