"""The command line of the proof: `l1-depth prove`."""

from typing import Annotated

import typer

PANEL = "FMUs"  # of the help of l1-depth


def prove(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME|FILE.py", help="Installed blocks or Python files with blocks."),
    ],
    assumptions: Annotated[
        bool, typer.Option("--assumptions", help="Print the range of every input and state.")
    ] = False,
) -> None:
    """Prove that a step of a block has no run-time error: no NaN, infinity, overflow or undefined behaviour.

    Frama-C's Eva (Debian's frama-c-base) analyses the C of the block: the initial state, one internal step
    and the outputs, from every Real input and state of ranges, which --assumptions prints. Parameters and
    other inputs have their start values, the step has the suggested size. That a run stays in these ranges is
    not proved. A number that is not finite is an alarm also where no result takes it.

    Prints a line for each block, then each alarm with the expression and the line that divides.
    The exit status is 0 without an alarm, else 1.
    For example, l1-depth prove ExamplePlant.
    """
    from fmus.generate import guard
    from fmus.generate.builder import loaded
    from fmus.prove.eva import proof

    failed = False
    for name in names:
        with guard.divisions() as divisions, loaded(name) as blocks:
            for traced in blocks:
                result = proof(traced, divisions)
                verdict = f"{len(result.alarms)} alarms" if result.alarms else "proved for one step"
                print(f"{result.name}: {verdict}, {result.seconds:.1f} s", flush=True)
                for alarm in result.alarms:
                    print(f"    {alarm.kind}: {alarm.expression}")
                    print(f"        {alarm.line}" if alarm.line else "        no line is known", flush=True)
                for box in (*result.inputs, *result.states) if assumptions else ():
                    print(f"    assumed: {box.name} in {box.low:g}..{box.high:g}, {box.reason}")
                failed |= bool(result.alarms)
    raise typer.Exit(int(failed))
