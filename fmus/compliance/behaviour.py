"""Judge behaviour rules in another process: a crash or a hang of the FMU is a finding."""

import errno
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fmus.binding import platform_name
from fmus.compliance import derivative_rules, lifecycle_rules, reference_rules, state_rules
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.library_rules import no_co_simulation
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Result, Rule, Stage, messages_of, registered
from fmus.errors import HostError
from fmus.process import ProcessEndedError

MODULES = (lifecycle_rules, state_rules, derivative_rules, reference_rules)
DEFAULT_TIMEOUT_S = 30.0
_OF_THE_HOST = ("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EMFILE", "ENFILE", "EIO", "ENOMEM", "EAGAIN")
_START_S = 60.0  # for the interpreter, whatever the rules take


def behaviour(fmu: FmuFile, timeout: float) -> Iterator[Result]:
    """One result for each behaviour rule. timeout: seconds for one rule."""
    rules = registered(Stage.BEHAVIOUR)
    obstacle = _obstacle(fmu)
    reasons = {rule.name: obstacle or rule.condition(fmu) for rule in rules}
    messages = _messages(fmu, [name for name, reason in reasons.items() if not reason], timeout)
    for rule in rules:
        yield Result(rule, messages.get(rule.name, ()), reasons[rule.name])


def _obstacle(fmu: FmuFile) -> str:
    """The reason why no behaviour can be judged, if there is one."""
    if fmu.archive_problem or fmu.too_large or fmu.description_problem:
        return "the FMU cannot be read"
    return no_co_simulation(fmu) or ("" if fmu.host_library else f"no library for {platform_name()}")


def _messages(fmu: FmuFile, names: Sequence[str], timeout: float) -> dict[str, tuple[str, ...]]:
    """Rule name -> messages. After a crash or a hang a new process goes on with the next rule."""
    messages: dict[str, tuple[str, ...]] = {}
    if not names:
        return messages
    with host_errors(), _temporary_folder() as temporary:
        folder = Path(temporary, "unpacked")
        try:
            with host_errors():
                fmu.extract(folder)
        except HostError:
            raise
        except Exception as error:  # an archive that is damaged anywhere
            return dict.fromkeys(names, (f"the archive cannot be unpacked: {error}",))
        while remaining := [name for name in names if name not in messages]:
            messages.update(_judged_by_one_process(fmu, folder, remaining, timeout))
    return messages


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True)
    except OSError as error:  # also FileNotFoundError, where no folder takes a file
        raise HostError(f"{error}: expected a folder for temporary files") from error


@contextmanager
def host_errors() -> Iterator[None]:
    """A context in which a full disk, or another lack of the machine, is a HostError."""
    try:
        yield
    except OSError as error:
        if errno.errorcode.get(error.errno or 0) in _OF_THE_HOST:
            raise HostError(f"{error}: expected disk space and a process for the check") from error
        raise


def _judged_by_one_process(
    fmu: FmuFile, folder: Path, names: Sequence[str], timeout: float
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Rule name and messages, up to the first rule that the process does not survive, but one at least."""
    rules = {rule.name: rule for rule in registered(Stage.BEHAVIOUR)}
    probe = Probe(fmu, folder, time.monotonic() + _START_S)
    name, limit = names[0], _START_S
    try:
        probe.process.calls([])  # it has started
        limit = timeout
        for name in names:
            probe.process.deadline = time.monotonic() + limit
            yield name, _judge(rules[name], probe)
    except TimeoutError:
        yield name, (f"the FMU took more than {limit:g} s",)
    except ProcessEndedError as ended:
        yield name, (f"the FMU ended the process with {ended}",)
    finally:
        probe.process.close()


def _judge(rule: Rule, probe: Probe) -> tuple[str, ...]:
    try:
        return messages_of(rule.check(probe))
    except (TimeoutError, ProcessEndedError):
        raise
    except Exception as error:  # whatever an FMU answers is a finding
        return messages_of([str(error) or type(error).__name__])
