"""A communication step of two states of this project, in turns: `python -m tests.speed.steps OLD [NEW]`.

Each is a git revision, whose FMUs are built in a folder of their own, a clone, or a folder with FMUs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import typer
from rich.table import Table

from fmus.platforms import host_platform
from orchestration.errors import OrchestrationError
from orchestration.fmi.description import describe, of_causality
from tests.printing import print_tables
from tests.speed.programs import C_SOURCES, compile_program, extracted, output_of, workplace
from tests.speed.states import ROOT, python, sources

_BLOCKS = ("RovDepthPlant", "L1DepthController")
_BUILD = "import sys; sys.argv.insert(1, 'build'); from orchestration.cli import main; main()"


@dataclass(frozen=True)
class Steps:
    """CPU time of a step of each build [ns], a value a round; whether all outputs are equal bit for bit."""

    block: str
    old: Sequence[float]
    new: Sequence[float]
    are_equal: bool

    @property
    def ratios(self) -> list[float]:
        """New to old, of rounds in which both took turns."""
        return [new / old for old, new in zip(self.old, self.new, strict=True)]


def fmus(state: str, blocks: Sequence[str], folder: Path) -> Path:
    """A folder with the FMUs of blocks in a state of the project: a revision, a clone, or FMUs."""
    if list(Path(state).glob("*.fmu")):
        return Path(state).absolute()
    built = folder / "built"
    process = python(_BUILD, sources(state, folder), folder, *blocks, "--out", str(built))
    output, _ = process.communicate()
    if process.returncode:
        raise OrchestrationError(f"{state}: the build failed: {output}")
    return built


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


def table(measured: Sequence[Steps]) -> Table:
    """Medians over the rounds; of the ratio also the half of the rounds in the middle."""
    result = Table(title="A communication step")
    for heading in ("Block", "ns before", "ns now", "ratio", "results"):
        result.add_column(heading, justify="left" if heading in ("Block", "results") else "right")
    for steps in measured:
        ratios = sorted(steps.ratios)
        quarter = len(ratios) // 4
        spread = f"{median(ratios):.3f} ({ratios[quarter]:.3f} to {ratios[-1 - quarter]:.3f})"
        times = f"{median(steps.old):.0f}", f"{median(steps.new):.0f}"
        result.add_row(steps.block, *times, spread, "equal" if steps.are_equal else "differ")
    return result


def main(
    old: Annotated[str, typer.Argument(help="Revision, folder of a clone, or folder of FMUs.")],
    new: Annotated[str, typer.Argument(help="The same; by default this clone.")] = str(ROOT),
    block: Annotated[list[str] | None, typer.Option(help="Block with Real inputs and outputs.")] = None,
    count: Annotated[int, typer.Option(help="Steps of a round.", min=1)] = 20_000,
    rounds: Annotated[int, typer.Option(help="Of which the median is taken.", min=1)] = 101,
    markdown: Annotated[bool, typer.Option(help="Print the table of docs/performance.md.")] = False,
) -> None:
    """Compare the communication steps of two builds."""
    blocks = block or [*_BLOCKS]
    with workplace() as folder:
        folders = folder / "first", folder / "second"
        for path in folders:
            path.mkdir()
        first, second = (fmus(state, blocks, path) for state, path in zip((old, new), folders, strict=True))
        compile_program(folder, "steps", [str(C_SOURCES / "steps.c")], includes=[])
        print_tables([table([compared(b, first, second, folder, count, rounds) for b in blocks])], markdown)


if __name__ == "__main__":
    typer.run(main)
