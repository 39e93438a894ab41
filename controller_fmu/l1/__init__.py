"""L1 adaptive control, plain and extended: the law and its three blocks."""
