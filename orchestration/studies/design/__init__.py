"""Gains of controllers from the data of a vehicle and their ranges, checked by runs over the ranges."""
