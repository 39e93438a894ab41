"""Other people's importers, each running an SSP package of this project, in a file of its own.

Each has `run(job) -> Trajectory`; `comparison.py` starts them in processes of their own.
"""
