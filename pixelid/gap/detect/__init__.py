"""Detect: residuals of every event under a fitted model, and maps of where they leave zero."""
