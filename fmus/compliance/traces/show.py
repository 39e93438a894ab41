"""Calls that show a finding, made again in new processes and shortened there."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe, Shared
from fmus.compliance.rule import NotJudgedError, Shown, messages_of
from fmus.compliance.script import CallError, DefectError, Script
from fmus.compliance.texts import defect
from fmus.compliance.traces.cases import case_of_subject
from fmus.compliance.traces.programs import shown
from fmus.compliance.traces.replay import FREE, ShortTrace
from fmus.compliance.traces.shrink import shrunk, shrunk_crash
from fmus.fmi.process import ProcessEndedError

NewProbe = Callable[[], AbstractContextManager[Probe]]
"""Gives a probe whose process ends with the context."""
_OF_CALLS = TimeoutError, CallError, DefectError, NotJudgedError


def what_shows(fmu: FmuFile, message: str, shared: Sequence[Shared], new_probe: NewProbe) -> Shown:
    """Returns the calls that show a finding, or the reason why they are not shown."""
    try:
        if trace := _trace(fmu, message, shared, new_probe):
            return shown(trace, fmu, message)
    except (*_OF_CALLS, ProcessEndedError) as error:
        return Shown(reason=f"they do not show it again: {error}")
    except Exception as error:
        # the finding stays where what shows it has a defect
        return Shown(reason=defect(error))
    return Shown(reason="none are known that show it alone")


def _trace(fmu: FmuFile, message: str, shared: Sequence[Shared], new_probe: NewProbe) -> ShortTrace | None:
    for one in shared:
        groups = one.crashes.get(message, ())
        if group := next((some for some in groups if _ends(some, new_probe)), None):
            return shrunk_crash(fmu, group, lambda scripts: _ends(scripts, new_probe), FREE in message)
    for one in shared:
        if case := _known(one.cases, message):
            with new_probe() as probe:
                return shrunk(probe, case)
    for one in shared:
        if case := case_of_subject(one, _known(one.subjects, message), message):
            with new_probe() as probe:
                return shrunk(probe, case)
    return None


def _known(by_message: dict[str, Any], message: str) -> Any:
    """Returns what belongs to a message, which a result has on one line and with a count."""
    known = (key for key in by_message if message.startswith(messages_of([key])[0]))
    return next((by_message[key] for key in known), None)


def _ends(scripts: Sequence[Script], new_probe: NewProbe) -> bool:
    """Whether scripts that are played side by side end a new process."""
    try:
        with new_probe() as probe:
            probe.play(*scripts, keep_going=True)
    except ProcessEndedError:
        return True
    except _OF_CALLS:
        pass
    return False
