"""Names and texts that the process of the FMU and the process that judges share.

It imports little, because a check starts several processes.
"""

import re
from array import array
from collections.abc import Sequence

ALLOCATIONS = 400_000
"""Number of objects between two collections of garbage: a check keeps most of what it makes."""

USUAL_NAME = "instance"
STEPS = ("do_step", "do_steps")
VECTORS = (
    "fmi2GetContinuousStates", "fmi2GetDerivatives", "fmi2GetEventIndicators",
    "fmi2GetNominalsOfContinuousStates",
)  # fmt: skip
UNWRITTEN = "values"  # among what a call changed: those that were asked for were not
ARGUMENTS, PENDED = "arguments", "pending step"  # among what a call changed

DEFECT = "the rule failed by a defect of this checker"
# names of temporary folders are random: a finding would be another one in each run
_PREFIXES = "fmu-check-", "l1-depth-process-"
_TEMPORARY = re.compile(
    rf"(file:/*(?=/))?(?:[A-Za-z]:)?(?:[/\\]+[^/\\\s:'\"]+)*[/\\]+(?:{'|'.join(_PREFIXES)})\w{{8}}"
    r"([/\\]+unpacked)?([/\\]+)?"
)


def defect(error: Exception) -> str:
    """Returns the reason why a rule that raises an error is not judged: the fault is not the FMU's."""
    return f"{DEFECT} ({type(error).__name__}: {error}), not by the FMU: please report it"


def packed(numbers: Sequence[float]) -> str:
    """Returns the bytes of numbers as hexadecimal digits: a process sends them faster than as decimals."""
    return array("d", numbers).tobytes().hex()


def unpacked(digits: str) -> list[float]:
    """Returns the numbers of `packed`. Raises ValueError for another text."""
    return array("d", bytes.fromhex(digits)).tolist()


def without_folders(text: str) -> str:
    """Returns a text with paths relative to the unpacked FMU, and "..." for other temporary folders."""

    def shown(match: re.Match[str]) -> str:
        scheme, unpacked, end = match.groups("")
        return "" if unpacked and end and not scheme else f"{scheme and scheme + '/'}...{end}"

    return _TEMPORARY.sub(shown, text) if any(prefix in text for prefix in _PREFIXES) else text
