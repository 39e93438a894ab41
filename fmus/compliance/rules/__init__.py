"""Rules of the checker: each is one decorated function."""
