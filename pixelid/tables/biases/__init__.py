"""Tables of a quantity against the codes of one bias or two: dead times, thresholds, cutoffs, latencies."""
