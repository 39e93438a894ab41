"""Runs Frama-C's Eva on a harness, and finds the block's own expression and line of each alarm."""

import re
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.errors import ExportError
from fmus.generate.c_code import c_function
from fmus.generate.operations import places_of
from fmus.generate.trace import Traced
from fmus.prove.harness import (
    LARGEST_TIME,
    REACHED,
    STAYS,
    Interval,
    Shown,
    boxes,
    free_parameters,
    harness,
    lasting,
    traced_function,
)

_OPTIONS = "-machdep gcc_x86_64 -eva -eva-precision 3 -eva-no-results -warn-special-float non-finite"
# how many states of a line Eva keeps apart: the second takes up to 20 times as long, and loses less
_SLEVELS = 20, 100
_ALARM = re.compile(r"\[eva:alarm\] \S+?:(\d+): Warning:\s+(.+?)(?=\n\S|\Z)", re.DOTALL)
_LEAVES = re.compile(rf"\[eva:alarm\] \S+ Warning:\s+check '{STAYS}(\w+)' got status \w+\.")
_LONGEST_S = 1800


@dataclass(frozen=True)
class Alarm:
    """An operation that Eva cannot prove: kind, expression in the block's names, the line that divides."""

    kind: str
    expression: str
    line: str


@dataclass(frozen=True)
class Proof:
    """The result for one block.

    staying: the states that a step from the ranges leaves in theirs; lasting: those that stay in every step
    code: the C file that was analysed; seconds: wall time of Eva
    """

    name: str
    inputs: Sequence[Interval]
    states: Sequence[Interval]
    parameters: Sequence[Interval]
    alarms: Sequence[Alarm]
    staying: Sequence[str]
    lasting: Sequence[str]
    code: str
    seconds: float

    @property
    def verdict(self) -> str:
        """The result in words."""
        if self.alarms:
            return f"{len(self.alarms)} alarms"
        if len(self.lasting) == len(self.states):
            return f"proved to {LARGEST_TIME:,.0f} s"
        return (
            f"proved for one step; {len(self.staying)} of {len(self.states)} states stay in their ranges, "
            f"{len(self.lasting)} of them to {LARGEST_TIME:,.0f} s"
        )


def proof(traced: Traced, divisions: Sequence[tuple[str, Any]], parameters: Sequence[Interval] = ()) -> Proof:
    """Returns what Eva proves of a step from every state and input of the boxes.

    divisions: line and divisor of each division, as `guard.divisions` records them
    parameters: ranges of those that do not have their start values
    Raises ExportError if Frama-C is not installed or ends without a result.
    """
    inputs, states = boxes(traced)
    code, start = harness(traced, inputs, states, parameters), time.monotonic()
    log, alarms = "", dict[Alarm, None]()
    for slevel in _SLEVELS:
        log = _frama_c(code, traced.block.name, slevel)
        alarms = dict.fromkeys(_alarms(log, code.splitlines(), traced, divisions))
        if not alarms:
            break
    leaving = {*_LEAVES.findall(log)}
    staying = [] if alarms else [box.name for box in states if box.name not in leaving]
    forever, seconds = lasting(traced, staying), time.monotonic() - start
    return Proof(traced.block.name, inputs, states, parameters, [*alarms], staying, forever, code, seconds)


def freed(traced: Traced, divisions: Sequence[tuple[str, Any]], result: Proof) -> Proof:
    """Returns the proof with all parameters in their ranges, or without a smallest set of fixed ones.

    result: the proof of the start values, without an alarm
    """
    boxes = free_parameters(traced)

    def attempt(fixed: Sequence[Interval]) -> Proof:
        return proof(traced, divisions, [box for box in boxes if box not in fixed])

    def needed(some: list[Interval], fixed: list[Interval]) -> list[Interval]:
        """Returns a smallest part of some to fix as well."""
        if not some or not attempt(fixed).alarms:
            return []
        if len(some) == 1:
            return some
        first, second = some[: len(some) // 2], some[len(some) // 2 :]
        of_second = needed(second, fixed + first)
        return needed(first, fixed + of_second) + of_second

    fixed = needed(boxes, [])
    return result if len(fixed) == len(boxes) else attempt(fixed)


def _frama_c(code: str, name: str, slevel: int) -> str:
    with tempfile.TemporaryDirectory(prefix="l1-depth-prove-") as folder:
        # by its whole path: frama-c looks into the folder of the shell, PWD
        file = Path(folder) / "harness.c"
        file.write_text(code, encoding="utf-8")
        command = ["frama-c", *_OPTIONS.split(), "-eva-slevel", str(slevel), str(file)]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=_LONGEST_S
            )
        except FileNotFoundError:
            raise ExportError("frama-c is not installed: expected Debian's package frama-c-base") from None
        except subprocess.TimeoutExpired:
            raise ExportError(f"{name}: Eva did not end within {_LONGEST_S} s") from None
    # the colon: a warning names the function, too
    if done.returncode or not (f"{REACHED}:" in done.stdout or "[eva:alarm]" in done.stdout):
        raise ExportError(f"{name}: frama-c has no result: {(done.stdout + done.stderr).strip()[-1000:]}")
    return done.stdout


def _alarms(
    log: str, lines: Sequence[str], traced: Traced, divisions: Sequence[tuple[str, Any]]
) -> Iterator[Alarm]:
    shown = Shown(traced)
    for number, text in _ALARM.findall(_LEAVES.sub("", log)):
        kind, _, condition = " ".join(text.split()).partition(". assert ")
        index = int(number) - 1
        head = next((h for h in reversed(lines[:index]) if h.startswith("static void block_")), "")
        found = re.match(r"static void block_(\w+)", head)
        operation = re.match(r"\s*v(\d+) = ", lines[index])
        if not found or not operation:
            yield Alarm(kind, condition, "")
            continue
        function = traced_function(traced, found[1])
        f, at = c_function(function, found[1]), int(operation[1])
        places = places_of(function, [divisor for _, divisor in divisions])
        divides = f.operations[at].name in ("DIV", "INV")
        place = places.get(f.operations[at].arguments[-1]) if divides else None
        yield Alarm(kind, shown.expression(f, at), "" if place is None else divisions[place][0])
