"""Values as FMUs take them: items of enumerations by name and by number, and start values of open inputs."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.files import write_archive
from orchestration.errors import SystemDefinitionError
from orchestration.run.run_recording import make_recording
from orchestration.sweep.varied import target
from orchestration.system.experiment import Event, Experiment
from orchestration.system.prepared_run import check_for, prepare, prepare_checked
from orchestration.system.signals import Constant, Ramps, Signal, Table
from orchestration.system.system import System
from orchestration.system.values import fmi_value, possible_values
from tests.described_fmus import XML

ITEMS = {"reverse": -2, "astern": -1, "off": 0, "slow": 1, "fast": 2, "far": 5_000_000_000}
TEXT = """
<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="g"><CoSimulation modelIdentifier="m"/>
<TypeDefinitions><EnumerationType name="Mode">{items}</EnumerationType></TypeDefinitions>
<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>
"""


def system(path: Path, *variables: str) -> System:
    """A system of one FMU, a model description of FMI 3.0 with these variables."""
    items = "".join(f'<Item name="{name}" value="{number}"/>' for name, number in ITEMS.items())
    numbered = (v.replace(" ", f' valueReference="{i}" ', 1) for i, v in enumerate(variables))
    text = TEXT.format(items=items, variables="".join(numbered))
    path.mkdir(exist_ok=True)
    return System({"m": write_archive(path / "m.fmu", {XML: text.encode()})})


def modes(path: Path) -> System:
    """An input, a parameter and one without limits, of an enumeration."""
    declared = 'declaredType="Mode" start="0"'
    limited = f'{declared} min="-1" max="1"'
    return system(
        path,
        f'<Enumeration name="u" causality="input" {limited}/>',
        f'<Enumeration name="p" causality="parameter" variability="tunable" {limited}/>',
        f'<Enumeration name="free" causality="input" {declared}/>',
    )


def set_by(kind: str, name: str, value: Any) -> Experiment:
    """An experiment that sets a variable in one of several ways."""
    values = {name: value}
    settings: dict[str, Any] = {kind: (Event(0.5, values),) if kind == "events" else values}
    return Experiment(1.0, 0.5, open_inputs="start", **settings)


@pytest.mark.parametrize(("kind", "name"), [("inputs", "u"), ("parameters", "p"), ("events", "p")])
@pytest.mark.parametrize("item", ["reverse", "fast", "far"])
def test_an_item_out_of_range_is_refused_by_name_and_by_number(
    tmp_path: Path, kind: str, name: str, item: str
) -> None:
    loop = modes(tmp_path)
    for value in (item, ITEMS[item]):
        message = rf"m.{name} = {value!r}: expected one of astern \(-1\), off \(0\), slow \(1\)$"
        with pytest.raises(SystemDefinitionError, match=message):
            prepare(loop, set_by(kind, f"m.{name}", value))


@pytest.mark.parametrize("item", ["astern", "off", "slow"])
def test_an_item_by_name_is_its_number(tmp_path: Path, item: str) -> None:
    loop = modes(tmp_path)
    prepared = prepare(loop, Experiment(1.0, 0.5, inputs={"m.u": item}, open_inputs="start"))
    assert {port.name: value for port, value in prepared.settings}["m.u"] == ITEMS[item]


def test_an_item_wider_than_the_masters_integers_is_refused_without_limits_too(tmp_path: Path) -> None:
    free = check_for(modes(tmp_path), Experiment(1.0, 0.5, open_inputs="start")).ports["m.free"]
    assert [fmi_value(free, name) for name in ("astern", "fast")] == [-1, 2]
    with pytest.raises(
        SystemDefinitionError, match=r"m.free = 'far': expected one of reverse \(-2\), .*, fast \(2\)$"
    ):
        fmi_value(free, "far")
    with pytest.raises(SystemDefinitionError, match=r"m.free = -9: expected one of reverse \(-2\), "):
        fmi_value(free, -9)
    expected, possible = possible_values(free, np.array([-2.0, 2.0, -9.0, 0.5]))
    assert expected.startswith("one of reverse (-2), ")
    assert possible.tolist() == [True, True, False, False]


def test_a_sweep_checks_items_by_name(tmp_path: Path) -> None:
    experiment = Experiment(1.0, 0.5, inputs={"m.u": 0}, open_inputs="start")
    swept = target("m.u", check_for(modes(tmp_path), experiment), experiment)
    assert [swept.checked(value) for value in ("slow", -1)] == ["slow", "astern"]
    with pytest.raises(
        SystemDefinitionError, match=r"m.u = 'fast': expected one of astern \(-1\), off \(0\), slow \(1\)$"
    ):
        swept.checked("fast")


def test_an_input_that_the_caller_sets_checks_items_by_name(tmp_path: Path) -> None:
    loop = modes(tmp_path)
    outside = Experiment(1.0, 0.5, inputs={"m.u": "fast"}, open_inputs="start")
    with pytest.raises(
        SystemDefinitionError, match=r"m.u = 'fast': expected one of astern \(-1\), off \(0\), slow \(1\)$"
    ):
        prepare_checked(check_for(loop, outside, ["m.u"]), outside, ["m.u"])


def test_an_open_input_starts_at_what_the_fmu_states(tmp_path: Path) -> None:
    """Also where it is not finite: JSON, which has no such number, holds its name."""
    starts = {"above": "INF", "below": "-INF", "unknown": "NaN", "plain": "-2.5"}
    loop = system(
        tmp_path,
        *(f'<Float64 name="{name}" causality="input" start="{text}"/>' for name, text in starts.items()),
        '<Float64 name="y" causality="output"/>',
    )
    experiment = Experiment(1.0, 0.5, open_inputs="start")
    prepared = prepare(loop, experiment)
    values = {port.variable.name: value for port, value in prepared.settings}
    np.testing.assert_equal(
        values, {"above": math.inf, "below": -math.inf, "unknown": math.nan, "plain": -2.5}
    )
    led = prepare_checked(check_for(loop, experiment, ["m.below"]), experiment, ["m.below"])
    assert led.external == {"m.below": -math.inf}
    provenance = make_recording(prepared, np.zeros((3, 1)), 3).provenance
    assert json.loads(json.dumps(provenance, allow_nan=False))["open_inputs"] == {
        "m.above": "inf", "m.below": "-inf", "m.unknown": "nan", "m.plain": -2.5
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["inputs", "parameters"])
def test_what_is_set_is_finite(tmp_path: Path, kind: str) -> None:
    causality = kind.removesuffix("s")
    loop = system(tmp_path, f'<Float64 name="x" causality="{causality}" start="INF"/>')
    for value in (math.inf, -math.inf, math.nan):
        with pytest.raises(SystemDefinitionError, match=f"m.x = {value}: expected a finite number"):
            prepare(loop, set_by(kind, "m.x", value))


def test_an_open_input_out_of_its_range_is_refused(tmp_path: Path) -> None:
    loop = system(tmp_path, '<Int8 name="n" causality="input" start="-129"/>')
    with pytest.raises(SystemDefinitionError, match=r"m.n = -129: expected -128 to 127"):
        prepare(loop, Experiment(1.0, 0.5, open_inputs="start"))


@pytest.mark.parametrize("value", [1e-300, -1e-46, 1e300])
def test_a_number_that_single_precision_cannot_hold_is_refused(tmp_path: Path, value: float) -> None:
    """It would arrive as 0 or as infinity; 0.1, which is rounded, is held."""
    loop = system(tmp_path, '<Float32 name="x" causality="parameter"/><Float64 name="z" valueReference="9"/>')
    prepare(loop, set_by("parameters", "m.x", 0.1))
    with pytest.raises(SystemDefinitionError, match=re.escape(f"m.x = {value!r}: expected 0, or 1.4e-45..")):
        prepare(loop, set_by("parameters", "m.x", value))


@pytest.mark.parametrize("signal", [Ramps([[0.0, 0.1], [1.0, 0.7]]), Table([0.0, 1.0], [0.1, 0.7])])
def test_a_signal_stays_within_the_range_of_its_input_but_for_rounding(
    tmp_path: Path, signal: Signal
) -> None:
    loops = [
        system(tmp_path / name, f'<Float64 name="u" causality="input" unit="m" start="0.1" max="{name}"/>')
        for name in ("0.7", "0.4")
    ]
    experiment = Experiment(1.0, 0.25, signals={"m.u": signal})
    assert prepare(loops[0], experiment).signal_values[0, -1] == pytest.approx(0.7, rel=1e-15)  # rounding
    with pytest.raises(
        SystemDefinitionError, match=r"signal m.u is 0.55 at t = 0.75 s: expected at most 0.4 m$"
    ):
        _ = prepare(loops[1], experiment).signal_values
    barely = Experiment(1.0, 0.25, signals={"m.u": Constant(0.40000001)})
    with pytest.raises(
        SystemDefinitionError, match=r"signal m.u is 0.40000001 at t = 0 s: expected at most 0.4"
    ):
        _ = prepare(loops[1], barely).signal_values
