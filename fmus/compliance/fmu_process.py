"""The process that calls an FMU: started, asked, timed and ended."""

import re
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmus.compliance.script import CallError, DefectError
from fmus.compliance.texts import DEFECT
from fmus.fmi.process import WorkerProcess

Call = tuple[Any, ...]  # a method of `LoadedFmu` and its arguments
START_S = 60.0  # for the interpreter, whatever the rules take
_POLL_S = 0.01
_DECIMALS = re.compile(r"\b\d+\.\d+(?:e[+-]?\d+)?")


class FmuProcess:
    """The process that calls the FMU.

    library: the paths of library and resources, fmi2Type, the functions that may be missing, and elements of
    FMI 3.0, or None
    limit: seconds from `allow` on until TimeoutError is raised; ProcessEndedError after its end
    one_instance: whether instances are created in a new process, but for others of the same calls
    """

    def __init__(self, library: tuple[Path, Path, int, list[str], Any], one_instance: bool) -> None:
        self.allow(START_S)
        self._library, self.one_instance = library, one_instance
        self._start()

    def _start(self) -> None:
        from fmus.compliance.instance import CALLED, call_fmu

        self._process = WorkerProcess(call_fmu, trusted=False)
        self._has_created = False
        self._called = self._process.folder / CALLED
        self._process.send((self._process.folder, *self._library))

    def allow(self, limit: float) -> None:
        """Waits for the answers from now on no longer than some seconds."""
        self.limit, self._deadline = limit, time.monotonic() + limit

    def calls(self, calls: Sequence[Call]) -> list[Any]:
        """Returns the results of calls of `LoadedFmu`. Raises CallError for the first that fails."""
        creates = any(method == "create" for method, *_ in calls)
        if creates and self.one_instance and self._has_created:
            self._start_anew()
        self._has_created |= creates
        self._process.send(calls)
        try:
            answer = self._process.receive(max(0.0, self._deadline - time.monotonic()))
        except ValueError as error:
            answer = str(error)
        match answer:
            case [[*results], None] if len(results) == len(calls):
                return results
            case [[*_], str(error)]:
                raise DefectError(error) if error.startswith(DEFECT) else CallError(error)
        raise CallError(f"the process of the FMU sent {str(answer)[:100]!r}: expected results of the calls")

    def _start_anew(self) -> None:
        """Continues in a new process, whose start does not count for the limit."""
        left = self._deadline - time.monotonic()
        self.close()
        self._deadline = time.monotonic() + START_S
        self._start()
        self.calls([])  # it has started
        self._deadline = time.monotonic() + left

    @contextmanager
    def in_new_processes(self) -> Iterator[None]:
        """Yields a context in which each instance is the first of its process."""
        before, self.one_instance, self._has_created = self.one_instance, True, True
        try:
            yield
        finally:
            self.one_instance = before

    def hangs(self, seconds: float) -> bool:
        """Whether the call that is under way takes longer; this waits for its end if necessary."""
        began, _ = self._under_way()
        while began and time.time() - began < seconds:
            time.sleep(_POLL_S)
            if self._under_way()[0] != began:
                return False
        return began > 0

    def _under_way(self) -> tuple[float, bytes]:
        """Returns the start time of the call that is under way, or 0, and its text."""
        from fmus.compliance.instance import BEGAN

        try:
            content = self._called.read_bytes()
            return BEGAN.unpack_from(content)[0], content[BEGAN.size :]
        except (OSError, struct.error):
            return 0.0, b""

    @property
    def call_under_way(self) -> str:
        """The call that is under way, with its arguments, or ""."""
        began, call = self._under_way()
        text = call.split(b"\0", 1)[0].decode("utf-8", "replace").replace("None", "NULL") if began else ""
        return _DECIMALS.sub(lambda match: f"{float(match[0]):.9g}", text)

    def close(self) -> None:
        self._process.close()
