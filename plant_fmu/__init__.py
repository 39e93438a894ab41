"""Plants: underwater vehicles with thrusters and depth sensor, their waves, and the paper's example."""
