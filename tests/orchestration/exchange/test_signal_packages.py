"""Packages of signals, as pyssporg/ssp_references has them, with the values that it expects.

The structures are written here after its descriptions (models/ssp/signal_*/FIXTURE.md, 2026), and the FMUs
are blocks of the tests. Its other models consist of FMUs of others.

Initial values are the expected ones, as nothing in the blocks depends on the past. In a run an output is
later by a communication step for each connection before it; Modelica's FMUs pass values on within a step.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from fmus.files import write_archive
from fmus.generate import builder
from orchestration.exchange import ssp_read
from orchestration.exchange.ssp_xml import STRUCTURE
from orchestration.run import simulate
from tests.orchestration.exchange.conftest import refusal
from tests.orchestration.exchange.signal_blocks import BLOCKS
from tests.orchestration.exchange.structures import (
    SPACES,
    binding,
    bindings,
    component,
    connection,
    connectors,
    real,
    system,
)
from tests.shared_builds import Fmus, LazyFmus, session_folder

Function = Callable[[np.ndarray], np.ndarray]
STEP_TIME = 0.25  # s
FREQUENCY = 2.0  # Hz
SLOPE = 2.0 * np.pi * FREQUENCY  # of a sine of amplitude 1, per s


def sine(amplitude: float, offset: float = 0.0, frequency: float = FREQUENCY) -> Function:
    return lambda t: offset + amplitude * np.sin(2.0 * np.pi * frequency * t)


def step(height: float, offset: float = 0.0) -> Function:
    return lambda t: offset + height * (t >= STEP_TIME)


def parameters(**values: float) -> str:
    """Inline values of a component; `startTime` is that of a step."""
    return bindings(*(binding(name, str(value)) for name, value in values.items()))


def element(kind: str, name: str = "", **values: float) -> str:
    own = BLOCKS[kind].variables
    kinds = {v.name: f"{v.causality} {v.unit or ''}" for v in own if v.name != "internal_step"}
    source = f"resources/{kind}.fmu"
    return component(name or kind.lower(), parameters(**values) if values else "", source, **kinds)


def wires(text: str) -> str:
    """Connections, "output input, ..."."""
    return "".join(connection(*pair.split()) for pair in text.split(","))


def external(name: str, inside: str = "") -> str:
    """A binding of an .ssv."""
    return f'<ssd:ParameterBinding source="resources/{name}.ssv">{inside}</ssd:ParameterBinding>'


def ssv(**values: float) -> bytes:
    own = "".join(f'<ssv:Parameter name="{n}">{real(str(x))}</ssv:Parameter>' for n, x in values.items())
    text = f'<ssv:ParameterSet {SPACES} version="1.0" name="p"><ssv:Parameters>{own}</ssv:Parameters>'
    return f"{text}</ssv:ParameterSet>".encode()


def ssm(*pairs: str) -> bytes:
    """Entries "source target"."""
    own = "".join('<ssm:MappingEntry source="{}" target="{}"/>'.format(*pair.split()) for pair in pairs)
    return f'<ssm:ParameterMapping {SPACES} version="1.0">{own}</ssm:ParameterMapping>'.encode()


SSM = '<ssd:ParameterMapping source="resources/values.ssm"/>'


@dataclass(frozen=True)
class Model:
    """A package, and what is expected of it.

    expected: output -> its value at a time
    later: communication steps that an output is later by in a run at most, of a loop on average
    """

    root: str
    expected: Mapping[str, Function]
    later: int
    files: Mapping[str, bytes] = field(default_factory=dict)


STEP = element("Step", height=1.0, offset=0.5, startTime=STEP_TIME)
SINE = element("Sine", amplitude=1.0, f=FREQUENCY)
INNER_SINE = system(
    "inner",
    element("Sine") + element("Gain", k=0.5),
    wires("sine.y gain.u, gain.y y"),
    connectors(y="output") + bindings(binding("sine.amplitude", "1"), binding("sine.f", "2")),
)
PASSED = system(
    "inner",
    element("Gain", k=1.0),
    wires("in gain.u, gain.y out"),
    connectors(**{"in": "input", "out": "output"}),
)
OF_FILES = system(
    "inner",
    element("Sine"),
    wires("sine.y y"),
    connectors(y="output") + bindings(external("values", SSM)),
)
MODELS = {
    "step_gain": Model(
        system("system", STEP + element("Gain", k=3.0), wires("step.y gain.u")), {"gain.y": step(3.0, 1.5)}, 1
    ),
    "step_add": Model(
        system(
            "system",
            STEP + element("Step", "other", height=-2.0, startTime=STEP_TIME) + element("Add"),
            wires("step.y add.u1, other.y add.u2"),
        ),
        {"add.y": step(-1.0, 0.5)},
        1,
    ),
    "step_product": Model(
        system(
            "system",
            element("Step", height=2.0, startTime=STEP_TIME) + SINE + element("Product"),
            wires("step.y product.u1, sine.y product.u2"),
        ),
        {"product.y": lambda t: step(2.0)(t) * sine(1.0)(t)},
        1,
    ),
    "sine_gain_add": Model(
        system(
            "system",
            SINE + STEP + element("Gain", k=2.0) + element("Add"),
            wires("sine.y gain.u, gain.y add.u1, step.y add.u2"),
        ),
        {"add.y": lambda t: 2.0 * sine(1.0)(t) + step(1.0, 0.5)(t)},
        2,
    ),
    "fanout_gain": Model(
        system(
            "system",
            STEP + element("Gain", "gain_a", k=2.0) + element("Gain", "gain_b", k=-1.0),
            wires("step.y gain_a.u, step.y gain_b.u"),
        ),
        {"gain_a.y": step(2.0, 1.0), "gain_b.y": step(-1.0, -0.5)},
        1,
    ),
    "delay_detector": Model(
        system(
            "system",
            STEP + element("Gain", "gain_a") + element("Gain", "gain_b") + element("Add", k2=-1.0),
            wires("step.y gain_a.u, gain_a.y gain_b.u, gain_b.y add.u1, step.y add.u2"),
        ),
        {"gain_b.y": step(1.0, 0.5), "add.y": lambda t: 0.0 * t},
        3,
    ),
    "algebraic_loop": Model(
        system(
            "system",
            element("Sine") + element("Gain") + element("Add"),
            wires("sine.y add.u1, gain.y add.u2, add.y gain.u"),
            bindings(external("values")),
        ),
        {"add.y": sine(2.0), "gain.y": sine(1.0)},
        4,
        {"values.ssv": ssv(**{"sine.f": FREQUENCY, "gain.k": 0.5})},
    ),
    "nested_algebraic_loop": Model(
        system(
            "system",
            element("Sine")
            + element("Gain", "gain_outer")
            + element("Gain", "gain_inner")
            + element("Add", "add_outer")
            + element("Add", "add_inner"),
            wires(
                "sine.y add_outer.u1, add_inner.y add_outer.u2, add_outer.y gain_outer.u,"
                "gain_outer.y add_inner.u1, gain_inner.y add_inner.u2, add_inner.y gain_inner.u"
            ),
            bindings(external("values")),
        ),
        {
            "add_outer.y": sine(1.0, 2.0),
            "add_inner.y": sine(0.5, 1.0),
            "gain_outer.y": sine(0.25, 0.5),
            "gain_inner.y": sine(0.25, 0.5),
        },
        11,
        {
            "values.ssv": ssv(
                **{"sine.amplitude": 0.5, "sine.f": FREQUENCY, "sine.offset": 1.0},
                **{"gain_outer.k": 0.25, "gain_inner.k": 0.5},
            )
        },
    ),
    "nested_pass_through": Model(
        system(
            "system",
            STEP + element("Add", k1=1.0, k2=1.0) + PASSED,
            wires("step.y inner.in, inner.out add.u1, add.y y"),
            connectors(y="output"),
        ),
        {"add.y": step(1.0, 0.5), "inner.gain.y": step(1.0, 0.5)},
        2,
    ),
    "nested_parameter_bindings": Model(
        system(
            "system",
            STEP + element("Add") + INNER_SINE,
            wires("step.y add.u1, inner.y add.u2, add.y y"),
            connectors(y="output") + bindings(external("values", SSM)),
        ),
        # the amplitude of the system goes over that of the inner one
        {"inner.gain.y": sine(1.0), "add.y": lambda t: 3.0 * step(1.0, 0.5)(t) + 2.0 * sine(1.0)(t)},
        2,
        {
            "values.ssv": ssv(add_k1=3.0, add_k2=2.0, amplitude=2.0),
            "values.ssm": ssm("add_k1 add.k1", "add_k2 add.k2", "amplitude inner.sine.amplitude"),
        },
    ),
    "nested_external_bindings": Model(
        system("system", STEP + OF_FILES, wires("step.y y"), connectors(y="output")),
        {"inner.sine.y": sine(2.0, 0.5, 5.0), "step.y": step(1.0, 0.5)},
        0,
        {
            "values.ssv": ssv(amplitude=2.0, frequency=5.0, offset=0.5),
            "values.ssm": ssm("amplitude sine.amplitude", "frequency sine.f", "offset sine.offset"),
        },
    ),
    "parameter_inline_with_mapping": Model(
        system(
            "system",
            element("Step"),
            "",
            bindings(
                *(binding(f"step_{n}", str(x), "", SSM) for n, x in (("height", 2.0), ("time", STEP_TIME)))
            ),
        ),
        {"step.y": step(2.0)},
        0,
        {"values.ssm": ssm("step_height step.height", "step_time step.startTime")},
    ),
}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    folder = session_folder(tmp_path_factory, "signals")
    return LazyFmus(BLOCKS, folder, lambda name, to: builder.build_block(BLOCKS[name], to))


def package(folder: Path, fmus: Fmus, model: Model) -> Path:
    text = f'<ssd:SystemStructureDescription {SPACES} name="s" version="1.0">{model.root}'
    text += '<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>'
    files = {f"{name}.fmu": fmus[name].read_bytes() for name in fmus if f"/{name}.fmu" in text}
    members = {f"resources/{name}": content for name, content in (files | dict(model.files)).items()}
    return write_archive(folder / "p.ssp", members | {STRUCTURE: text.encode()})


@pytest.mark.parametrize("name", MODELS)
def test_values_are_the_expected_ones(fmus: Fmus, tmp_path: Path, name: str) -> None:
    """At every start, and in a run but for the communication steps that they are later by."""
    model = MODELS[name]
    with ssp_read.opened(package(tmp_path, fmus, model)) as loop:
        assert {*model.expected} <= {*loop.experiment.record}
        for start in np.linspace(0.0, 1.0, 9).tolist():
            first = replace(loop.experiment, start_time=start, stop_time=start + loop.experiment.step_size)
            begun = simulate(loop.system, first)
            for output, expected in model.expected.items():
                # loops of initial values are solved to 1e-12
                assert begun[output][0] == pytest.approx(expected(begun.time)[0], rel=0.0, abs=1e-11)
        for step_size in (1e-3, 1e-4):
            run = simulate(loop.system, replace(loop.experiment, step_size=step_size))
            is_after_step = (run.time >= STEP_TIME) & (run.time < STEP_TIME + (model.later + 0.5) * step_size)
            for output, expected in model.expected.items():
                change = np.abs(np.diff(expected(run.time)))[~is_after_step[1:]].max()
                gap = np.abs(run[output] - expected(run.time))[~is_after_step]
                assert np.max(gap) <= model.later * change + 1e-11


def test_paths_of_different_length_are_aligned_in_the_order_of_gauss_seidel(
    fmus: Fmus, tmp_path: Path
) -> None:
    """By Jacobi the path through two gains is later by two communication steps."""
    with ssp_read.opened(package(tmp_path, fmus, MODELS["delay_detector"])) as loop:
        by_jacobi = simulate(loop.system, loop.experiment)["add.y"]
        aligned = simulate(loop.system, replace(loop.experiment, algorithm="gauss-seidel"))
    assert by_jacobi[by_jacobi != 0.0].tolist() == [-1.0, -1.0]
    assert not np.any(aligned["add.y"])
    np.testing.assert_array_equal(aligned["gain_b.y"], step(1.0, 0.5)(aligned.time))


def test_a_connection_of_an_output_to_itself_is_refused(fmus: Fmus, tmp_path: Path) -> None:
    """As "parameter_inline_with_mapping" has it there; here it is without it."""
    model = MODELS["parameter_inline_with_mapping"]
    own = replace(
        model, root=model.root.replace("</ssd:Connections>", wires("step.y step.y") + "</ssd:Connections>")
    )
    assert "connection of step.y and step.y, both outputs" in refusal(package(tmp_path, fmus, own))
