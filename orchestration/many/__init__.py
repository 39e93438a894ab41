"""Many runs of one system on this machine, one by one, in vectors or in processes; places by name."""
