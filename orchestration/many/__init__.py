"""All ways to run many runs of one system: in this process, in vectors, in processes, on a cluster."""
