"""Scenario files: those that ship, how one is read into a system and an experiment, and the paper's tables."""
