"""Many runs of one scenario, with values from distributions or grids, on as many workers as there are."""
