"""Accept: whether the leading effect stands beside a flexible alternative, and the state that it leads to."""
