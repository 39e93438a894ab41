"""A communication step of a block: through an FMU's functions and without them, and in two states."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from fmus.fmi.description import describe, of_causality
from fmus.platforms import host_platform
from fmus.registry import block_names
from tests.speed.layers import Layer, layer
from tests.speed.part import Goal, Options, Part, Table, ratios, spread
from tests.speed.programs import C_SOURCES, compile_program, extracted, output_of
from tests.speed.states import State

TARGETS = {"RovDepthPlant": 0.45, "L1DepthController": 0.65}
_STEPS = 20_000


@dataclass(frozen=True)
class Steps:
    """CPU time of a step of each build [ns], a value a round; whether all outputs are equal bit for bit."""

    block: str
    old: Sequence[float]
    new: Sequence[float]
    are_equal: bool


def compared(block: str, old: Path, new: Path, folder: Path, count: int, rounds: int) -> Steps:
    """The builds of a block in two folders measured in turns."""
    description = describe(new / f"{block}.fmu")
    step: Any = description.defaultExperiment
    arguments: list[object] = [step.stepSize, count, rounds]
    for causality in ("input", "output"):
        references = [v.valueReference for v in of_causality(description, causality)]
        arguments += [references[0], len(references)]
    for name, build in (("old", old), ("new", new)):
        guid, library = extracted(build / f"{block}.fmu", folder / name / block, host_platform())
        arguments += [library, guid]
    rows = [line.split() for line in output_of(folder, "steps", *arguments)]
    first, second, equal = zip(*rows, strict=True)
    return Steps(block, [*map(float, first)], [*map(float, second)], set(equal) == {"1"})


def measure(options: Options) -> Part:
    """Each block beside its C code; vehicle and controller in both states."""
    names = block_names()[:1] if options.quick else block_names()
    layers = sorted((layer(name, rounds=options.rounds(7)) for name in names), key=lambda x: x.through_fmi)
    tables, goals = [of_layers(layers)], []
    if options.before:
        measured = _of_states(options, options.before)
        tables.append(_of_steps(measured, options))
        goals = [_goal(steps) for steps in measured]
    return Part(tables, goals)


def _of_states(options: Options, before: State) -> list[Steps]:
    folder = options.folder / "steps"
    folder.mkdir()
    compile_program(folder, "steps", [str(C_SOURCES / "steps.c")], includes=[])
    count, rounds = (100, 1) if options.quick else (_STEPS, 101)
    return [
        compared(block, before.fmus, options.now.fmus, folder, count=count, rounds=rounds)
        for block in TARGETS
    ]


def of_layers(layers: Sequence[Layer]) -> Table:
    rows = [
        (
            f"`{x.block}`",
            f"{1e9 * x.through_fmi:.0f} ns",
            f"{1e9 * x.bare:.0f} ns",
            f"{x.through_fmi / x.bare:.2f}",
        )
        for x in layers
    ]
    return Table("fmi", ("a communication step of", "through FMI", "the same C without FMI", "ratio"), rows)


def _of_steps(measured: Sequence[Steps], options: Options) -> Table:
    rows = [
        (
            f"`{steps.block}`",
            spread(steps.old, 0, "ns"),
            spread(steps.new, 0, "ns"),
            spread(ratios(steps.new, steps.old), 3),
            options.equality(steps.are_equal),
        )
        for steps in measured
    ]
    return Table("steps", ("a communication step of", "before", "now", "ratio", "outputs"), rows)


def _goal(steps: Steps) -> Goal:
    ratio = median(ratios(steps.new, steps.old))
    return Goal(
        f"a step of `{steps.block}`",
        f"{TARGETS[steps.block]:g} of before",
        f"{median(steps.new):.0f} ns, {ratio:.2f} of before",
        f"{median(steps.old):.0f} ns",
    )
