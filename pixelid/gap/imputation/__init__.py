"""Impute event times behind a queue, a tick or a jitter, under the model."""
