"""What a pixel may have beyond what is stated: what training can add, and the search for it in the events."""
