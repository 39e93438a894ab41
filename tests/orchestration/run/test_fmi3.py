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
from tests.shared_builds import Build, Fmus

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


# FMUs of others: arrays with value references of their own, and every type

MATRIX = "[1,1] 1.5 [1,2] 2.5 [1,3] 3.5 [2,1] 4.5 [2,2] 5.5 [2,3] 6.5"
EVERYTHING = {
    "matrix": ("Float64", MATRIX),
    "single": ("Float32", "[1] 0.25 [2] 0.5"),
    "level": ("Float64", "7.5"),
    "i8": ("Int8", "-3"),
    "u8": ("UInt8", "200"),
    "i16": ("Int16", "[1] -300 [2] 300"),
    "u16": ("UInt16", "60000"),
    "i32": ("Int32", "-70000"),
    "u32": ("UInt32", "70000"),
    "i64": ("Int64", "-70001"),
    "u64": ("UInt64", "70001"),
    "flag": ("Boolean", "[1] 1 [2] 0"),
    "misdeed": ("Enumeration", "3"),
    "text": ("String", "[1] one [2] two"),
    "word": ("String", "three"),
}


@pytest.fixture(scope="module")
def everything(mirror: Build) -> System:
    return System({"m": mirror(EVERYTHING, saves_state=True, serialises_state=True)})


def mirrored(system: System, inputs: dict[str, Any], compiled: bool = True) -> dict[str, list[Any]]:
    """What comes out of the mirror in two steps, by name."""
    names = [
        name for name in Simulator(system)._descriptions["m"].modelVariables if name.causality == "output"
    ]
    record = tuple(f"m.{v.name}" for v in names)
    experiment = Experiment(0.2, 0.1, inputs=inputs, open_inputs="start", record=record)
    recording = run(system, experiment, compiled=compiled)
    return {name: recording[f"m.{name}"].tolist() for name in (v.name for v in names)}


def test_arrays_are_scalars_row_by_row_with_their_start_values(everything: System, compiled: bool) -> None:
    values = mirrored(everything, {}, compiled)
    starts = {
        f"{name}_out{index}": start
        for name, (_, text) in EVERYTHING.items()
        for index, start in zip(
            text.split()[::2] if text[0] == "[" else [""], text.split()[1::2] or [text], strict=True
        )
    }
    assert {name: str(of_name[-1]) for name, of_name in values.items()} == {
        name: start if name.startswith(("text", "word")) else str(float(start))
        for name, start in starts.items()
    }


def test_each_scalar_of_an_array_is_set_alone(everything: System, compiled: bool) -> None:
    """One in the middle, the others keep what they have; strings too."""
    inputs = {"m.matrix_in[1,3]": -1.0, "m.i16_in[2]": -2, "m.flag_in[2]": True, "m.text_in[1]": "new"}
    default, changed = mirrored(everything, {}, compiled), mirrored(everything, inputs, compiled)
    different = {name for name in changed if changed[name] != default[name]}
    assert different == {"matrix_out[1,3]", "i16_out[2]", "flag_out[2]", "text_out[1]"}
    assert changed["matrix_out[1,3]"] == [-1.0] * 3
    assert changed["text_out[1]"] == ["new"] * 3
