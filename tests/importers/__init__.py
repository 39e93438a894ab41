"""Other people's importers, each running an SSP package of ours: one small file an importer.

Each has `run(job) -> Trajectory`; `comparison.py` starts them in processes of their own.
"""
