"""FMI 3.0 in the master: the recordings of FMI 2.0, also mixed with it, and others' arrays and types."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fmus.fmi.description import describe
from orchestration.many.ensemble import Ensemble
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.run.loop_data import LoopFunctions, Wiring
from orchestration.scenarios import scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.shared_builds import Fmus

CONTROLLER, PLANT = "L1DepthController", "RovDepthPlant"


@pytest.fixture(scope="module")
def dives(built: Fmus, fmi3_built: Fmus, scenario_fmus: None) -> Any:
    """The nominal dive with a controller and a plant, each of FMI 2.0 or of FMI 3.0."""
    of_version = {2: built, 3: fmi3_built}

    def load(controller: int, plant: int, name: str = "nominal-extended") -> tuple[System, Experiment]:
        fmus = {
            "controller": str(of_version[controller][CONTROLLER]),
            "plant": str(of_version[plant][PLANT]),
        }
        chosen = scenario.load(scenario.find(name), settings=fmus)
        components = chosen.system.components
        assert describe(components["controller"]).fmiVersion == f"{controller}.0"
        assert describe(components["plant"]).fmiVersion == f"{plant}.0"
        return chosen.system, chosen.experiment

    return load


def run(system: System, experiment: Experiment, **options: Any) -> Recording:
    with Simulator(system, **options) as simulator:
        return simulator.run(experiment)


@pytest.mark.parametrize("versions", [(3, 2), (2, 3), (3, 3)])
@pytest.mark.parametrize("name", ["nominal-extended", "nominal-extended-smooth"])
def test_a_dive_is_that_of_fmi_2_bit_for_bit(dives: Any, versions: tuple[int, int], name: str) -> None:
    old, new = run(*dives(2, 2, name)), run(*dives(*versions, name))
    assert old.names == new.names
    assert np.array_equal(old.time, new.time)
    assert np.array_equal(old.values, new.values)
    assert np.ptp(new["plant.depth"]) > 0.2  # m: it dives


def test_the_loop_is_the_compiled_one_and_agrees_with_that_in_python(
    dives: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from orchestration.run import compiled_loop, simulator

    ran = []

    def counted(wiring: Wiring) -> LoopFunctions:
        functions = compiled_loop.compiled_loop(wiring)
        ran.append(functions.run)
        return functions

    monkeypatch.setattr(simulator, "compiled_loop", counted)
    system, experiment = dives(3, 3)
    short = replace(experiment, stop_time=5.0)
    compiled, plain = run(system, short), run(system, short, compiled=False)
    assert ran[0].func is compiled_loop.library().loop_run
    assert len(ran) == 1
    assert np.array_equal(compiled.values, plain.values)


def test_vectors_have_the_bits_of_single_runs(dives: Any) -> None:
    system, experiment = dives(3, 3)
    short = replace(experiment, stop_time=5.0, record=("plant.depth",))
    runs = [
        replace(short, parameters={**short.parameters, "plant.net_weight": w}) for w in (-1.0, -2.0, -3.0)
    ]
    with Ensemble(system) as ensemble, Simulator(system) as simulator:
        together = ensemble.run(runs)
        alone = [simulator.run(one).values for one in runs]
    assert np.array_equal(together.values, np.array(alone))
    assert len(np.unique(together.values[:, -1])) == len(runs)
