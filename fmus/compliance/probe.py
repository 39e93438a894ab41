"""The process in which behaviour rules load and call an FMU: it may crash or hang, and nothing else does.

Writes a line of JSON when a rule begins and one with what it found, so that a crash loses nothing.
"""

import faulthandler
import itertools
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.here import library_here
from fmus.compliance.rule import Stage, registered
from fmus.compliance.slave import CallError, Slave
from fmus.compliance.variable import Variable, number


class Probe:
    """An FMU whose library is loaded, and what behaviour rules need of it."""

    def __init__(self, fmu: FmuFile, folder: Path) -> None:
        from fmpy.fmi2 import FMU2Slave

        self.fmu, self._resources = fmu, folder / "resources"
        identifier = (fmu.co_simulation or {}).get("modelIdentifier", "")
        self.library: Any = FMU2Slave(
            guid=fmu.guid,
            modelIdentifier=identifier,
            unzipDirectory=str(folder),
            libraryPath=str(folder / library_here(fmu)),
        )
        self._names = (f"instance {count}" for count in itertools.count(1))
        experiment = fmu.root.find("DefaultExperiment")
        get = experiment.get if experiment is not None else {}.get
        self.start_time = number(get("startTime")) or 0.0
        span = (number(get("stopTime")) or self.start_time + 1.0) - self.start_time
        self.step_size = number(get("stepSize")) or span / 1000

    @contextmanager
    def instance(self, guid: str | None = None) -> Iterator[Slave]:
        """An instance that is freed afterwards; CallError if there is none, unless the GUID is given."""
        slave = Slave(
            self.library, next(self._names), self.fmu.guid if guid is None else guid, self._resources
        )
        if not slave.exists and guid is None:
            raise CallError("fmi2Instantiate returned NULL: expected an instance")
        try:
            yield slave
        finally:
            slave.free()

    def run(self, slave: Slave, steps: int, first: int = 0) -> list[dict[str, Any]]:
        """Outputs after each of some steps from communication point number `first`."""
        rows = []
        for i in range(first, first + steps):
            slave.step(self.start_time + i * self.step_size, self.step_size)
            rows.append(slave.get(self.outputs))
        return rows

    @property
    def outputs(self) -> list[Variable]:
        return [v for v in self.fmu.variables if v.causality == "output"]

    def real(self, *causalities: str) -> list[Variable]:
        """Continuous Real variables of some causalities."""
        return [v for v in self.fmu.variables if v.causality in causalities and v.kind == "Real"]


def _write(report: Any, **line: Any) -> None:
    report.write(json.dumps(line) + "\n")
    report.flush()


def main(archive: str, folder: str, report_path: str, timeout: str, *names: str) -> None:
    """Judge the named behaviour rules; each is given `timeout` seconds, then the process ends itself."""
    from fmus.compliance import derivative_rules, lifecycle_rules, state_rules

    assert lifecycle_rules
    assert state_rules
    assert derivative_rules
    chosen = [each for each in registered(Stage.BEHAVIOUR) if each.name in names]
    fmu, probe = FmuFile(Path(archive)), None
    with Path(report_path).open("a", encoding="utf-8") as report:
        for each in chosen:
            _write(report, begins=each.name)
            faulthandler.dump_traceback_later(float(timeout), exit=True)
            try:
                probe = probe or Probe(fmu, Path(folder))
                messages = list(each.check(probe))
            except Exception as error:  # whatever a foreign library makes of a call is a finding
                messages = [str(error) or type(error).__name__]
            faulthandler.cancel_dump_traceback_later()
            _write(report, ended=each.name, messages=messages)


if __name__ == "__main__":
    main(*sys.argv[1:])
