"""Undo what a readout did to event times: queue, tick, jitter; times behind them are imputed under the model."""
