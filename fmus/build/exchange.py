"""A block between the events of model exchange.

There `step` is evaluated with h = 0: what it copies from inputs follows them at once, what `sampled` and
`at_events` guard is held, and the continuous states are the solver's.
"""

from typing import Any

import casadi

from fmus.block import Block
from fmus.block.integration import between_events
from fmus.build.declaration import scalar_names
from fmus.build.guard import location
from fmus.errors import ExportError


def due_samples(block: Block, t: float, state: Any, *others: Any) -> list[float]:
    """Returns the times at which samples are due [s]."""
    with between_events() as due:
        block.step(t, 0.0, state, *others)
    return due


def held_function(block: Block, name: str) -> Any:
    """Returns `derivative` or `crossings` of a block as model exchange calls it: between events."""
    function = getattr(block, name)
    return lambda t, state, *others: function(t, block.held(t, state, *others), *others)


def copied(block: Block, state: casadi.SX, held: casadi.SX) -> list[int]:
    """Returns the numbers of the state that follow inputs at once.

    state, held: the state, and as it is between events
    Raises ExportError if `step` changes something at no event that is no copy of what is given.
    """
    changed = [i for i in range(state.numel()) if not casadi.is_equal(state[i], held[i])]
    for wrong in (i for i in changed if casadi.depends_on(held[i], state[changed])):
        name = [*scalar_names(block.state)][wrong]
        raise ExportError(
            f"block {block.name!r}: {location(block.step)}step changes {name} by what it was: "
            "expected at_events(state, new) or sampled(...) of fmus.numerics around it"
        )
    return changed
