"""Statistics that more than one folder needs."""

Z95 = 1.959963984540054  # half of a 95 % interval of a normal coordinate, in standard deviations
