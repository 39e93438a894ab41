"""Delay and gain margins, from the design of a controller and from runs of its FMUs."""
