"""The plants: the underwater vehicle with thrusters and depth sensor, and the paper's example."""
