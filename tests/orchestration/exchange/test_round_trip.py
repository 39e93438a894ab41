"""A random system, also with systems in it, is the same after it was written as a package and read again."""

from pathlib import Path
from typing import Any

import pytest
from fmpy.ssp.ssd import read_ssd
from hypothesis import given
from hypothesis import strategies as st

from fmus.fmi.description import describe
from orchestration.exchange import ssp_read, ssp_write
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import LinearTransformation, System
from tests.described_fmus import described

FINITE = st.floats(-1e9, 1e9).filter(bool)
UNITS = {"length": "m", "small length": "mm", "plain": ""}
NAMES = st.sampled_from(["a", "b", "größe 1"])


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """FMUs with inputs u and v.w[1], outputs y and z.w[1] in one unit, and parameters; by kind."""
    folder = tmp_path_factory.mktemp("described")
    signals = ["u", "v.w[1]"], ["y", "z.w[1]"]
    return {
        kind: described(
            folder / f"{kind} #1.fmu",
            *signals,
            ["k", "n:Integer"],
            {n: unit for names in signals for n in names if unit},
        )
        for kind, unit in UNITS.items()
    }


def interface(fmu: Path) -> list[tuple[Any, ...]]:
    return [(v.name, v.type, v.causality, v.unit, v.start) for v in describe(fmu).modelVariables]


@st.composite
def paths(draw: st.DrawFn) -> list[str]:
    """Names of components, none of which is the name of a system."""
    found = draw(st.lists(st.lists(NAMES, min_size=1, max_size=3).map(".".join), min_size=1, max_size=5))
    return [name for name in dict.fromkeys(found) if not any(other.startswith(f"{name}.") for other in found)]


@given(data=st.data())
def test_what_is_written_is_read_as_the_same_system(
    fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    kinds = {name: data.draw(st.sampled_from(list(UNITS))) for name in data.draw(paths())}
    connections: list[tuple[Any, ...]] = []
    inputs: dict[str, float] = {}
    for target in [f"{name}.{variable}" for name in kinds for variable in ("u", "v.w[1]")]:
        source = data.draw(st.sampled_from([None, *(f"{n}.{v}" for n in kinds for v in ("y", "z.w[1]"))]))
        if source is None:
            inputs[target] = data.draw(FINITE)
            continue
        ends = [next(kinds[n] for n in kinds if end.startswith(f"{n}.")) for end in (source, target)]
        change = data.draw(st.none() | st.builds(LinearTransformation, FINITE, FINITE))
        if change is None and ends[0] != ends[1]:  # mm to m: without a factor our master refuses it
            change = LinearTransformation(2.0)
        connections.append((source, target, *([] if change is None else [change])))
    parameters = {
        f"{name}.{variable}": value
        for name in kinds
        for variable, values in (("k", FINITE), ("n", st.integers(-9, 9)))
        if (value := data.draw(st.none() | values)) is not None
    }
    start, step = data.draw(st.integers(-3, 3)), data.draw(st.sampled_from([0.5, 0.1, 1e-3]))
    given_values: dict[str, Any] = {"parameters": parameters, "inputs": inputs, "open_inputs": "start"}
    experiment = Experiment(start + 100 * step, step, start, **given_values)
    system = System({name: fmus[kind] for name, kind in kinds.items()}, connections)
    mine = Scenario("mine", "", system, experiment, {})
    path = tmp_path_factory.mktemp("package") / "mine.ssp"
    ssp_write.package(mine, path, lambda source, folder: folder)
    assert read_ssd(str(path)).system  # by the schemas that FMPy ships
    with ssp_read.opened(path) as loop:
        for name, fmu in system.components.items():
            assert interface(loop.system.components[name]) == interface(fmu)
        assert loop.system.components.keys() == system.components.keys()
        assert sorted(loop.system.connections, key=str) == sorted(connections, key=str)
        assert (loop.experiment.parameters, loop.experiment.inputs) == (parameters, inputs)
        times = ("start_time", "stop_time", "step_size")
        assert [getattr(loop.experiment, n) for n in times] == [getattr(experiment, n) for n in times]
