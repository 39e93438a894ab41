"""Components, connections, experiment, signals and faults: all that is run, checked."""
