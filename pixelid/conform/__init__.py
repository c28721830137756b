"""The gap's verdict on a simulator or a camera, effect by effect, as a table for its maintainers."""
