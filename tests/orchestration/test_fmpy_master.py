"""The master on FMPy gives the bits of the compiled loop; the scripts that show it run as they stand."""

import runpy
import shutil
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestration import Cosine, Experiment, Recording, System, Table, fmpy_master, load_scenario, simulate
from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.scenarios.scenario import shipped
from orchestration.system.experiment import Algorithm
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled
from tests.shared_builds import Build

GALLERY = Path(__file__).parents[2] / "docs" / "gallery"


def on_fmpy(system: System, experiment: Experiment, record: tuple[str, ...]) -> Recording:
    return fmpy_master.simulate(
        system.components,
        [(source, target) for source, target, *_ in system.connections],
        stop_time=experiment.stop_time,
        step_size=experiment.step_size,
        start_time=experiment.start_time,
        algorithm=Algorithm(experiment.algorithm).value,
        start_values={**experiment.parameters, **experiment.inputs},
        signals=experiment.signals,
        record=record,
    )


def assert_same_bits(system: System, experiment: Experiment) -> None:
    compiled = simulate(system, experiment)
    found = on_fmpy(system, experiment, compiled.names)
    assert found.units == compiled.units
    assert found.time.tobytes() == compiled.time.tobytes()
    assert found.values.tobytes() == compiled.values.tobytes()
    assert np.ptp(compiled.values, axis=0).any()


@pytest.mark.parametrize("steps", [100, pytest.param(None, marks=pytest.mark.slow, id="all")])
@pytest.mark.parametrize("name", shipped())
def test_shipped_scenarios_have_the_bits_of_the_compiled_loop(
    scenario_fmus: None, name: str, steps: int | None
) -> None:
    chosen = load_scenario(name)
    experiment = chosen.experiment
    if steps:
        experiment = replace(experiment, stop_time=experiment.start_time + steps * experiment.step_size)
    assert_same_bits(chosen.system, experiment)


@pytest.mark.slow
@given(
    algorithm=st.sampled_from(Algorithm),
    order=st.permutations(["one", "two", "three"]),
    step=st.sampled_from([0.05, 0.07]),
)
def test_other_systems_have_the_bits_of_the_compiled_loop(
    linear: Build, algorithm: Algorithm, order: list[str], step: float
) -> None:
    """Reals, Integers and Booleans on connections, in any order of the components; a last step is shorter."""
    fmus = dict.fromkeys(order, linear(a=-2.0, d=((0.1,),), passes_discrete=True))
    connections = (
        ("one.y[1]", "two.u[1]"),
        ("two.y[1]", "three.u[1]"),
        ("one.integer_out", "two.integer_in"),
        ("two.boolean_out", "one.boolean_in"),
    )
    inputs = {"one.integer_in": 7, "three.integer_in": -3, "two.boolean_in": True, "three.boolean_in": False}
    signals = {"one.u[1]": Cosine(1.0, 6.0)}
    experiment = Experiment(1.0, step, start_time=0.2, algorithm=algorithm, inputs=inputs, signals=signals)
    assert_same_bits(System(fmus, connections), experiment)


@pytest.mark.slow
def test_arrays_of_fmi_3_have_elements(
    built: Mapping[str, Path], fmi3_built: Mapping[str, Path], scenario_fmus: None
) -> None:
    """The voltages of the paper's loop are arrays there."""
    chosen = load_scenario("nominal-extended")
    names = {name: Path(path).stem for name, path in chosen.system.components.items()}
    system = System({name: fmi3_built[block] for name, block in names.items()}, chosen.system.connections)
    experiment = replace(chosen.experiment, stop_time=10.0)
    expected = simulate(chosen.system, experiment)
    assert on_fmpy(system, experiment, expected.names).values.tobytes() == expected.values.tobytes()


