"""Judge behaviour rules in processes of their own: a crash or a hang is a finding, not the end."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from fmus.compliance import derivative_rules, lifecycle_rules, state_rules
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.here import library_here, platform
from fmus.compliance.rule import Level, Result, Rule, Stage, registered, rule
from fmus.process import ending

MODULES = (lifecycle_rules, state_rules, derivative_rules)
DEFAULT_TIMEOUT_S = 30.0
_TO_START_S = 30.0  # for the interpreter, whatever the rules take
_PACKAGES = str(Path(__file__).parents[2])


def _not_for_here(fmu: FmuFile) -> str:
    return "" if fmu.co_simulation is not None else "it has no co-simulation interface"


@rule("2.3 FMU Distribution (binaries)", Stage.LIBRARY, Level.WARNING, condition=_not_for_here)
def runs_on_this_platform(fmu: FmuFile) -> Iterator[str]:
    """There is a library for the platform of this check, or its behaviour is not judged."""
    if not library_here(fmu):
        found = ", ".join(sorted(set(fmu.libraries().values()))) or "none"
        yield f"libraries for {found}: without one for {platform()} the behaviour is not judged"


def behaviour(fmu: FmuFile, timeout: float) -> Iterator[Result]:
    """One result for each behaviour rule. timeout: seconds for one rule."""
    rules = registered(Stage.BEHAVIOUR)
    closed = _closed(fmu)
    reasons = {each.name: closed or each.condition(fmu) for each in rules}
    chosen = [each for each in rules if not reasons[each.name]]
    found = _exercised(fmu, chosen, timeout) if chosen else {}
    for each in rules:
        yield Result(each, tuple(found.get(each.name, ())), reasons[each.name])


def _closed(fmu: FmuFile) -> str:
    """Why no behaviour can be judged, if so."""
    if fmu.archive_problem or fmu.too_large or fmu.description_problem:
        return "the FMU cannot be read"
    return _not_for_here(fmu) or ("" if library_here(fmu) else f"no library for {platform()}")


def _exercised(fmu: FmuFile, rules: Sequence[Rule], timeout: float) -> dict[str, list[str]]:
    """Rule name -> messages. After a crash a new process goes on with the next rule."""
    found: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary, "unpacked")
        try:
            fmu.extract(folder)
        except Exception as error:  # an archive that is damaged anywhere
            return {each.name: [f"the archive cannot be unpacked: {error}"] for each in rules}
        while remaining := [each.name for each in rules if each.name not in found]:
            report = Path(temporary, "report.jsonl")
            report.write_text("")
            ending = _process(fmu.path, folder, report, timeout, remaining)
            found.update(_read(report, ending, remaining))
    return found


def _process(path: Path, folder: Path, report: Path, timeout: float, names: Sequence[str]) -> str:
    """Run the probe; in words, how it ended."""
    arguments = [path.resolve(), folder, report, timeout, *names]
    command = [sys.executable, "-m", "fmus.compliance.probe", *map(str, arguments)]
    paths = [_PACKAGES, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    streams["stderr"] = subprocess.PIPE
    limit = _TO_START_S + timeout * len(names)
    try:
        done = subprocess.run(command, check=False, cwd=folder, env=environment, timeout=limit, **streams)
    except subprocess.TimeoutExpired:
        return f"took more than {limit:g} s in all"
    said = done.stderr.decode("utf-8", "replace").splitlines()
    if any(line.startswith("Timeout (") for line in said):
        return f"took more than {timeout:g} s"
    return f"ended the process with {ending(done.returncode)}"


def _read(report: Path, ending: str, remaining: Sequence[str]) -> dict[str, list[str]]:
    """What a process told; the rule that it did not finish gets the ending as its message."""
    found: dict[str, list[str]] = {}
    begun = ""
    for line in report.read_text(encoding="utf-8").splitlines():
        told = json.loads(line)
        begun = told.get("begins", begun)
        if "ended" in told:
            found[told["ended"]] = told["messages"]
            begun = ""
    unfinished = begun or (remaining[0] if not found else "")
    if unfinished:
        found[unfinished] = [f"the FMU {ending}"]
    return found
