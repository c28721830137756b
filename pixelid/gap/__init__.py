"""The gap: where simulation and measurement disagree, which effect is missing, and whether adding it closes the gap."""