def test_the_paper_s_loop_on_fmpy_alone_is_that_of_the_scenario(
    built: Mapping[str, Path], scenario_fmus: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmus_of_a_build(built, tmp_path, monkeypatch)
    depth = runpy.run_path(str(GALLERY / "fmpy_master.py"))["depth"]
    chosen = load_scenario("nominal-extended")
    # the same lines by NumPy's `interp`, which rounds otherwise than `Ramps`
    lines = Table([0.0, 40.0, 140.0, 180.0, 250.0, 310.0], [0.0, 0.8, 0.8, 0.4, 0.4, 0.6])
    experiment = replace(chosen.experiment, signals={"controller.depth_reference": lines})
    assert depth.tobytes() == simulate(chosen.system, experiment)["plant.depth"].tobytes()


def test_a_scenario_file_runs_on_fmpy(
    built: Mapping[str, Path], scenario_fmus: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmus_of_a_build(built, tmp_path, monkeypatch)
    script = runpy.run_path(str(GALLERY / "fmpy_scenario.py"))
    recording = script["recording"]
    chosen = load_scenario("nominal-extended")
    assert recording.values.tobytes() == simulate(chosen.system, chosen.experiment).values.tobytes()
    for name, path in shipped().items():
        if name == "heave-pitch":  # replaces both components
            with pytest.raises(NotImplementedError, match="replaces components"):
                script["tables"](path)
            continue
        loaded = load_scenario(name)
        tables, names = script["tables"](path), {*loaded.prepared.system.ports}
        connections = {
            (source, target) for target, source in script["joined"](tables, names)["connections"].items()
        }
        assert connections == {*loaded.system.connections}, name


def fmus_of_a_build(built: Mapping[str, Path], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Goes to a folder with the FMUs that `l1-depth build L1DepthController RovDepthPlant` writes."""
    (folder / "fmus-built").mkdir()
    for name in ("L1DepthController", "RovDepthPlant"):
        shutil.copy(built[name], folder / "fmus-built")
    monkeypatch.chdir(folder)
    mpl.use("agg")


def test_an_unknown_name_is_refused_with_the_nearest(linear: Build, temporary: Path) -> None:
    with pytest.raises(SystemDefinitionError, match=r"no variable 'one\.Y\[1\]'; nearest is 'one\.y\[1\]'"):
        fmpy_master.simulate({"one": linear()}, stop_time=1.0, step_size=0.1, record=["one.Y[1]"])
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "Jacobi"}, "algorithm 'Jacobi': expected 'jacobi' or 'gauss-seidel'"),
        (
            {"connections": [("a.y[1]", "b.u[1]"), ("b.y[1]", "b.u[1]")]},
            r"b\.u\[1\]: expected one connection",
        ),
        (
            {"connections": [("a.y[1]", "b.u[1]")], "signals": {"b.u[1]": Cosine(1.0, 6.0)}},
            "or one signal, got",
        ),
        ({"start_values": {"a.integer_in": 2.7}}, r"a\.integer_in = 2\.7: expected a value of type Integer"),
        (
            {"connections": [("a.y[1]", "b.integer_in")], "start_values": {"a.u[1]": 0.3}},
            r"b\.integer_in = 1\.03: expected",
        ),
    ],
)
def test_what_would_run_otherwise_than_stated_is_refused(
    linear: Build, changes: dict[str, Any], message: str
) -> None:
    fmus = dict.fromkeys("ab", linear(a=-2.0, d=((0.1,),), passes_discrete=True))
    with pytest.raises(SystemDefinitionError, match=message):
        fmpy_master.simulate(fmus, stop_time=1.0, step_size=0.1, record=["b.y[1]"], **changes)


def test_strings_go_over_connections(foreign: Mapping[str, Path]) -> None:
    experiment = Experiment(0.4, 0.1, inputs={"one.entry": "Tuesday ä"}, record=("one.length", "two.length"))
    fmus = {"one": foreign["Diary"], "two": foreign["Diary"]}
    assert_same_bits(System(fmus, (("one.page", "two.entry"),)), experiment)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_signal_reaches_the_end_of_a_chain_before_the_first_step(linear: Build, count: int) -> None:
    names = [f"c{number}" for number in range(count)]
    connections = [(f"{a}.y[1]", f"{b}.u[1]") for a, b in pairwise(names)]
    experiment = Experiment(0.2, 0.1, signals={"c0.u[1]": Cosine(1.0, 6.0)})
    # the order against the chain: each pass carries values over one connection
    system = System(dict.fromkeys(reversed(names), linear(a=-2.0, d=((0.5,),))), connections)
    assert_same_bits(system, experiment)


def test_initial_values_that_do_not_settle_are_an_error(linear: Build, temporary: Path) -> None:
    system = coupled(linear, through=2.0)
    with pytest.raises(OrchestrationError, match="initial values do not settle"):
        on_fmpy(system, Experiment(1.0, 0.1), ("one.y[1]",))
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("misdeed", "message"),
    [
        (Misdeed.NAN_OUTPUT, r"good\.u\[1\]: expected a finite number, bad\.y is nan"),
        (Misdeed.ERROR, "fmi2DoStep failed with status 3"),
    ],
)
def test_a_failure_is_an_error_and_leaves_nothing(
    rogue: Build, linear: Build, misdeed: Misdeed, message: str, temporary: Path
) -> None:
    system = System({"bad": rogue(), "good": linear()}, (("bad.y", "good.u[1]"), ("good.y[1]", "bad.u")))
    parameters = {"bad.misdeed": int(misdeed), "bad.misdeed_time": 0.5}
    with pytest.raises(Exception, match=message):
        on_fmpy(system, Experiment(1.0, 0.1, parameters=parameters), ("bad.y",))
    assert not list(temporary.iterdir())
