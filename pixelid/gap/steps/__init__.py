"""The steps of a search: each takes its state and gives the next one, the last the report."""
