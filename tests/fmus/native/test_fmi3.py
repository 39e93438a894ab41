"""Native FMUs of FMI 3.0, led through FMPy: the numbers of FMI 2.0, arrays as arrays, and what is refused."""

import ctypes
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import make_dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

from fmus.block import Block, variable
from fmus.compliance.examine import examine
from fmus.errors import ExportError
from fmus.fmi.description import describe, is_independent
from fmus.generate import builder
from fmus.generate.describe import arrays, variable_names
from fmus.native import toolchain
from fmus.registry import Flavour
from orchestration import System, simulate
from tests.described_fmus import XML, members
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import KINDS, Fmus, slow_but

from .blocks import EVERYTHING, Mode, block_named, in_fmi3
from .exchanged import BALL, TANK, Exchanged
from .fmi3_instance import Fmi3Instance, scalars

NAMES = in_fmi3(builder.block_names())
Open = Callable[..., Fmi3Instance]


@pytest.mark.parametrize("name", in_fmi3(KINDS))
def test_trajectories_are_those_of_fmi_2_bit_for_bit(
    built: Fmus, load: Any, open_fmi3: Open, name: str
) -> None:
    block = block_named(name)
    old, new = load(built[name]).begin(), open_fmi3(name).begin()
    moved = [v for v in block.of_causality("input") if v.minimum is None and v.type == "Real"]
    groups = [(group, elements) for group, _, elements in arrays(block.of_causality("input"))]
    h = block.step_size
    recorded = []
    for i in range(50):
        values = {v.name: math.cos(5.0 * i * h * (k + 1)) for k, v in enumerate(moved)}
        for member, value in values.items():
            old[member] = value
        for group, elements in groups:
            if {v.name for v in elements} <= {*values}:
                new[group] = [values[v.name] for v in elements]
        old.slave.doStep(i * h, h)
        assert new.fmu.doStep(i * h, h) == (False, False, False, (i * h) + h)
        recorded.append(scalars(new, block, "output"))
        assert recorded[-1] == outputs(old, block)
    assert name == "ThrustAllocation" or np.ptp(np.array(recorded, float), axis=0).max() > 0.0


def outputs(fmu: Any, block: Block) -> list[Any]:
    read = {"Real": fmu.slave.getReal, "Boolean": fmu.slave.getBoolean}
    return [
        read.get(v.type, fmu.slave.getInteger)([v.value_reference])[0] for v in block.of_causality("output")
    ]


@pytest.mark.parametrize("name", NAMES)
def test_its_scalars_have_the_value_references_of_fmi_2(built: Fmus, fmi3_built: Fmus, name: str) -> None:
    """By which vectors find them in a saved state; the time and event indicators are more."""
    old, new = describe(built[name]), describe(fmi3_built[name])
    assert is_independent(new)
    scalars = {v.name: (v.valueReference, v.type, v.causality) for v in new.modelVariables}
    for v in old.modelVariables:
        assert scalars.pop(v.name) == (v.valueReference, v.type, v.causality)
    assert {name.partition("[")[0] for name in scalars} <= {"time", "event.indicators"}


WITH_EVENTS = EVERYTHING.name, BALL.name, TANK.name


def places(path: Path) -> dict[str, str]:
    """Name -> place among the variables of an FMU, counted from 1, once it is the value reference."""
    variables = ElementTree.fromstring(members(path)[XML]).find("ModelVariables")
    assert variables is not None
    assert [v.get("valueReference") for v in variables] == [str(i + 1) for i in range(len(variables))]
    return {v.get("name", ""): v.get("valueReference", "") for v in variables}


@pytest.mark.parametrize("name", [*NAMES, *WITH_EVENTS])
def test_a_value_reference_is_the_place_among_the_variables(fmi3_built: Fmus, name: str) -> None:
    """So is the reference of the time, and a derivative names its state by it."""
    found = places(fmi3_built[name])
    description: Any = fmpy.read_model_description(str(fmi3_built[name]), validate=False)
    assert "time" in found
    for v in description.modelVariables:
        state = v.name.removeprefix("der(").removesuffix(")")
        assert str(v.derivative and v.derivative.valueReference) == found.get(
            state if v.derivative else "", "None"
        )
        assert (v.derivative is not None) == v.name.startswith("der(")


