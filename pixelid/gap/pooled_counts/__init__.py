"""The gap of pooled recordings, whose events have no pixels."""
