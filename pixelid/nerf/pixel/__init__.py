"""The pixel that training assumes: its filter over samples of light, its thresholds, how pixels differ."""