@pytest.fixture(scope="module")
def of_scalars(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("scalars")
    return {
        block.name: builder.build_block(block, folder, fmi=3, scalars=True)
        for block in map(block_named, ("ExamplePlant", BALL.name))
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ExamplePlant", BALL.name])
def test_scalars_are_variables_with_the_numbers_of_the_arrays(
    of_scalars: dict[str, Path], fmi3_built: Fmus, small_built: Fmus, built: Fmus, name: str
) -> None:
    """Names are those of FMI 2.0; FMPy, the schema and the rules of the check find nothing wrong."""
    path = of_scalars[name]
    old = describe((small_built if name == BALL.name else built)[name])
    others = {v for v in places(path) if v == "time" or v.startswith("event.indicators[")}
    assert {*places(path)} - others == {v.name for v in old.modelVariables}
    content = members(path)
    assert b"<Dimension" not in content[XML]
    assert b"name[1] and name[2]" in content["documentation/index.html"]
    terminals = ElementTree.fromstring(content["terminalsAndIcons/terminalsAndIcons.xml"])
    assert {m.get("variableName") for m in terminals.iter("TerminalMemberVariable")} <= {*places(path)}
    assert validate_fmu(str(path)) == []
    assert [r.messages for r in examine(path) if r.messages] == []
    driven = {"it.control": 2.0} if name == "ExamplePlant" else {}
    one, other = (
        simulate(System({"it": fmu}), inputs=driven, stop_time=1.0, step_size=0.02, open_inputs="start")
        for fmu in (path, fmi3_built[name])
    )
    assert_same_bits(one, other)
    assert np.ptp(one.values, axis=0).max() > 0.0


def test_scalars_have_derivatives_of_their_own(of_scalars: dict[str, Path], tmp_path: Path) -> None:
    """Those of the states by the states are the state matrix, where theta is zero."""
    plant = Fmi3Instance(of_scalars["ExamplePlant"], tmp_path, "ModelExchange")
    plant["theta[1]"], plant["theta[2]"] = [0.0], [0.0]
    plant.begin()
    rates, states = (
        [plant.reference(n.format(i)) for i in (1, 2)] for n in ("der(state.x[{}])", "state.x[{}]")
    )
    slopes = [[plant.fmu.getDirectionalDerivative([r], [s], [1.0], 1)[0] for s in states] for r in rates]
    assert slopes == [[0.0, 1.0], [-1.0, -1.4]]
    description = plant.description
    dependencies = {u.variable.name: {v.name for v in u.dependencies} for u in description.outputs}
    assert dependencies["state[1]"] == {"state.x[1]"}


@pytest.mark.parametrize("name", slow_but(WITH_EVENTS[:1], [*KINDS, *WITH_EVENTS]))
def test_they_break_no_rule(fmi3_built: Fmus, name: str) -> None:
    assert [r.messages for r in examine(fmi3_built[name]) if r.messages] == []


# with events; the others have fewer
@pytest.mark.parametrize("name", slow_but(WITH_EVENTS, [*builder.block_names(), *WITH_EVENTS]))
def test_fmpy_finds_no_problem_and_simulates_both_interfaces(fmi3_built: Fmus, name: str) -> None:
    path = str(fmi3_built[name])
    assert validate_fmu(path) == []
    for interface in ("CoSimulation", "ModelExchange"):
        result: Any = fmpy.simulate_fmu(path, fmi_type=interface, stop_time=0.5)
        assert result["time"][-1] == pytest.approx(0.5, abs=1e-9)
        assert all(np.isfinite(result[variable]).all() for variable in result.dtype.names)


@pytest.mark.parametrize("name", ["ExamplePlant", EVERYTHING.name, BALL.name])
def test_the_descriptions_fit_the_schemas_and_the_library(fmi3_built: Fmus, name: str) -> None:
    """FMI 3.0.2, 2.5: files are where it says."""
    content = members(fmi3_built[name])
    for path, schema in {
        "modelDescription.xml": "fmi3ModelDescription",
        "sources/buildDescription.xml": "fmi3BuildDescription",
        "terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons",
    }.items():
        file = Path(fmpy.__file__).parent / "schema" / "fmi3" / f"{schema}.xsd"
        etree.XMLSchema(etree.parse(file)).assertValid(etree.fromstring(content[path]))
    assert {"terminalsAndIcons/icon.png", "documentation/index.html"} <= {*content}
    assert "extra/org.fmi-standard.fmi-ls-ref/fmi-ls-manifest.xml" in content
    assert b"fmi3.c" in content["sources/buildDescription.xml"]
    assert {"sources/fmi2.c", "model.png"}.isdisjoint(content)
    terminals = ElementTree.fromstring(content["terminalsAndIcons/terminalsAndIcons.xml"])
    variables = {v.get("name") for v in ElementTree.fromstring(content[XML])[-2]}
    assert {m.get("variableName") for m in terminals.iter("TerminalMemberVariable")} <= variables


def test_every_function_of_the_standard_is_exported(open_fmi3: Open) -> None:
    header = (toolchain.FMI_HEADERS / "fmi3Functions.h").read_text("utf-8")
    names = re.findall(r"^FMI3_Export \w+ +(\w+);", header, re.MULTILINE)
    library = open_fmi3("ExamplePlant").fmu.dll
    assert len(names) == 75
    assert [name for name in names if not hasattr(library, name)] == []


def test_what_is_one_array_in_the_block_is_one_variable(open_fmi3: Open) -> None:
    """Row by row; scalars that differ in more than their start values stay scalars."""
    plant = open_fmi3("ExamplePlant")
    assert [d.start for d in plant.variables["state_matrix"].dimensions] == [2, 2]
    assert plant["state_matrix"] == [0.0, 1.0, -1.0, -1.4]
    plant["state_matrix"] = [0.0, 1.0, -1.0, -2.0]
    plant["initial_state"] = [0.5, 0.25]
    plant.begin()
    assert plant["state"] == [0.5, 0.25]
    assert plant["der(state.x)"][0] == 0.25
    assert plant["time"] == [0.0]
    voltage = open_fmi3("RovDepthPlant").variables["voltage"]
    assert ([d.start for d in voltage.dimensions], voltage.causality) == ([2], "input")


@pytest.mark.parametrize(("nominal", "indices"), [(2.0, [""]), ((1.0, 2.0), ["[1]", "[2]"])])
def test_derivatives_are_an_array_where_their_states_are(nominal: Any, indices: list[str]) -> None:
    x = variable((0.0, 0.0), "States", unit="m", nominal=nominal)
    continuous = make_dataclass("Continuous", [("x", tuple[float, ...], x)], frozen=True)
    output = make_dataclass("Outputs", [("y", float, variable(0.0, "Output"))], frozen=True)
    functions: Any = {"derivative": lambda *_: continuous(), "output": lambda *_: output()}
    block = Block("Two", "Two states", continuous=continuous, outputs=output, **functions)
    states = [f"state.x{index}" for index in indices]
    assert variable_names(block.states) == [*states, *(f"der({state})" for state in states)]


def test_every_type_is_read_and_set_by_its_own_functions(open_fmi3: Open) -> None:
    fmu = open_fmi3(EVERYTHING.name)
    kinds = {v.name: v.type for v in fmu.description.modelVariables}
    assert (kinds["mode"], kinds["count"], kinds["enabled"]) == ("Enumeration", "Int32", "Boolean")
    fmu["mode"], fmu["count"], fmu["enabled"] = [Mode.REST], [7], [False]
    fmu["force"] = [2.0]
    fmu.begin()
    assert (fmu["mode"], fmu["count"], fmu["enabled"]) == ([0], [7], [False])
    assert (fmu["steps"], fmu["high"], fmu["y"]) == ([7], [True], [8.0 * 3.0])
    for kind in ("Int32", "Boolean", "Float64", "UInt8"):
        text = open_fmi3(EVERYTHING.name).begin().refused(f"set{kind}", [fmu.reference("mode")], [0])
        expected = "no UInt8 variables" if kind == "UInt8" else "mode is Int64 or Enumeration: expected"
        assert expected in text


def test_a_value_that_is_refused_leaves_all_as_they_were(open_fmi3: Open) -> None:
    fmu = open_fmi3(EVERYTHING.name).begin()
    valve, force, mode = (fmu.reference(name) for name in ("valve", "force", "mode"))
    text = fmu.refused("setFloat64", [force, valve], [3.0, 1.5], status="discard")
    assert text == "fmi3SetFloat64: valve = 1.5: expected 0 to 1"
    assert fmu["force"] == [0.0]
    assert "expected one of 0 (rest), 3 (run)" in fmu.refused("setInt64", [mode], [2], status="discard")
    assert fmu.status("doStep", 0.0, 0.1) == "ok"


# what FMI 2.0 has alike is in test_native_refusals.py
@pytest.mark.parametrize(
    ("calls", "call", "reason"),
    [
        (0, ("doStep", 0.0, 0.1), "fmi3DoStep is not allowed in the state 'instantiated'"),
        (0, ("enterInitializationMode", None, 1.0, 1.0), "stop time 1 s: expected more than the start time"),
        (0, ("enterInitializationMode", None, math.nan), "start time nan s: expected a finite number"),
        (1, ("enterInitializationMode",), "not allowed in the state 'initialization mode'"),
        (1, ("getOutputDerivatives", [11], [1]), "not allowed in the state 'initialization mode'"),
        (1, ("getDirectionalDerivative", [11], [12], [1.0, 1.0]), "state.x[1] is no known in this mode"),
        (2, ("doStep", 0.0, 3.0), "step to 3 s: expected at most the stop time 2 s"),
        (2, ("enterEventMode",), "expected an instance for model exchange"),
        (2, ("updateDiscreteStates",), "expected an instance for model exchange"),
        (2, ("enterStepMode",), "has no event mode of co-simulation"),
        (2, ("enterConfigurationMode",), "has no structural parameters"),
        (2, ("getClock", [0]), "has no clocks"),
        (2, ("getFloat64", [1, 15]), "value reference 15: expected 1..14 of ExamplePlant"),
        (2, ("getFloat64", [0]), "value reference 0: expected 1..14 of ExamplePlant"),
        (2, ("getFloat64", [2], 3), "fmi3GetFloat64: 3 values: expected 4"),
        (2, ("setFloat64", [2], [1.0]), "fmi3SetFloat64: 1 values: expected 4"),
        (2, ("setFloat64", [10], [0.0, 0.0]), "state[1] can not be set, it is calculated"),
        (2, ("setFloat64", [14], [0.0]), "time can not be set, it is calculated"),
        (2, ("setFloat64", [7], [0.0, 0.0]), "initial_state[1] is fixed"),
        (2, ("getOutputDerivatives", [11], [1]), "ExamplePlant has no derivatives of outputs"),
        (2, ("getDirectionalDerivative", [8], [8], [1.0]), "control is no unknown in this mode"),
        (2, ("getAdjointDerivative", [11], [11], [1.0]), "output is no known in this mode"),
        (2, ("getAdjointDerivative", [11], [8], [1.0, 2.0]), "2 values: expected 1"),
        (2, ("setDebugLogging", True, ["logNothing"]), "log category 'logNothing'"),
    ],
)
def test_a_call_that_is_not_allowed_is_an_error_with_its_reason(
    open_fmi3: Open, calls: int, call: tuple[Any, ...], reason: str
) -> None:
    """After it, only what reads, restores or resets is allowed."""
    plant = open_fmi3("ExamplePlant")
    if calls > 0:
        plant.fmu.enterInitializationMode(startTime=0.0, stopTime=2.0)
    if calls > 1:
        plant.fmu.exitInitializationMode()
    assert reason in plant.refused(*call)
    assert plant.status("exitInitializationMode") == plant.status("doStep", 0.0, 0.1) == "error"
    assert plant.status("reset") == "ok"
    plant.begin()
    assert plant.status("doStep", 0.0, 0.1) == "ok"


@pytest.mark.parametrize(
    ("changes", "options", "reason"),
    [
        ({"instanceName": " "}, {}, "expected an instance name"),
        ({"guid": "other 50 %d #1#"}, {}, "instantiation token other 50 %d ##1##: expected"),
        ({}, {"eventModeUsed": True}, "eventModeUsed"),  # FMI 3.0.2, 2.3.1: hasEventMode is false
    ],
)
def test_an_instance_that_cannot_be_is_refused_with_the_reason(
    open_fmi3: Open, changes: dict[str, str], options: dict[str, bool], reason: str
) -> None:
    plant = open_fmi3("ExamplePlant")
    assert not plant.description.coSimulation.hasEventMode
    for name, value in changes.items():
        setattr(plant.fmu, name, value)
    for logging in (True, False):
        with pytest.raises(Exception, match="Failed to instantiate"):
            plant.fmu.instantiate(loggingOn=logging, logMessage=plant._message, **options)
    (message,) = plant.log
    assert reason in message[2]


def test_categories_are_switched_on_and_off_one_by_one(open_fmi3: Open) -> None:
    """FMI 3.0.2, 2.3.1: naming one does not switch off another; without `loggingOn` there is no message."""
    quiet = open_fmi3("ExamplePlant", logging=False).begin()
    control, nothing = quiet.reference("control"), [math.inf]
    assert quiet.status("setFloat64", [control], nothing) == "discard"
    assert quiet.log == []
    quiet.fmu.setDebugLogging(True, ["logStatusDiscard"])
    quiet.fmu.setDebugLogging(True, ["logStatusError"])
    assert "control = inf" in quiet.refused("setFloat64", [control], nothing, status="discard")
    quiet.fmu.setDebugLogging(False, ["logStatusDiscard"])
    quiet.log.clear()
    assert quiet.status("setFloat64", [control], nothing) == "discard"
    assert quiet.log == []
    assert "clocks" in quiet.refused("getClock", [0])


def test_a_saved_state_is_all_of_it_and_crosses_instances_as_bytes(open_fmi3: Open) -> None:
    one, other = open_fmi3("RovDepthPlant").begin(), open_fmi3("RovDepthPlant").begin()
    outputs = block_named("RovDepthPlant")

    def stepped(vehicle: Fmi3Instance) -> list[Any]:
        assert vehicle["time"] == [0.02]
        vehicle.fmu.doStep(0.02, 0.02)
        return scalars(vehicle, outputs, "output")

    one["voltage"] = [2.0, 1.0]
    one.fmu.doStep(0.0, 0.02)
    state = one.fmu.getFMUState()
    content = one.fmu.serializeFMUState(state)
    reached = stepped(one)
    one.fmu.setFMUState(state)
    other.fmu.setFMUState(other.fmu.deserializeFMUState(content))
    assert stepped(one) == stepped(other) == reached
    damaged = bytes([*content[:300], content[300] ^ 1, *content[301:]])
    assert "the state is damaged" in other.refused("deserializeFMUState", damaged)
    exchange = open_fmi3("RovDepthPlant", "ModelExchange")
    foreign = exchange.fmu.deserializeFMUState(content)
    assert "the state is of the other interface" in exchange.refused("setFMUState", foreign)


@pytest.mark.parametrize("name", ["ExamplePlant", BALL.name])
def test_model_exchange_has_the_states_derivatives_and_events_of_fmi_2(
    open_fmi3: Open, exchange: Callable[[str], Exchanged], tmp_path: Path, name: str
) -> None:
    old, new = exchange(name).begin(), open_fmi3(name, "ModelExchange").begin()
    count = new.fmu.getNumberOfContinuousStates()
    x = np.linspace(-0.25, -0.5, count)  # a ball that hits the ground
    assert old.event() == new.fmu.updateDiscreteStates()
    for fmu in (old.model, new.fmu):
        fmu.enterContinuousTimeMode()
        fmu.setTime(0.125)
        fmu.setContinuousStates(x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), count)
    for method, reference, number in (
        ("getContinuousStateDerivatives", old.rates, count),
        ("getNominalsOfContinuousStates", old.nominals, count),
        ("getContinuousStates", old.states, count),
        ("getEventIndicators", old.indicators, new.fmu.getNumberOfEventIndicators()),
    ):
        values = np.full(number, np.nan)
        getattr(new.fmu, method)(values.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), number)
        assert np.array_equal(values, reference), method
    if number := new.fmu.getNumberOfEventIndicators():
        assert new["event.indicators"] == [*old.indicators]
        description = ElementTree.parse(tmp_path / "fmi3 0" / "modelDescription.xml")
        restarted = [v.get("name") for v in description.iterfind(".//Float64[@reinit='true']")]
        assert restarted == ["state.velocity"]
    assert new["time"] == [0.125]
    old.model.enterEventMode()
    new.fmu.enterEventMode()
    event = new.fmu.updateDiscreteStates()
    assert event == old.event()
    assert event[3] == (name == BALL.name)
    assert "not allowed in the state 'event mode'" in new.refused("setTime", 1.0)


