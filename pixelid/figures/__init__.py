"""How figures look: one style for all of them (`style.py`).  What they show is drawn in each folder's `figures.py`."""
