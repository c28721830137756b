"""Shot noise, which no density of single events knows, told by simulated replicates."""
