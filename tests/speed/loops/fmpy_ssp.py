"""FMPy's SSP master, which records every connector."""

from fmpy.ssp.simulation import simulate_ssp

from tests.speed.pair import LEVEL, STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    result = simulate_ssp(str(pair.package), 0.0, steps * STEP_SIZE, STEP_SIZE)
    return float(result[f"first.{LEVEL}"][-1])
