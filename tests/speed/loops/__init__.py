"""The pair in one importer each: `run(pair, steps)` gives the first level after so many steps.

Each does it as its importer's documentation says, with what that offers to be fast, and records only if it
cannot do without. `worker.py` measures one of them.
"""
