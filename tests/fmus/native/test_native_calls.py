"""Any calls, legal or not, of the native FMU: answered as the model says, nothing lost.

Under sanitizers its memory is watched too: what it writes beyond its blocks, and what it never frees.
"""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, Verbosity, settings
from hypothesis.stateful import run_state_machine_as_test

from fmus.block import Block
from tests.shared_builds import c_sources_of

from .blocks import EVERYTHING, block_named
from .rules import CALLS
from .session import GUID, Session, compiled


def run(block: Block, program: Path, examples: int, *, fmi: int = 2, shrink: bool = True) -> None:
    """The same examples at every run."""
    machine: Any = type(f"CallsOf{block.name}", (CALLS[fmi],), {"send": Session(program, block)})
    checks = settings(
        max_examples=examples,
        stateful_step_count=40,
        deadline=None,
        derandomize=True,
        database=None,
        phases=(Phase.generate, Phase.shrink) if shrink else (Phase.generate,),
        report_multiple_bugs=False,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
        verbosity=Verbosity.normal if shrink else Verbosity.quiet,
    )
    run_state_machine_as_test(machine, settings=checks)
    machine.send.close()


@pytest.mark.parametrize("fmi", [2, 3])
def test_any_sequence_of_calls_of_a_small_block_is_answered_as_fmi_wants_it(tmp_path: Path, fmi: int) -> None:
    program = compiled(c_sources_of(EVERYTHING, GUID, fmi=fmi), tmp_path, sanitized=False, fmi=fmi)
    run(EVERYTHING, program, 12, fmi=fmi)


@pytest.mark.cross
@pytest.mark.parametrize(
    ("fmi", "name"),
    [
        *((2, name) for name in ("RovDepthPlant", "L1Controller", "L1DepthController")),
        *((3, name) for name in ("RovDepthPlant", "ExamplePlant", EVERYTHING.name)),
    ],
)
def test_any_sequence_of_calls_is_answered_as_fmi_wants_it(tmp_path: Path, name: str, fmi: int) -> None:
    block = block_named(name)
    run(block, compiled(c_sources_of(block, GUID, fmi=fmi), tmp_path, fmi=fmi), 50, fmi=fmi)


MUTANTS = tomllib.loads(Path(__file__).with_name("native_mutants.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_text_of_each_fault_stands_once(fmi: int) -> None:
    """A change of the C layer may copy or remove it; this is known before the long tests of the faults."""
    text = "".join(c_sources_of(EVERYTHING, GUID, fmi=fmi).values())
    assert {
        fault: text.count(good) for fault, (good, _) in MUTANTS[f"fmi{fmi}"].items() if text.count(good) != 1
    } == {}


@pytest.mark.cross
@pytest.mark.parametrize(
    ("fmi", "fault"), [(int(key[-1]), fault) for key in MUTANTS for fault in MUTANTS[key]]
)
def test_a_fault_of_the_c_layer_is_noticed(tmp_path: Path, fmi: int, fault: str) -> None:
    """Otherwise the test above would prove nothing."""
    good, bad = MUTANTS[f"fmi{fmi}"][fault]
    sources = c_sources_of(EVERYTHING, GUID, fmi=fmi)
    program = compiled({name: text.replace(good, bad) for name, text in sources.items()}, tmp_path, fmi=fmi)
    with pytest.raises(AssertionError):
        run(EVERYTHING, program, 1000, fmi=fmi, shrink=False)
