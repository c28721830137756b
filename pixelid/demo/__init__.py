"""A bench session that comes with the package, and how its calibration compares with what was hidden in it."""
