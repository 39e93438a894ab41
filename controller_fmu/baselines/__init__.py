"""Baselines: the depth controllers that the L1 law is compared with, on its interface."""