def test_continuous_states_are_set_one_by_one_in_continuous_time_mode(open_fmi3: Open) -> None:
    """FMI 3.0.2, 3.2.1; what follows from them is of the new values."""
    ball = open_fmi3(BALL.name, "ModelExchange").begin()
    height, velocity = ball.reference("state.height"), ball.reference("state.velocity")
    ball.fmu.updateDiscreteStates()
    ball.fmu.enterContinuousTimeMode()
    ball.fmu.setFloat64([velocity], [3.0])
    text = ball.refused("setFloat64", [height, velocity], [0.5, math.nan], status="discard")
    assert text == "fmi3SetFloat64: state.velocity = nan: expected a finite number"
    assert ball.fmu.getFloat64([height, velocity]) == [1.0, 3.0]
    ball.fmu.setFloat64([height], [0.25])
    assert (ball["height"], ball["der(state.height)"]) == ([0.25], [3.0])
    ball.fmu.enterEventMode()
    assert "can not be set" in ball.refused("setFloat64", [height], [0.5])


_ECOS = """
import sys
from ecospy.EcosSimulation import EcosSimulation
from ecospy.EcosSimulationStructure import EcosSimulationStructure
with EcosSimulationStructure() as structure:
    structure.add_model("it", sys.argv[1])
    structure.add_parameter_set("set", {"it::gain": 3.0, "it::enabled": False})
    with EcosSimulation(structure=structure, step_size=0.01) as simulation:
        assert simulation.init(0, "set")
        for _ in range(3):
            simulation.step(10)
            print("=", simulation.get_real("it::y").hex(), simulation.get_integer("it::steps"))
"""


