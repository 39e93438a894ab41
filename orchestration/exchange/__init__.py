"""Scenarios for other tools: SSP packages, written and read."""
