"""What a block may contain: each small block works as its Python functions do; and how it may sample."""

import random
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from fmus import numerics as n
from fmus.block.instance import BlockInstance
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.trace import trace
from fmus.generate.verify import check_sampling, check_trace
from fmus.numerics import Clock, sampled

from .small_blocks import WORKING, SampledMean, block_of, one_block_of_all

TOO_LONG = r"step misses samples in internal steps of 0\.1 s: expected a step_size"


@pytest.mark.parametrize("name", WORKING)
def test_it_works(name: str) -> None:
    check_trace(trace(WORKING[name]))
    builder.verified(WORKING[name])


def test_a_block_whose_steps_are_longer_than_its_period_is_refused() -> None:
    """Also by half a per cent; a step as long as the period misses nothing."""
    steps = {period: block_of(partial(measures_every, period), SampledMean) for period in (0.0995, 0.1)}
    with pytest.raises(ExportError, match=TOO_LONG):
        check_sampling(steps[0.0995])
    check_sampling(steps[0.1])


def test_a_clock_that_is_due_before_the_end_of_the_first_step_is_named() -> None:
    """A sample at the end of a step as long as the period is late for `Clock()`, not for `Clock(period)`."""
    rules = {period: partial(measures_at_the_end, period) for period in (0.05, 0.1)}
    late = (
        r"step misses the sample that is due at 0\.0 s in internal steps of 0\.1 s: "
        r"expected Clock\(t \+ period\) in initial_state, for samples at t \+ h$"
    )
    with pytest.raises(ExportError, match=late):
        check_sampling(block_of(rules[0.1], SampledMean))
    later = {period: replace(SampledMean(), clock=Clock(period)) for period in rules}
    blocks = {
        period: replace(block_of(rule, SampledMean), initial_state=lambda *_, state=later[period]: state)
        for period, rule in rules.items()
    }
    check_sampling(blocks[0.1])
    with pytest.raises(ExportError, match=TOO_LONG):
        check_sampling(blocks[0.05])


def measures_at_the_end(period: float, s: SampledMean, u: Any, p: Any, t: float, h: float) -> SampledMean:
    return sampled(t + h, period, s, SampledMean(u.u))


def test_a_block_that_leaves_a_domain_on_its_way_is_judged_by_the_comparison() -> None:
    """From 1 s on its step has the root of a negative number: no error of this check."""
    block = block_of(lambda s, u, p, t, h: sampled(t, 0.1, s, SampledMean(n.sqrt(1.0 - t))), SampledMean)
    check_sampling(block)


def measures_every(period: float, s: SampledMean, u: Any, p: Any, t: float, h: float) -> SampledMean:
    return sampled(t, period, s, SampledMean(u.u))


@pytest.mark.parametrize("name", ["an Integer state", "a Boolean state", "an Enumeration state"])
def test_a_saved_state_is_restored_in_its_types(name: str) -> None:
    instance, other = BlockInstance(WORKING[name]), BlockInstance(WORKING[name])
    instance.exit_initialization_mode()
    instance.do_step(0.0, 0.3)
    other.restore(instance.snapshot())
    assert other.snapshot() == instance.snapshot()


@pytest.mark.slow
def test_all_that_work_are_one_native_fmu_with_the_results_of_python(tmp_path: Path, load: Any) -> None:
    block = one_block_of_all()
    fmu = load(builder.build_block(block, tmp_path)).begin()
    python, rng = BlockInstance(block), random.Random(1)
    python.exit_initialization_mode()
    for i in range(300):
        u, is_on, count = rng.choice((0.0, rng.uniform(-3.0, 3.0))), rng.random() < 0.3, rng.randint(-3, 3)
        fmu["u"] = u
        fmu.slave.setBoolean([fmu.references["is_on"]], [is_on])
        fmu.slave.setInteger([fmu.references["count"]], [count])
        for name, value in (("u", u), ("is_on", is_on), ("count", count)):
            python.set(fmu.references[name], value)
        fmu.slave.doStep(0.1 * i, 0.1)
        python.do_step(0.1 * i, 0.1)
        for v in block.of_causality("output"):
            assert fmu[v.name] == python.get(v.value_reference), v.name
