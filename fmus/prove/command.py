"""The command line of the proof: `l1-depth prove`."""

from pathlib import Path
from typing import Annotated

import typer

from fmus.errors import range_text

PANEL = "FMUs"  # of the help of l1-depth


def prove(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME|FILE.py", help="Installed blocks or Python files with blocks."),
    ],
    assumptions: Annotated[
        bool, typer.Option("--assumptions", help="Print the range of every input and state.")
    ] = False,
    parameters: Annotated[
        bool,
        typer.Option(
            "--parameters", help="Prove for all parameters of their ranges; name those that must be fixed."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder for an FMU of each block, with the result as a page inside."
        ),
    ] = None,
    fmi: Annotated[int, typer.Option("--fmi", help="Version of FMI of these FMUs: 2 or 3.")] = 2,
) -> None:
    """Prove that a step of a block has no run-time error: no NaN, infinity, overflow or undefined behaviour.

    Frama-C's Eva (Debian's frama-c-base) analyses the C of the block: the initial state, one internal step
    and the outputs, from every Real input and state of ranges, which --assumptions prints. Inputs of other
    types have their start values, and so have parameters without --parameters; the step has the suggested
    size. --assumptions names the states that stay in their ranges: in a step, or to 1,000,000 s. ESBMC (extra
    prove) checks the bounds of all accesses of one internal step. A number that is not finite is an alarm
    also where no result takes it.

    Prints a line for each block, then each alarm with the expression and the line that divides.
    The exit status is 0 without an alarm, else 1.
    For example, l1-depth prove ExamplePlant.
    """
    from fmus.generate import guard
    from fmus.generate.builder import build_block, loaded
    from fmus.prove.esbmc import bounds
    from fmus.prove.eva import freed, proof
    from fmus.prove.page import add_page

    failed = False
    for name in names:
        with guard.divisions() as divisions, loaded(name) as blocks:
            for traced in blocks:
                result = proof(traced, divisions)
                if parameters and not result.alarms:
                    result = freed(traced, divisions, result)
                count, outside = bounds(result.code, result.name)
                print(f"{result.name}: Eva: {result.verdict}; {result.seconds:.1f} s", flush=True)
                said = f"{len(outside)} of {count} accesses out of bounds"
                print(f"    ESBMC: {said}")
                print(*(f"        {text}" for text in outside), sep="\n", end="\n" if outside else "")
                for alarm in result.alarms:
                    print(f"    {alarm.kind}: {alarm.expression}")
                    print(f"        {alarm.line}" if alarm.line else "        no line is known", flush=True)
                for box in (*result.inputs, *result.states, *result.parameters) if assumptions else ():
                    print(f"    assumed: {box.name} {range_text(box.low, box.high)}, {box.reason}")
                if parameters:
                    free = {box.name for box in result.parameters}
                    fixed = (v.name for v in traced.block.of_causality("parameter") if v.name not in free)
                    print(f"    {len(free)} parameters in their ranges; fixed: {', '.join(fixed)}")
                if assumptions:
                    print(f"    stay in every step: {', '.join(result.lasting) or 'none'}")
                    print(f"    stay in a step: {', '.join(result.staying) or 'none'}")
                if out:
                    repeat = f"{Path(name).name}{' --parameters' if parameters else ''}"
                    add_page(build_block(traced.block, out, fmi=fmi), result, said, repeat)
                failed |= bool(result.alarms or outside)
    raise typer.Exit(int(failed))
