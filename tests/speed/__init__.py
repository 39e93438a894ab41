"""Measures how fast the project is: the tables of the pages performance and scale.

    python -m tests.speed --before 7cf1486 --out docs/performance.json

parts.py lists what is measured, row by row; states.py runs it in this state of the project and in an earlier
one, by turns; inside.py holds the measurements that need Python in the state itself.
"""
