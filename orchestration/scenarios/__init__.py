"""Scenario files: those that ship, how one becomes a system and an experiment, and the paper's tables."""
