"""FMI 3.0 in the master: the recordings of FMI 2.0, also mixed with it, and others' arrays and types."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from fmus.fmi.description import describe, of_causality
from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuError, FmuWarning, SimulationError, SystemDefinitionError
from orchestration.many.ensemble import Ensemble
from orchestration.results.recording import Recording
from orchestration.run import Simulator, compiled_loop, simulate
from orchestration.run.loop_data import LoopFunctions, Wiring
from orchestration.scenarios import scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.signals import Cosine, Ramps
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import LOOP
from tests.orchestration.many import instances as ensembles
from tests.orchestration.python_loop import LoopInPython
from tests.orchestration.rogue_systems import doing, run
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build, Fmus

CONTROLLER, PLANT = "L1DepthController", "RovDepthPlant"
DIVE_S = 15.0


@pytest.fixture(scope="module")
def dives(built: Fmus, fmi3_built: Fmus, vehicle_fmus: None) -> Any:
    """The nominal dive with a controller and a plant, each of FMI 2.0 or of FMI 3.0."""
    of_version = {2: built, 3: fmi3_built}

    def load(controller: int, plant: int, name: str = "nominal-extended") -> tuple[System, Experiment]:
        fmus = {"controller": of_version[controller][CONTROLLER], "plant": of_version[plant][PLANT]}
        settings = {component: str(path) for component, path in fmus.items()}
        chosen = scenario.load(scenario.find(name), settings=settings)
        versions = [describe(chosen.system.components[component]).fmiVersion for component in fmus]
        assert versions == [f"{controller}.0", f"{plant}.0"]
        return chosen.system, replace(chosen.experiment, stop_time=DIVE_S)

    return load


@pytest.mark.parametrize("name", ["nominal-extended", "nominal-extended-smooth"])
def test_a_dive_is_that_of_fmi_2_bit_for_bit(dives: Any, name: str) -> None:
    old = run(*dives(2, 2, name))
    assert np.ptp(old["plant.depth"]) > 0.05  # m: it dives
    for versions in ((3, 2), (2, 3), (3, 3)):
        assert_same_bits(run(*dives(*versions, name)), old)


def test_the_loop_is_the_compiled_one_and_agrees_with_that_in_python(
    dives: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[Any] = []

    def counted(wiring: Wiring) -> LoopFunctions:
        functions = compiled_loop.compiled_loop(wiring)
        ran.append(functions.run)
        return functions

    monkeypatch.setattr(Simulator, "_loop", staticmethod(counted))
    system, experiment = dives(3, 3)
    with LoopInPython(system) as plain:
        assert_same_bits(run(system, experiment), plain.run(experiment))
    assert [function.func for function in ran] == [compiled_loop.library().loop_run]


def test_vectors_have_the_bits_of_single_runs(dives: Any) -> None:
    system, experiment = dives(3, 3)
    weights = {"plant.net_weight": [-1.0, -2.0, -3.0]}
    experiments = ensembles.instances(replace(experiment, record=("plant.depth",)), weights)
    with Ensemble(system) as ensemble, Simulator(system) as alone:
        together = ensemble.run(experiments)
        ensembles.assert_same_bits(together, alone, experiments)
    assert len(np.unique(together.values[:, -1])) == len(experiments)


# FMUs of others: arrays with value references of their own, and every type

EVERYTHING = {
    "matrix": ("Float64", "[1,1] 1.5 [1,2] 2.5 [1,3] 3.5 [2,1] 4.5 [2,2] 5.5 [2,3] 6.5"),
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


def starts(pairs: dict[str, tuple[str, str]] = EVERYTHING) -> dict[str, Any]:
    """The start value of each scalar."""
    values: dict[str, Any] = {}
    for name, (kind, text) in pairs.items():
        words = text.split() if text.startswith("[") else ["", text]
        for index, word in zip(words[::2], words[1::2], strict=True):
            values[f"{name}{index}"] = word if kind == "String" else float(word)
    return values


@pytest.fixture(scope="module")
def everything(mirror: Build) -> System:
    return System({"m": mirror(EVERYTHING, saves_state=True, serialises_state=True)})


def mirrored(system: System, inputs: dict[str, Any]) -> dict[str, list[Any]]:
    """What comes out of the mirror at three points, by name."""
    outputs = [v.name for v in of_causality(describe(system.components["m"]), "output")]
    record = tuple(f"m.{name}" for name in outputs)
    given = {f"m.{name}": value for name, value in inputs.items()}
    experiment = Experiment(0.2, 0.1, inputs=given, open_inputs="start", record=record)
    recording = run(system, experiment)
    return {name.replace("_out", ""): recording[f"m.{name}"].tolist() for name in outputs}


@pytest.mark.slow
def test_arrays_are_scalars_row_by_row_of_every_type(everything: System) -> None:
    expected = {name: [start] * 3 for name, start in starts().items()}
    assert mirrored(everything, {}) == expected


def test_each_scalar_of_an_array_is_set_alone(everything: System) -> None:
    """The others keep what they have; of strings too."""
    changes = {"matrix[1,3]": -1.0, "i16[2]": -2, "flag[2]": True, "text[1]": "new", "misdeed": "hang"}
    inputs = {re.sub(r"(\[|$)", r"_in\1", name, count=1): value for name, value in changes.items()}
    expected = starts() | changes | {"flag[2]": 1.0, "misdeed": float(Misdeed.HANG)}
    assert {name: values[-1] for name, values in mirrored(everything, inputs).items()} == expected


def test_scalars_of_arrays_are_connected_in_any_order(mirror: Build) -> None:
    fmu = mirror(EVERYTHING)
    order = ["[2,3]", "[1,1]", "[2,1]", "[1,2]", "[2,2]", "[1,3]"]
    pairs = [(f"one.matrix_out{i}", f"two.matrix_in{j}") for i, j in pairwise([*order, order[0]])]
    pairs += [("one.text_out[2]", "two.text_in[1]"), ("one.i16_out[1]", "two.i32_in")]
    pairs += [("one.u8_out", "two.level_in"), ("one.flag_out[1]", "two.flag_in[2]")]
    record = tuple(target.replace("_in", "_out") for _, target in pairs)
    experiment = Experiment(0.3, 0.1, open_inputs="start", record=record)
    recording = run(System({"one": fmu, "two": fmu}, pairs), experiment)
    for source, target in pairs:
        start = starts()[source.partition(".")[2].replace("_out", "")]
        assert recording[target.replace("_in", "_out")].tolist() == [start] * 4


def test_an_array_follows_a_signal_and_a_change_of_one_scalar(everything: System) -> None:
    experiment = Experiment(
        0.5,
        0.1,
        signals={"m.single_in[2]": Ramps([[0.0, 0.0], [0.5, 1.0]])},
        events=(Event(0.2, {"m.single_in[1]": 4.0}),),
        open_inputs="start",
        record=("m.single_out[1]", "m.single_out[2]", "m.single_in[2]"),
    )
    recording = run(everything, experiment)
    assert recording["m.single_out[1]"].tolist() == [0.25, 0.25, 0.25, 4.0, 4.0, 4.0]
    singles = recording["m.single_in[2]"].astype(np.float32)
    assert recording["m.single_out[2]"][1:].tolist() == singles[:-1].tolist()


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"m.u8_in": 300}, "m.u8_in = 300: expected 0 to 255"),
        ({"m.i8_in": -129}, "m.i8_in = -129: expected -128 to 127"),
        ({"m.u64_in": -1}, r"m.u64_in = -1: expected 0 to 2147483647"),
        ({"m.i64_in": 2**31}, r"m.i64_in = 2147483648: expected -2147483648 to 2147483647"),
        ({"m.i16_in[1]": 1.5}, r"m.i16_in\[1\] = 1.5: expected a value of type Integer"),
        ({"m.flag_in[1]": 1}, r"m.flag_in\[1\] = 1: expected a value of type Boolean"),
        ({"m.misdeed_in": "hung"}, r"m.misdeed_in = 'hung': expected one of none \(1\), .*hang"),
        ({"m.matrix_in[3,1]": 1.0}, r"no variable 'm.matrix_in\[3,1\]'; .*m.matrix_in\[.,1\]"),
        ({"m.matrix_in": 1.0}, r"no variable 'm.matrix_in'; .*m.matrix_in\[.,.\]"),
        ({"m.i32_out": 1}, "m.i32_out is driven: expected an input, got output"),
    ],
)
def test_wrong_values_and_unknown_scalars_are_refused_as_in_fmi_2(
    everything: System, inputs: dict[str, Any], message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        run(everything, Experiment(0.2, 0.1, inputs=inputs, open_inputs="start"))


WIDE_AND_NARROW = {
    "big": ("Int32", "300"),
    "small": ("Int8", "1"),
    "wide": ("Float64", "[1] -1e300 [2] 2.5"),
    "narrow": ("Float32", "[1] 0.5 [2] 1.5"),
}


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("big_out", "small_in", r"fmi3SetInt8 returned error: value reference \d+: 300: expected -128..127"),
        ("wide_out[1]", "narrow_in[2]", r"fmi3SetFloat32 returned .*: -1\.0.*e\+300: expected -3.4"),
    ],
)
def test_a_number_that_an_input_cannot_hold_ends_the_run(
    mirror: Build, source: str, target: str, message: str
) -> None:
    fmu = mirror(WIDE_AND_NARROW)
    system = System({"one": fmu, "two": fmu}, ((f"one.{source}", f"two.{target}"),))
    with pytest.raises(SimulationError, match=f"two at t = 0 s: {message}"):
        run(system, Experiment(0.2, 0.1, open_inputs="start"))


def test_an_integer_beyond_those_of_the_master_is_refused(mirror: Build) -> None:
    path = mirror({"big": ("Int64", "5000000000")})
    description = describe(path)
    with FmuInstance("m", path, description) as instance:
        (big, _) = description.modelVariables[1:]
        with pytest.raises(FmuError, match=r"fmi3GetInt64 .*: 5000000000: expected -2147483648..2147483647"):
            instance.get(big)
        instance.set(big, 7)
        assert instance.get(big) == 7


SIZED = (
    '<Dimension start="2" />',
    '<Dimension valueReference="5" />',
), (
    "<ModelVariables>",
    '<ModelVariables><UInt64 name="size" valueReference="5" causality="structuralParameter" start="2"/>'
    '<Binary name="frame" valueReference="6" causality="output"/>'
    '<Clock name="tick" valueReference="7" causality="input" intervalVariability="triggered"/>'
    '<Float64 name="held" valueReference="8" causality="output" variability="discrete" clocks="7"/>'
    '<Int8 name="taken" valueReference="9" causality="input" clocks="7" start="3"/>',
)  # fmt: skip


@pytest.fixture(scope="module")
def sized(mirror: Build) -> System:
    return System({"m": mirror({"row": ("Float64", "[1] 1.5 [2] 2.5")}, changes=SIZED)})


def test_a_dimension_has_the_start_value_of_its_structural_parameter(sized: System) -> None:
    assert mirrored(sized, {"row_in[2]": 4.0}) == {"row[1]": [1.5] * 3, "row[2]": [4.0] * 3}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"parameters": {"m.size": 3}}, "m.size: expected a parameter.*, got structuralParameter with"),
        ({"record": ("m.frame",)}, "record: m.frame has type Binary: expected a number, a Boolean or a Str"),
        ({"inputs": {"m.tick": 1}}, "driven input: m.tick has type Clock: expected a number"),
        ({"record": ("m.held",)}, "record: m.held has type Float64 of a Clock: expected .* and no Clock"),
        ({"inputs": {"m.taken": 1}}, "driven input: m.taken has type Int8 of a Clock: expected a number"),
    ],
)
def test_what_the_master_does_not_set_or_read_is_refused_by_name(
    sized: System, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        run(sized, Experiment(0.2, 0.1, open_inputs="start", **settings))


def test_an_output_of_a_clock_is_not_read(sized: System) -> None:
    """FMI 3.0.2, 2.2.4: it may be read only while the Clock is active; this library refuses its reference."""
    recording = run(sized, Experiment(0.2, 0.1, open_inputs="start"))
    assert recording.names == ("m.row_out[1]", "m.row_out[2]")


@pytest.mark.parametrize("terminates", [False, True])
@pytest.mark.parametrize(
    ("part", "is_refused"),
    [
        (1.0, False),
        (1.0005, False),
        (0.25, False),
        (0.0, False),
        (-5e-4, False),
        (1.01, True),
        (-0.01, True),
        (9.5, True),
    ],
)
def test_a_step_reaches_a_time_within_it(
    mirror: Build, part: float, is_refused: bool, terminates: bool
) -> None:
    """part: of the step that the FMU returns as done; above 9 it returns NaN."""
    reached = "(*terminates = d->value[1] > 0, d->value[0] > 9 ? NAN : t + h * d->value[0])"
    pairs = {"part": ("Float64", "1"), "ends": ("Float64", "0")}
    system = System({"m": mirror(pairs, {"REACHED": reached})})
    inputs = {"m.part_in": part, "m.ends_in": float(terminates)}
    experiment = Experiment(-1.5, 0.5, -3.0, inputs=inputs)
    if is_refused or not (terminates or part >= 1.0):
        time = "nan" if part > 9 else f"{-3.0 + 0.5 * part:.9g}"
        message = f"m at t = -3 s: fmi3DoStep .*: lastSuccessfulTime is {time} s: expected .*, -3..-2.5 s"
        with pytest.raises(SimulationError, match=message):
            run(system, experiment)
        return
    recording = run(system, experiment)
    if terminates:
        assert recording.time.tolist() == sorted({-3.0, recording.provenance["terminated"]["time_s"]})
        assert recording.time[-1] == -3.0 + 0.5 * (part if 0.0 < part <= 1.0 else 0.0)
    else:
        assert recording["m.part_out"].tolist() == [part] * 4


@pytest.mark.parametrize(
    ("macro", "message"),
    [
        ("RETURNS_EARLY", "earlyReturn is true: expected false, as it is not allowed"),
        ("NEEDS_EVENT", "eventHandlingNeeded is true: expected false, as no event mode is used"),
    ],
)
def test_a_step_that_ends_in_a_way_that_was_not_allowed_ends_the_run(
    mirror: Build, macro: str, message: str
) -> None:
    system = System({"m": mirror({"x": ("Float64", "1")}, {macro: 0.25})})
    with pytest.raises(
        SimulationError, match=f"m at t = 0.3 s: fmi3DoStep returned error: {message}"
    ) as caught:
        run(system, Experiment(1.0, 0.1, open_inputs="start"))
    assert caught.value.recording.time[-1] == pytest.approx(0.3)


def test_errors_name_the_functions_of_fmi_3(rogue: Build) -> None:
    system = System({"rogue": rogue(fmi=3)})
    for misdeed, message in (
        (Misdeed.ERROR, "rogue at t = 0.5 s: fmi3DoStep returned error: the rudder is stuck"),
        (Misdeed.REFUSE_INPUT, "fmi3SetFloat64 returned discard: no input is taken any more"),
    ):
        with pytest.raises(SimulationError, match=message):
            run(system, replace(doing(misdeed), signals={"rogue.u": Cosine(1.0, 3.0)}))
    with pytest.warns(FmuWarning, match="rogue at t = .* s: fmi3DoStep: the battery is low"):
        run(system, replace(doing(Misdeed.WARNING), inputs={"rogue.u": 1.0}))


# Runs of every kind


@pytest.mark.parametrize("versions", [(3, 2), (2, 3), (3, 3)])
@pytest.mark.parametrize("method", ["fixed-point", "newton"])
def test_an_algebraic_loop_starts_from_the_values_of_fmi_2(
    linear: Build, versions: tuple[int, int], method: Any
) -> None:
    def first(one: int, two: int) -> Recording:
        fmus = {
            "one": linear(d=((0.4,),), fmi=one),
            "two": linear(d=((0.3, 0.1),), b=(1.0, 1.0), fmi=two),
        }
        system = System(fmus, (*LOOP, ("one.y[1]", "two.u[2]")))
        return simulate(system, Experiment(0.2, 0.1, initialisation=method))

    assert np.array_equal(first(*versions).values, first(2, 2).values)


SWEPT = """
base = "nominal-extended"
[components]
plant = '{plant}'
[experiment]
stop_time = 2.0
[metrics]
settling_time = false
overshoot = false
holding_thrust = false
lag = false
[sweep]
samples = 4
seed = 1
[sweep.vary."plant.net_weight"]
distribution = "uniform"
low = -2.0
high = -1.0
"""


@pytest.mark.slow
def test_commands_take_an_fmu_of_fmi_3_by_its_file(
    command: Any, built: Fmus, fmi3_built: Fmus, vehicle_fmus: None, tmp_path: Path
) -> None:
    """`run` in a process of its own, and `sweep`: the files are those with FMI 2.0."""
    tables = []
    for number, fmus in enumerate((built, fmi3_built)):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = folder / "swept.toml"
        path.write_text(SWEPT.format(plant=fmus[PLANT]))
        command("sweep", path, "--out", folder)
        options = ("--controller", fmus[CONTROLLER], "--timeout", 60, "--out", folder, "--formats", "none")
        command("run", path, *options)
        (recording,), (samples,) = folder.glob("*.csv"), folder.glob("*.parquet")
        tables.append((recording.read_bytes(), parquet.read_table(samples).to_pydict()))
    assert tables[0] == tables[1]
    assert len({*tables[0][1]["rmse"]}) == 4
