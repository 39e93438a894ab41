"""FMUs loaded with FMPy and driven call by call."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

from fmus.registry import Flavour


class Loaded:
    """An FMU loaded by FMPy, its variables by name, its log lines kept."""

    def __init__(self, path: Path, folder: Path, name: str = "it", logging: bool = True) -> None:
        description: Any = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), folder)
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.log: list[str] = []
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.allocateMemory = defaultCallbacks.allocateMemory
        self._callbacks.freeMemory = defaultCallbacks.freeMemory
        self._callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda environment, instance, status, category, text: self.log.append(text.decode())
        )
        self.slave: Any = FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.slave.instantiate(callbacks=self._callbacks, loggingOn=logging)
        self._alive = True

    def initialize(self) -> "Loaded":
        """Leads to initialization mode."""
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        return self

    def begin(self) -> "Loaded":
        """Leads to step mode."""
        self.initialize().slave.exitInitializationMode()
        return self

    def __getitem__(self, name: str) -> float:
        return self.slave.getReal([self.references[name]])[0]

    def __setitem__(self, name: str, value: float) -> None:
        self.slave.setReal([self.references[name]], [value])

    def status(self, call: str, *arguments: Any) -> str:
        """What a method of FMPy's slave gives: ok, or the status that FMPy raises."""
        try:
            getattr(self.slave, call)(*arguments)
        except FMICallException as error:
            return ("ok", "warning", "discard", "error", "fatal")[error.status]
        return "ok"

    def free(self) -> None:
        """Free the instance; a second time does nothing."""
        if self._alive:
            self._alive = False
            self.slave.freeInstance()


@pytest.fixture
def load(tmp_path: Path) -> Iterator[Any]:
    loaded: list[Loaded] = []

    def one(path: Path, **options: Any) -> Loaded:
        loaded.append(Loaded(path, tmp_path / f"fmu{len(loaded)}", f"it{len(loaded)}", **options))
        return loaded[-1]

    yield one
    for fmu in loaded:
        fmu.free()


@pytest.fixture(params=list(Flavour))
def either(
    request: pytest.FixtureRequest, built: Mapping[str, Path], python_built: Mapping[str, Path]
) -> Mapping[str, Path]:
    """The FMUs of one flavour, then of the other."""
    return built if request.param is Flavour.NATIVE else python_built
