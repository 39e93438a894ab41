"""Parameters of a vehicle from logs of dives."""
