"""The evaluations of a tuning that are done, a line each, so that it continues after an interruption.

The first line is what is tuned; a line that was cut off is as if its evaluation had not been made.
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from fmus.files import write_text_atomically
from orchestration.errors import OrchestrationError

Key = tuple[int, int]
"""(seed, number of the evaluation from 0)."""

_DISCARD = "--restart discards it"


class Journal:
    """The file of one tuning.

    tuned: plain data; OrchestrationError if the file is the journal of something else
    Two processes that run the same tuning add the same lines: the cost is a function of the gains.
    """

    def __init__(self, path: Path, tuned: Mapping[str, Any]) -> None:
        self.path, self._tuned = path, json.loads(json.dumps(tuned))

    def begin(self) -> dict[Key, dict[str, Any]]:
        """The evaluations that are done already; the file is made if it is missing."""
        if not self.path.is_file():
            write_text_atomically(self.path, json.dumps(self._tuned))
            return {}
        first, *lines = [_table_of(line) for line in self.path.read_text("utf-8", "replace").split("\n")]
        if first != self._tuned:
            differing = ", ".join(key for key in self._tuned if first.get(key) != self._tuned[key])
            raise OrchestrationError(
                f"{self.path} is of another tuning ({differing} differ): expected the same; {_DISCARD}"
            )
        return {(row["seed"], row["evaluation"]): row for row in lines if "cost" in row}

    def add(self, row: Mapping[str, Any]) -> None:
        """Store an evaluation: its seed, evaluation, gains and cost."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"\n{json.dumps(row)}")  # the line break ends a line that was cut off


def _table_of(line: str) -> dict[str, Any]:
    with suppress(ValueError):
        content = json.loads(line)
        return content if isinstance(content, dict) else {}
    return {}
