"""Do the tests notice a mistake? `python -m tests.mutation` makes small ones and counts those they notice."""
