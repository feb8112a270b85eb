"""Which runs a sweep consists of: the draws, the design matrix, and the checks before it starts."""
