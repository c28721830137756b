"""From chains of events to a trained scene: loss, steps, and what events held out decide."""
