"""This master, everything recorded."""

from orchestration.master import Simulator
from tests.speed.pair import LEVEL, Pair


def run(pair: Pair, steps: int, compiled: bool = True) -> float:
    with Simulator(pair.system, compiled) as simulator:
        recording = simulator.run(pair.experiment(steps))
    return float(recording[f"first.{LEVEL}"][-1])
