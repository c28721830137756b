"""Confirm: the free-run gap on pixels that nothing has looked at, and the intervals of what was named."""
