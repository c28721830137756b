"""The whole story on embedded data."""
