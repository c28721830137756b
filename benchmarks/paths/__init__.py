"""The paths that `benchmarks/speed.py` measures, a file per section."""
