"""Mutants of FMUs: each breaks one sentence of FMI 2.0.5.

`python -m tests.mutants` prints which rules find them.
"""
