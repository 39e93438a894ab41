"""All ways to run many runs of one system on this machine: one by one, in vectors, in processes."""
