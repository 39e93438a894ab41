"""What `l1-depth prove` proves, and that it names the line that divides."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.errors import ExportError
from fmus.generate import guard
from fmus.generate.builder import loaded
from fmus.prove import eva
from fmus.prove.eva import Proof, proof
from fmus.registry import block_names

BLOCK = """
from dataclasses import dataclass

from fmus.block import Block, variable
from fmus.numerics import choose, exp, log, sqrt, where


@dataclass(frozen=True)
class Parameters:
    offset: float = variable(2.0, "Offset")
    table: tuple[float, ...] = variable((1.0, 2.0), "Table")


@dataclass(frozen=True)
class Inputs:
    flow: float = variable(3.0, "Flow", min=0.0, max=10.0)


@dataclass(frozen=True)
class Outputs:
    ratio: float = variable(0.0, "Ratio")


@dataclass(frozen=True)
class State:
    ratio: float = 0.0


def initial_state(t, inputs, parameters, calculated):
    return State()


def step(t, h, state, inputs, parameters, calculated):
    margin = inputs.flow - parameters.offset
    return State(RESULT)


def output(t, state, parameters, calculated):
    return Outputs(state.ratio)


BLOCK = Block(
    "Hidden", "A step", parameters=Parameters, inputs=Inputs, outputs=Outputs, state=State,
    initial_state=initial_state, step=step, output=output,
)
"""
# result of the step -> whether all that C computes for it is finite at every flow of 0..10
STEPS = {
    "1.0 / margin": False,
    "state.ratio / (margin * margin)": False,
    "1.0 / (margin * margin + 1.0)": True,
    "where(margin > 0.0, 1.0 / margin, 0.0)": False,
    # too short for a branch: C divides first and chooses then
    "where(margin > 1.0, 1.0 / margin, 0.0)": False,
    "1.0 / inputs.flow": False,
    "1.0 / (inputs.flow + 0.1)": True,
    "sqrt(margin)": False,
    "sqrt(margin * margin)": True,
    "log(inputs.flow)": False,
    "log(inputs.flow + 1.0)": True,
    "exp(100.0 * inputs.flow)": False,
    "exp(10.0 * inputs.flow)": True,
    "h / (t - 5.0)": False,
    "1.0 / (state.ratio - parameters.offset)": False,
}

Prove = Callable[[str], Proof]


@pytest.fixture
def prove(tmp_path: Path) -> Prove:
    """Proves the block whose step has this result."""

    def proved(result: str) -> Proof:
        file = tmp_path / "hidden.py"
        file.write_text(BLOCK.replace("RESULT", result))
        with guard.divisions() as divisions, loaded(str(file)) as (traced,):
            return proof(traced, divisions)

    return proved


def test_an_alarm_has_the_expression_and_the_line_of_the_block(
    prove: Prove, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Eva prints it for the line of C that divides."""

    def printed(code: str, name: str, slevel: int) -> str:
        line = next(i for i, text in enumerate(code.splitlines(), 1) if re.search(r"v\d+ = .* / v\d+;", text))
        return f"[eva:alarm] /a/harness.c:{line}: Warning: \n  division by zero. assert v1 != 0;\n"

    monkeypatch.setattr(eva, "_frama_c", printed)
    (alarm,) = prove("state.ratio / (margin * margin)").alarms
    assert (alarm.kind, alarm.expression) == (
        "division by zero",
        "ratio / ((flow - offset) * (flow - offset))",
    )
    line = BLOCK[: BLOCK.index("    return State(RESULT)")].count("\n") + 1
    assert alarm.line.endswith(f"hidden.py:{line}: return State(state.ratio / (margin * margin))")


def test_without_frama_c_its_package_is_named(prove: Prove, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ExportError, match="frama-c is not installed: expected Debian's package frama-c-base"):
        prove("margin")


@pytest.mark.cross
@pytest.mark.parametrize(("result", "is_number"), STEPS.items())
def test_a_step_without_a_number_somewhere_is_not_proved(prove: Prove, result: str, is_number: bool) -> None:
    assert shutil.which("frama-c"), ".ci/run installs it"
    result_of_proof = prove(result)
    assert (not result_of_proof.alarms) == is_number
    divides = [alarm.line for alarm in result_of_proof.alarms if " / " in alarm.expression]
    assert all(line.endswith(f"return State({result})") for line in divides)


@pytest.mark.cross
@pytest.mark.parametrize("name", block_names())
def test_a_step_of_a_shipped_block_is_proved(name: str) -> None:
    with guard.divisions() as divisions, loaded(name) as (traced,):
        assert not proof(traced, divisions).alarms
