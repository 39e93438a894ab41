"""Check that a block takes all of its samples: `sampled` takes one in a step at most."""

from collections.abc import Iterator
from typing import Any

from fmus.block import Block
from fmus.block.scalars import members
from fmus.errors import ExportError
from fmus.generate.guard import location
from fmus.numerics import Clock

_STEPS = 200  # internal steps, until one that is half a per cent longer than the period is late


def check_sampling(block: Block) -> None:
    """Raises ExportError for a block that misses samples with all variables at their start values."""
    p, u, t = block.parameters(), block.inputs(), 0.0
    try:
        c = block.calculate(p)
        state = block.initial_state(t, u, p, c)
        for i in range(_STEPS if any(True for _ in _clocks(state)) else 0):
            t, before = i * p.internal_step, state
            state = block.advance(t, p.internal_step, before, u, p, c)
            _check_step(block, t, p.internal_step, before, state)
    except ExportError:
        raise
    except (ArithmeticError, ValueError):  # which the comparison with the traced functions judges
        return


def _check_step(block: Block, t: float, h: float, before: Any, after: Any) -> None:
    """Raises ExportError for a late clock: it starts again between t and t + h, unlike a block's Clock(t)."""
    for old, new in zip(_clocks(before), _clocks(after), strict=True):
        if new.start != old.start and new.count == 0 and new.start > t and new.start != t + h:
            missed = "samples"
            expected = "a step_size, or a parameter internal_step, of at most the sampling period"
            if old.start <= t == 0.0:  # whatever the period is, a sample at t + h is late for such a clock
                missed = f"the sample that is due at {old.start!r} s"
                expected = "Clock(t + period) in initial_state, for samples at t + h"
            raise ExportError(
                f"block {block.name!r}: {location(block.step)}step misses {missed} in internal steps of "
                f"{h!r} s: expected {expected}"
            )


def _clocks(value: Any) -> Iterator[Clock]:
    """Yields the clocks in a state, at any depth."""
    if isinstance(value, Clock):
        yield value
    for _, part in members(value) or ():
        yield from _clocks(part)
