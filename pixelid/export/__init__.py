"""A circuit in the parameters of other simulators, and what each of them cannot express."""
