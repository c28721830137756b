"""Numbers that decide in the search for effects, apart from what it takes to run it."""

ALPHA = 0.01  # of naming anything that is not there, all candidates together
# Of the loss of held-out events; less is explained by what a coarse scene gets wrong (at most 0.5 % in clean cameras)
LEAST_SHARE = 0.01
