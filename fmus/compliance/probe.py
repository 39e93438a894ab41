"""The FMU that behaviour rules examine: its library is loaded, its instances are created and stepped."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fmus.binding import Callbacks, CountingAllocator, Library
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.instance import CallError, CheckedInstance
from fmus.compliance.variable import Variable, number


class Probe:
    """An unpacked FMU whose library is loaded.

    memory: of all its instances; start_time, step_size: of the default experiment [s]
    """

    def __init__(self, fmu: FmuFile, folder: Path) -> None:
        self.fmu, self._resources = fmu, folder / "resources"
        self.library, self.memory = Library(folder / fmu.host_library), CountingAllocator()
        self._names = (f"instance {count}" for count in itertools.count(1))
        experiment = fmu.root.find("DefaultExperiment")
        get = experiment.get if experiment is not None else {}.get
        self.start_time = number(get("startTime")) or 0.0
        span = (number(get("stopTime")) or self.start_time + 1.0) - self.start_time
        self.step_size = number(get("stepSize")) or span / 1000

    @contextmanager
    def instance(self) -> Iterator[CheckedInstance]:
        """An instance that is freed afterwards; CallError if the FMU returns none."""
        instance = CheckedInstance(self.library, Callbacks(self.memory, asynchronous=True))
        try:
            if not instance.instantiate(next(self._names), self.fmu.guid, self._resources, logging_on=False):
                raise CallError("fmi2Instantiate returned NULL: expected an instance")
            yield instance
        finally:
            instance.free()

    def accepts(self, guid: str) -> bool:
        """Whether the FMU creates an instance for a GUID."""
        instance = CheckedInstance(self.library, Callbacks(self.memory, asynchronous=True))
        accepted = instance.instantiate(next(self._names), guid, self._resources, logging_on=False)
        instance.free()
        return accepted

    def run(self, instance: CheckedInstance, steps: int, first: int = 0) -> list[dict[str, Any]]:
        """Outputs after each of some steps from communication point number `first`."""
        rows = []
        for i in range(first, first + steps):
            instance.do_step(self.start_time + i * self.step_size, self.step_size)
            rows.append(instance.get(self.outputs))
        return rows

    @property
    def outputs(self) -> list[Variable]:
        return [v for v in self.fmu.variables if v.causality == "output"]

    def real(self, causality: str) -> list[Variable]:
        """The Real variables of a causality."""
        return [v for v in self.fmu.variables if v.causality == causality and v.kind == "Real"]
