"""Any calls, legal or not, of the native FMU: answered as the model says, nothing lost.

Under sanitizers its memory is watched too: what it writes beyond its blocks, and what it never frees.
"""

import tomllib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, Verbosity, settings
from hypothesis.stateful import run_state_machine_as_test

from fmus.block import Block
from fmus.build import builder
from fmus.build.native import c_sources

from .native_beside import Pool
from .native_block import EVERYTHING
from .native_rules import Calls
from .native_session import GUID, compiled


def run(block: Block, program: Path, examples: int, *, shrink: bool = True) -> None:
    """The same examples at every run."""
    pool = Pool(program)
    machine = type("CallsOf" + block.name, (Calls,), {"block": block, "pool": pool})
    phases = (Phase.generate, Phase.shrink) if shrink else (Phase.generate,)
    checks = settings(
        max_examples=examples,
        stateful_step_count=40,
        deadline=None,
        derandomize=True,
        database=None,
        phases=phases,
        report_multiple_bugs=False,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
        verbosity=Verbosity.normal if shrink else Verbosity.quiet,
    )
    run_state_machine_as_test(machine, settings=checks)
    pool.session().close()


def test_any_sequence_of_calls_of_a_small_block_is_answered_as_fmi_wants_it(tmp_path: Path) -> None:
    run(EVERYTHING, compiled(c_sources(EVERYTHING, GUID), tmp_path, sanitized=False), 30)


@pytest.mark.cross
@pytest.mark.parametrize("name", ["RovDepthPlant", "L1Controller", "L1DepthController"])
def test_any_sequence_of_calls_is_answered_as_fmi_wants_it(tmp_path: Path, name: str) -> None:
    block = builder.load_block(name)
    run(block, compiled(c_sources(block, GUID), tmp_path), 120)


MUTANTS = tomllib.loads(Path(__file__).with_name("native_mutants.toml").read_text(encoding="utf-8"))


@pytest.mark.cross
@pytest.mark.parametrize("fault", MUTANTS)
def test_a_fault_of_the_c_layer_is_noticed(tmp_path: Path, fault: str) -> None:
    """Otherwise the test above would prove nothing."""
    block = builder.load_block("RovDepthPlant")
    good, bad = MUTANTS[fault]
    sources = c_sources(block, GUID)
    assert sum(text.count(good) for text in sources.values()) == 1
    program = compiled({name: text.replace(good, bad) for name, text in sources.items()}, tmp_path)
    with pytest.raises(AssertionError):
        run(block, program, 1000, shrink=False)
