"""This master with its communication loop in Python, everything recorded."""

from tests.speed.loops import ours
from tests.speed.pair import Pair


def run(pair: Pair, steps: int) -> float:
    return ours.run(pair, steps, compiled=False)
