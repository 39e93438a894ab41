"""What to run: components, connections, experiment, signals, faults."""
