"""Proof that a step of a block has no run-time error, by Frama-C: a satellite with the command `prove`."""
