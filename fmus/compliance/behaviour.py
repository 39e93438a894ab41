"""Judge behaviour rules in another process: a crash or a hang of the FMU is a finding."""

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from fmus.binding import platform_name
from fmus.compliance import derivative_rules, lifecycle_rules, state_rules
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.library_rules import no_co_simulation
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Result, Stage, registered
from fmus.process import Parent, ProcessEndedError, WorkerProcess

MODULES = (lifecycle_rules, state_rules, derivative_rules)
DEFAULT_TIMEOUT_S = 30.0
_START_S = 30.0  # for the interpreter, whatever the rules take


def behaviour(fmu: FmuFile, timeout: float) -> Iterator[Result]:
    """One result for each behaviour rule. timeout: seconds for one rule."""
    rules = registered(Stage.BEHAVIOUR)
    obstacle = _obstacle(fmu)
    reasons = {each.name: obstacle or each.condition(fmu) for each in rules}
    messages = _messages(fmu, [name for name, reason in reasons.items() if not reason], timeout)
    for each in rules:
        yield Result(each, tuple(messages.get(each.name, ())), reasons[each.name])


def _obstacle(fmu: FmuFile) -> str:
    """The reason why no behaviour can be judged, if there is one."""
    if fmu.archive_problem or fmu.too_large or fmu.description_problem:
        return "the FMU cannot be read"
    return no_co_simulation(fmu) or ("" if fmu.host_library else f"no library for {platform_name()}")


def _messages(fmu: FmuFile, names: Sequence[str], timeout: float) -> dict[str, list[str]]:
    """Rule name -> messages. After a crash or a hang a new process goes on with the next rule."""
    messages: dict[str, list[str]] = {}
    if not names:
        return messages
    with tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary, "unpacked")
        try:
            fmu.extract(folder)
        except Exception as error:  # an archive that is damaged anywhere
            return {name: [f"the archive cannot be unpacked: {error}"] for name in names}
        while remaining := [name for name in names if name not in messages]:
            messages.update(_judged_by_one_process(fmu.path.resolve(), folder, remaining, timeout))
    return messages


def _judged_by_one_process(
    path: Path, folder: Path, names: Sequence[str], timeout: float
) -> Iterator[tuple[str, list[str]]]:
    """Rule name and messages, up to the first rule that the process does not survive, but one at least."""
    process = WorkerProcess(judge_rules)
    limit = _START_S
    name = names[0]
    try:
        process.send((path, folder))
        process.receive(limit)
        limit = timeout
        for name in names:
            process.send(name)
            yield name, process.receive(limit)
    except TimeoutError:
        yield name, [f"the FMU took more than {limit:g} s"]
    except ProcessEndedError as ended:
        yield name, [f"the FMU ended the process with {ended}"]
    finally:
        process.close()


def judge_rules(parent: Parent) -> None:
    """Receive the paths of an FMU and of its folder, then names of rules; send each rule's messages."""
    path, folder = parent.receive()
    os.chdir(folder)  # where the FMU writes files
    rules = {rule.name: rule for rule in registered(Stage.BEHAVIOUR)}
    fmu, probe = FmuFile(path), None
    parent.send(None)  # it has started
    while True:
        rule = rules[parent.receive()]
        try:
            probe = probe or Probe(fmu, folder)
            messages = list(rule.check(probe))
        except Exception as error:  # whatever a foreign library makes of a call is a finding
            messages = [str(error) or type(error).__name__]
        parent.send(messages)
