"""The journal of many runs: a row of each as soon as it is done, so that an interruption loses nothing."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from fmus.files import write_text_atomically
from fmus.store import locked
from orchestration.errors import OrchestrationError


class Journal:
    """A file of rows for one process at a time: the context holds its lock, a file that ends in .lock.

    The first line is what is run, as plain data; then each row is a line of JSON. A line that was cut off is
    as if its run had not been made. The rows may not fit into memory: they are read one by one.
    what: the work in a message, as "sweep"; error: its exception is raised, with a remedy
    identity: key and value of `about` -> what is compared of them
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, Any],
        what: str,
        error: type[OrchestrationError] = OrchestrationError,
        identity: Callable[[str, Any], Any] = lambda key, value: value,
    ) -> None:
        self.path, self._about = path, json.loads(json.dumps(about))
        self._what, self._error, self._identity = what, error, identity
        self._lock = ExitStack()

    def __enter__(self) -> "Journal":
        lock = self.path.with_suffix(".lock")
        try:
            self._lock.enter_context(locked(lock))
        except BlockingIOError:
            raise self._error(
                f"{lock}: another process runs this {self._what}; expected its end, or another folder"
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    def begin(self) -> None:
        """Makes the file if it is missing; raises an error if it is the journal of something else."""
        if self.path.is_file():
            with self.path.open("rb") as lines:
                self.check_same(_table(lines.readline()), self.path)
        else:
            write_text_atomically(self.path, json.dumps(self._about))

    def check_same(self, stored: Mapping[str, Any], path: Path) -> None:
        """Raises an error if a file is of something else: rows of both must not be mixed."""
        if not stored:
            raise self.refusal(f"{path}: expected what is run in the first line, it is damaged")
        same = self._identity
        if keys := [
            key for key, ours in self._about.items() if same(key, ours) != same(key, stored.get(key))
        ]:
            differing = ", ".join(keys)
            raise self.refusal(f"{path} is of another {self._what} ({differing} differ): expected the same")

    def refusal(self, reason: str) -> OrchestrationError:
        """Returns the error for a file that is of no use."""
        return self._error(f"{reason}; --restart discards it")

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Appends rows."""
        lines = "".join(f"\n{json.dumps(row)}" for row in rows)  # which ends a line that was cut off
        with self.path.open("a", encoding="utf-8") as file:
            file.write(lines)

    def rows(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yields each row with its position in the file; the row of a damaged line is empty."""
        with self.path.open("rb") as lines:
            position = len(lines.readline())
            for line in lines:
                yield position, _table(line)
                position += len(line)

    def lines_at(self, positions: Iterable[int]) -> Iterator[bytes]:
        """Yields the rows at these positions, each a line of JSON."""
        with self.path.open("rb") as lines:
            for position in positions:
                lines.seek(position)
                yield lines.readline()

    def discard(self) -> None:
        """Removes the file, if there is one."""
        self.path.unlink(missing_ok=True)


def _table(line: bytes) -> dict[str, Any]:
    """Returns the table in a line, empty where it is damaged."""
    with suppress(ValueError):
        content = json.loads(line)
        return content if isinstance(content, dict) else {}
    return {}
