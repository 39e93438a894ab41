"""Two FMUs compared: `l1-depth diff`."""
