"""Statistics that more than one folder needs."""

Z95 = 1.959963984540054  # half of a 95 % interval of a normal coordinate, in standard deviations
DROP_NATS = 1.9207  # of a profile log-likelihood at its 95 % limits: χ²₁(0.95)/2
SD_PER_MEDIAN = 1.4826  # standard deviation of a normal x per median of |x|: what outliers do not move
