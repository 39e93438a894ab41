"""This master with its communication loop in Python, everything recorded."""

from orchestration.bench.loops import ours
from orchestration.bench.pair import Pair


def run(pair: Pair, steps: int) -> float:
    return ours.run(pair, steps, compiled=False)
