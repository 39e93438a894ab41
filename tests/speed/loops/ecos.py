"""Ecos, all steps asked for at once."""

from ecospy.EcosSimulation import EcosSimulation

from tests.speed.pair import LEVEL, STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    with EcosSimulation(ssp_path=str(pair.package), step_size=STEP_SIZE) as simulation:
        if not simulation.init():
            raise RuntimeError("the initialisation failed")
        simulation.step(steps)
        return simulation.get_real(f"first::{LEVEL}")
