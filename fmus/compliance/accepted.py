"""Values that an FMU accepts."""

from collections.abc import Callable, Sequence
from typing import Any

from fmus.compliance.probe import Probe
from fmus.compliance.script import Script
from fmus.compliance.variable import Variable


def accepted(
    probe: Probe, pairs: Sequence[tuple[Variable, Any]], begun: Callable[[], Script]
) -> list[tuple[Variable, Any]]:
    """Returns the variables and values with which the FMU takes a step: all, or those accepted alone."""
    if not pairs or _takes(probe, [pairs], begun)[0]:
        return list(pairs)
    succeeded = _takes(probe, [[pair] for pair in pairs], begun)
    return [pair for pair, ok in zip(pairs, succeeded, strict=True) if ok]


def accepted_together(
    probe: Probe, pairs: Sequence[tuple[Variable, Any]], begun: Callable[[], Script]
) -> list[tuple[Variable, Any]]:
    """Returns variables and values with which the FMU takes a step at once: those accepted alone, less those
    that it refuses beside others; found once for all rules that begin alike.
    """
    values = [(v.name, x) for v, x in pairs]
    return probe.once("choice of values", lambda: _chosen(probe, pairs, begun), values, begun().calls)


def _chosen(
    probe: Probe, pairs: Sequence[tuple[Variable, Any]], begun: Callable[[], Script]
) -> list[tuple[Variable, Any]]:
    alone = accepted(probe, pairs, begun)
    if not alone or _takes(probe, [alone], begun)[0]:
        return alone
    together = list[tuple[Variable, Any]]()
    for pair in alone:
        if _takes(probe, [[*together, pair]], begun)[0]:
            together.append(pair)
    return together


def _takes(
    probe: Probe, choices: Sequence[Sequence[tuple[Variable, Any]]], begun: Callable[[], Script]
) -> list[bool]:
    """Whether the FMU takes a step after the values of each choice were set in a new script."""
    scripts = [begun() for _ in choices]
    for script, pairs in zip(scripts, choices, strict=True):
        for v, x in pairs:
            script.set(v, x)
        if script.state == "instantiated":
            script.initialise()
        if script.state == "initialization mode":
            script.exit_initialization_mode()
        script.step()
    probe.play_each(scripts)
    return [script.succeeded for script in scripts]
