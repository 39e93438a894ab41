"""What `l1-depth prove` proves, and that it names the line that divides."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from fmus.errors import ExportError
from fmus.generate import guard
from fmus.generate.builder import loaded
from fmus.prove import command, eva
from fmus.prove.esbmc import bounds
from fmus.prove.eva import Proof, freed, proof
from fmus.prove.harness import harness
from fmus.registry import block_names
from tests.described_fmus import members

BLOCK = """
from dataclasses import dataclass

from fmus.block import Block, variable
from fmus.numerics import asin, exp, fmod, log, maximum, minimum, power, sqrt, where


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

# of a block: results of its step
FAULTS = {
    "a divisor of 0 at the end of a range": "inputs.flow / (inputs.flow - 10.0)",
    "a lower limit in place of an upper one": "1.0 / minimum(inputs.flow, 1.0)",
    "a limit that is 0": "1.0 / maximum(margin, 0.0)",
    "no limit of an exponent": "exp(state.ratio)",
    "a root of less than 0": "sqrt(inputs.flow - 0.1)",
    "a logarithm of less than 0": "log(5.0 - inputs.flow)",
    "a power of 0": "power(inputs.flow, -1.0)",
    "an arc sine of more than 1": "asin(inputs.flow - 3.0)",
    "a product that is too large": "1e306 * inputs.flow * state.ratio",
}
DECAY, FOLDED = "state.ratio * exp(-h * parameters.offset)", "fmod(1e20 * inputs.flow, 7.0)"
# of generated C: result of the step, text of C, the fault in its place, whether ESBMC finds it, too
C_FAULTS = {
    "a write behind the constants": (DECAY, r"k\[0\] =", "k[1] =", True),
    "a read before the constants": (DECAY, r"(\W)k\[0\](?! =)", r"\1k[-1]", True),
    "an index of what is remembered": ("exp(inputs.flow)", r"last\[2\] = 1", "last[3] = 1", True),
    "a constant that is not computed": (DECAY, r"k\[0\] = v\d+;", "", False),
    "no inputs": ("inputs.flow + 1.0", r"&it.inputs(?=.* k, )", "0", True),
    "a number that is not computed": ("inputs.flow + 1.0", r"v\d+ = u->flow \+ 1.0;", "", False),
    "a state that is not written": ("inputs.flow + 1.0", r"next->ratio = v\d+;", "", False),
    "a difference as divisor": ("1.0 / (inputs.flow + 1.0)", r"/ (v\d+);", r"/ (\1 - \1);", False),
    "a limit left out": ("1.0 / maximum(inputs.flow, 0.1)", r"larger\(.*u->flow.*\);", "u->flow;", False),
    "a cast of a large number": (FOLDED, " && x < 9007199254740992.0", "", False),
    "a remainder by 0": (FOLDED, r"fmod_by_whole\((.*), 7.0\)", r"fmod_by_whole(\1, 0.0)", False),
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
def test_a_step_of_a_shipped_block_is_proved_by_both_tools(name: str) -> None:
    with guard.divisions() as divisions, loaded(name) as (traced,):
        result = proof(traced, divisions)
        assert not result.alarms
        count, outside = bounds(result.code, name)
        assert count
        assert not outside


@pytest.mark.cross
@pytest.mark.parametrize("result", FAULTS.values(), ids=FAULTS)
def test_a_fault_of_a_block_is_found(prove: Prove, result: str) -> None:
    assert prove(result).alarms


@pytest.mark.cross
@pytest.mark.parametrize(("result", "text", "fault", "is_access"), C_FAULTS.values(), ids=C_FAULTS)
def test_a_fault_of_the_c_code_is_found(
    prove: Prove, monkeypatch: pytest.MonkeyPatch, result: str, text: str, fault: str, is_access: bool
) -> None:
    """By Eva; ESBMC finds accesses alone."""
    codes: list[str] = []

    def faulty(*arguments: Any) -> str:
        code, count = re.subn(text, fault, harness(*arguments))
        assert count
        codes.append(code)
        return code

    monkeypatch.setattr(eva, "harness", faulty)
    assert prove(result).alarms
    assert bool(bounds(codes[0], "Hidden")[1]) == is_access


@pytest.mark.cross
def test_the_command_refuses_a_file_and_names_the_line_that_divides(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hidden.py"
    file.write_text(BLOCK.replace("RESULT", "state.ratio / (inputs.flow - parameters.offset)"))
    with pytest.raises(typer.Exit) as ended:
        command.prove([str(file)])
    assert ended.value.exit_code == 1
    line = BLOCK[: BLOCK.index("    return State(RESULT)")].count("\n") + 1
    assert f"hidden.py:{line}: return State(state.ratio" in capsys.readouterr().out


@pytest.mark.cross
def test_the_parameters_that_must_be_fixed_are_named(tmp_path: Path) -> None:
    """The offset can be -1, and the table cannot matter."""
    file = tmp_path / "hidden.py"
    file.write_text(BLOCK.replace("RESULT", "parameters.table[0] / (inputs.flow + parameters.offset)"))
    with guard.divisions() as divisions, loaded(str(file)) as (traced,):
        result = freed(traced, divisions, proof(traced, divisions))
    assert not result.alarms
    assert [box.name for box in result.parameters] == ["table[1]", "table[2]"]


@pytest.mark.cross
@pytest.mark.parametrize(
    ("result", "is_staying"),
    {
        "0.9 * state.ratio + 0.1 * margin": True,
        "minimum(maximum(state.ratio + margin, -1.0), 1.0)": True,
        "state.ratio + 0.1 * margin": False,
        "1.1 * state.ratio": False,
    }.items(),
)
def test_a_state_that_a_step_leaves_in_its_range_stays_for_all_time(
    prove: Prove, result: str, is_staying: bool
) -> None:
    proved = prove(result)
    assert not proved.alarms
    assert ("ratio" in proved.lasting) == ("ratio" in proved.staying) == is_staying
    assert (proved.verdict == "proved to 1,000,000 s") == is_staying


@pytest.mark.cross
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_result_is_a_page_inside_the_fmu_with_the_command_that_repeats_it(
    tmp_path: Path, fmi: int
) -> None:
    with pytest.raises(typer.Exit) as ended:
        command.prove(["ExamplePlant"], out=tmp_path, fmi=fmi)
    assert ended.value.exit_code == 0
    content = members(tmp_path / "ExamplePlant.fmu")
    page = content["documentation/proof.html"].decode()
    assert f'fmiVersion="{fmi}.0"' in content["modelDescription.xml"].decode()
    assert "<code>l1-depth prove ExamplePlant</code>" in page
    assert "<td>ESBMC</td><td>0 of " in page
    # as documentation/index.html has
    assert 'name="viewport"' in page
    assert "color-scheme: light dark" in page
