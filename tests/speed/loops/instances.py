"""The two FMUs loaded by FMPy, for loops that are written around its `FMU2Slave`."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave

from tests.speed.pair import LEVEL, SIGNAL, Pair


@contextmanager
def loaded(pair: Pair) -> Iterator[tuple[FMU2Slave, FMU2Slave, int, int]]:
    """Both instances, ready to step, and the value references of input and output."""
    with ExitStack() as stack:
        instances: list[FMU2Slave] = []
        references: dict[str, int] = {}
        for name, path in pair.fmus.items():
            folder = stack.enter_context(TemporaryDirectory())
            description: Any = fmpy.read_model_description(str(path))
            references = {v.name: v.valueReference for v in description.modelVariables}
            instance = FMU2Slave(
                guid=description.guid,
                unzipDirectory=fmpy.extract(str(path), folder),
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=name,
            )
            stack.callback(instance.freeInstance)
            instance.instantiate()
            instance.setupExperiment(startTime=0.0)
            instance.enterInitializationMode()
            instance.exitInitializationMode()
            instances.append(instance)
        first, second = instances
        yield first, second, references[SIGNAL], references[LEVEL]