@pytest.mark.importers
def test_ecos_gives_the_numbers_of_fmi_2(fmi3_built: Fmus, small_built: Fmus) -> None:
    """It reads FMUs with FMI Library, which is no relative of FMPy."""
    paths = fmi3_built[EVERYTHING.name], small_built[EVERYTHING.name]
    new, old = (
        subprocess.run([sys.executable, "-c", _ECOS, str(path)], capture_output=True, text=True, check=True)
        for path in paths
    )
    numbers = [[line for line in run.stdout.splitlines() if line.startswith("=")] for run in (new, old)]
    assert numbers[0] == numbers[1]
    assert len(numbers[0]) == len(set(numbers[0])) == 3


@pytest.mark.parametrize(
    ("flavour", "options", "reason"),
    [
        (Flavour.PYTHON, {"fmi": 3}, "FMI 3.0 in the python flavour: expected FMI 2.0, or 3.0 in native"),
        (Flavour.NATIVE, {"fmi": 4}, "FMI 4.0 in the native flavour: expected FMI 2.0"),
        (
            Flavour.NATIVE,
            {"fmi": 3, "reals_only": True},
            "Reals only: expected the native flavour and FMI 2.0",
        ),
        (Flavour.NATIVE, {"scalars": True}, "an FMU of scalars: expected FMI 3.0; FMI 2.0 has no arrays"),
    ],
)
def test_fmi_3_is_for_native_fmus_with_their_types(
    tmp_path: Path, flavour: Flavour, options: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ExportError, match=reason):
        builder.build_block("ExamplePlant", tmp_path, flavour, **options)
    assert not [*tmp_path.iterdir()]
