"""Page reference/controllers.md, the depth controllers with their gains, from the code."""

import re
from collections import Counter
from collections.abc import Iterable

from controller_fmu.baselines import adrc, mrac, pid, sliding_mode, super_twisting
from controller_fmu.l1 import depth_controller, heave_pitch_controller
from fmus.block import Block, BlockVariable
from orchestration.cli.explain import markdown_table

_HEAD = """\
# Depth controllers

The blocks that take the place of `L1DepthController` on the
[depth control interface](depth-control-interface.md), as in
`l1-depth run nominal-extended --controller PidDepthController`.
They have the same allocation, limit of the voltages and anti-windup, and all but ADRC the same observer.
So a comparison of them is one of laws. `L1DepthController` has the law of [theory](../explanation/theory.md).
`L1HeavePitchController` has it for the depth and again for the pitch.

| symbol | meaning |
|---|---|
| z | measured depth, positive down |
| v | its rate, measured or observed |
| r, r', r'' | reference and its derivatives; the derivatives are 0 where nothing drives these inputs |
| u | demanded force in N, positive down |
| M, D | inertia and linear damping that a design assumes |
| sat | limit to -1 .. 1 |

An integrator holds its value where it would increase a saturation of the thrusters. Estimators get the
force that the thrusters deliver.

The gains are start values; the last column has their derivation. They are not tuned. Of a vector, elements
that are alike share a row; of a table the first point is shown."""

_TABLE = re.compile(r"_table_\w+\[")

_BLOCKS = (pid.BLOCK, mrac.BLOCK, sliding_mode.BLOCK, super_twisting.BLOCK, adrc.BLOCK)


def page() -> str:
    """The whole page."""
    sections = [section(block, _shared_names(), _shared_lines()) for block in _BLOCKS]
    depth = depth_controller.BLOCK
    names = {v.name for v in depth.of_causality("parameter")}
    own = section(depth, _shared_names(), _shared_lines())
    both = section(heave_pitch_controller.BLOCK, names, {*lines(depth), ""})
    return "\n\n".join([_HEAD, *sections, _what_they_share(), own, both]) + "\n"


def section(block: Block, shared_names: set[str], shared_lines: set[str]) -> str:
    """What the block has for itself."""
    own = [v for v in block.of_causality("parameter") if v.name not in shared_names]
    guide = block.guide
    sources = [source.text for source in guide.sources if source.text not in shared_lines]
    equations = [line for line in guide.equations.splitlines() if line not in shared_lines]
    parts = (
        f"## {block.name}",
        f"{block.description}.",
        *([_code(equations)] if equations else []),
        _parameters(own),
        _list(line for line in (*guide.tuning, *guide.limits) if line not in shared_lines),
        *([f"Sources: {' '.join(sources)}"] if sources else []),
    )
    return "\n\n".join(parts)


def _what_they_share() -> str:
    """What stands in the guides of several, and parameters that L1DepthController has too."""
    lines, names = _shared_lines(), _shared_names()
    equations = [line for line in pid.BLOCK.guide.equations.splitlines() if line in lines]
    sentences = [
        line
        for line in dict.fromkeys(s for b in _BLOCKS for s in (*b.guide.tuning, *b.guide.limits))
        if line in lines
    ]
    variables = {v.name: v for block in _BLOCKS for v in block.of_causality("parameter") if v.name in names}
    text = "Several of these blocks have this. `L1DepthController` has all of these parameters too."
    table = _parameters(variables.values())
    return "\n\n".join(("## What they share", text, _code(equations), table, _list(sentences)))


def _shared_lines() -> set[str]:
    return _several(map(lines, _BLOCKS))


def lines(block: Block) -> list[str]:
    """Lines of the guide of a block."""
    guide = block.guide
    sources = (source.text for source in guide.sources)
    return [*guide.equations.splitlines(), *guide.tuning, *guide.limits, *sources]


def _shared_names() -> set[str]:
    """Of several blocks, but for error_bandwidth, which is a gain of both sliding modes."""
    names = _several([v.name for v in block.of_causality("parameter")] for block in _BLOCKS)
    return names - {"error_bandwidth"}


def _several(groups: Iterable[list[str]]) -> set[str]:
    counts = Counter(text for group in groups for text in set(group))
    return {text for text, count in counts.items() if count > 1}


def _code(lines: Iterable[str]) -> str:
    return "\n".join(["```text", *lines, "```"])


def _parameters(variables: Iterable[BlockVariable]) -> str:
    names = dict[tuple[str, ...], list[str]]()  # by the cells that follow: alike elements share a row
    for v in variables:
        if _TABLE.search(v.name) and not v.name.endswith("[1]"):
            continue  # of a table the first point stands for all
        unit = "" if v.unit in (None, "1") else v.unit
        start = v.enumeration(v.start).name.lower() if v.enumeration else repr(v.start)
        start = f"{v.start:.10g}" if isinstance(v.start, float) else start
        array = v.name.partition("[")[0]
        of_row = array, start, unit, v.description, v.source
        alike = names.setdefault(of_row, [])
        alike.append(v.name.removeprefix(array) if alike else v.name)
        if _TABLE.search(v.name):
            alike.append("...")
    rows = [(", ".join(f"`{name}`" for name in alike), *row) for (_, *row), alike in names.items()]
    return markdown_table(("parameter", "start", "unit", "meaning", "source"), rows)


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {sentence}" for sentence in sentences)
