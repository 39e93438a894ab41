"""A block -> an FMU: traced, described, written as C or Python, compiled, packed."""
