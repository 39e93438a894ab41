"""Other people's importers: each runs an SSP package and reports outputs.

A function for each, which imports its importer when it is called: in a process of its own, by `run_job`.
"""

import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from numpy.typing import ArrayLike

from fmus.fmi.process import Parent
from orchestration.exchange.ssp_xml import STRUCTURE, tag

_NANOSECOND = 1e-9


@dataclass(frozen=True)
class ImporterJob:
    """Run a package from its start to its stop time and report outputs.

    parameter_set: name of the set that the importer is told to apply; by default none
    outputs: (component, variable); a component of a system in the system is "system.component"
    start_time, stop_time, step_size: s
    report_every: steps from one reported value to the next
    """

    package: Path
    outputs: tuple[tuple[str, str], ...]
    start_time: float
    stop_time: float
    step_size: float
    parameter_set: str = ""
    report_every: int = 1

    @property
    def reports(self) -> int:
        return round((self.stop_time - self.start_time) / self.step_size) // self.report_every


@dataclass(frozen=True)
class Trajectory:
    """Values of the outputs at the importer's times [s], and what the importer and the FMUs printed.

    values: a row for each time, a column for each output
    """

    time: np.ndarray
    values: np.ndarray
    printed: str = ""


Reports = tuple[ArrayLike, ArrayLike]  # times and values


def ecos(job: ImporterJob) -> Reports:
    """Ecos through `ecospy`: Jacobi, initial exchange, times by adding up steps.

    It knows no enumerations, and applies a parameter set only when it is named: without, start values hold.
    """
    from ecospy.EcosSimulation import EcosSimulation

    outputs = [f"{component}::{variable}" for component, variable in job.outputs]
    with EcosSimulation(ssp_path=str(job.package), step_size=job.step_size) as simulation:
        start: Any = job.start_time  # declared as int, handed on as double
        if not simulation.init(start, *filter(None, [job.parameter_set])):
            raise RuntimeError("the initialisation failed")
        time, values = [job.start_time], [[simulation.get_real(output) for output in outputs]]
        for _ in range(job.reports):
            time.append(simulation.step(job.report_every))
            values.append([simulation.get_real(output) for output in outputs])
    return time, values


def fmpy_ssp(job: ImporterJob) -> Reports:
    """FMPy's own SSP master, `fmpy.ssp`, which reports every step.

    It reads components and connections, ignores parameter bindings (start values hold), starts every
    connector at zero without initial exchange, and labels a row with the time before the step whose result it
    holds.
    """
    from fmpy.ssp.simulation import simulate_ssp
    from fmpy.ssp.ssd import read_ssv

    parameter_set = None
    if job.parameter_set:
        parameter_set = read_ssv(str(job.package), f"parameters/{job.parameter_set}.ssv")
        for parameter in parameter_set.parameters:
            if parameter.type == "Boolean":  # FMPy takes every text but a number for true
                parameter.value = parameter.value in ("true", "1")
    times = job.start_time, job.stop_time, job.step_size
    result = simulate_ssp(str(job.package), *times, parameter_set=parameter_set)
    return result["time"], np.column_stack([result[".".join(output)] for output in job.outputs])


def libcosim(job: ImporterJob) -> Reports:
    """OSP's libcosim through `libcosimpy`: Jacobi, initial exchange, times in whole nanoseconds.

    It knows neither enumerations nor parameter bindings of the system, only those of components.
    """
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    execution = CosimExecution.from_ssp_file(str(job.package), round(job.step_size / _NANOSECOND))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    outputs: list[tuple[int, int]] = []
    for component, variable in job.outputs:
        instance = execution.slave_index_from_instance_name(component)
        if instance is None:
            raise RuntimeError(f"no component {component!r} in the package")
        variables = execution.slave_variables(instance)
        outputs += [(instance, v.reference) for v in variables if v.name.decode() == variable]
    time, values = [], []
    for _ in range(job.reports):
        if not execution.step(job.report_every):
            raise RuntimeError(f"a step failed at {execution.status().current_time} ns")
        time.append(job.start_time + execution.status().current_time * _NANOSECOND)
        values.append([observer.last_real_values(own, [reference])[0] for own, reference in outputs])
    return time, values


def omsimulator(job: ImporterJob) -> Reports:
    """OMSimulator 3: its master `oms_ma`; it ignores the step size that packages of version 2 annotate."""
    from OMSimulator import SSP, CRef  # pyright: ignore[reportMissingImports]

    package = SSP(str(job.package))
    model = package.instantiate()
    model.setResultFile("")
    if b'"ModelExchange"' not in zipfile.ZipFile(job.package).read(
        STRUCTURE
    ):  # CVode chooses its steps there
        model.setFixedStepSize(job.step_size)
    root = package.activeVariant.system.name
    outputs = [CRef(root, *component.split("."), variable) for component, variable in job.outputs]
    model.initialize()
    time, values = [model.getTime()], [[model.getValue(output) for output in outputs]]
    while len(time) <= job.reports:
        for _ in range(job.report_every):
            model.doStep()
        time.append(model.getTime())
        values.append([model.getValue(output) for output in outputs])
    model.terminate()
    model.delete()
    return time, values


def fmucontainer(job: ImporterJob) -> Reports:
    """`fmucontainer` of the FMU manipulation toolbox: all FMUs in one container FMU, which FMPy then runs.

    It reads components and connections, and no values (start values hold). A package gives its container no
    output: those that are reported are added.
    """
    from fmu_manipulation_toolbox.assembly import Assembly

    interval = job.report_every * job.step_size
    with tempfile.TemporaryDirectory() as folder:
        package = Path(shutil.copy(job.package, Path(folder, "loop.ssp")))
        assembly = Assembly(package.name, default_step_size=job.step_size, fmu_directory=Path(folder))
        assert assembly.root is not None
        fmus = {name: Path(source).name for name, source in _sources(package).items()}
        outputs = [f"output{number}" for number in range(len(job.outputs))]
        for (component, variable), output in zip(job.outputs, outputs, strict=True):
            assembly.root.add_output(f"loop.dir/{fmus[component]}", variable, output)
        assembly.make_fmu()
        result = fmpy.simulate_fmu(
            str(Path(folder, "loop.fmu")),
            start_time=job.start_time,
            stop_time=job.stop_time,
            step_size=interval,
            output_interval=interval,
            output=outputs,
        )
    return result["time"], np.column_stack([result[output] for output in outputs])


def _sources(package: Path) -> dict[str, str]:
    """Component -> its FMU in the package."""
    with zipfile.ZipFile(package) as archive:
        root = ElementTree.fromstring(archive.read(STRUCTURE))
    return {c.get("name", ""): c.get("source", "") for c in root.iter(tag("ssd:Component"))}


def loaded_by_fmpy(fmu: Path, folder: Path) -> FMU2Slave:
    """An FMU extracted to a folder and instantiated by FMPy."""
    description: Any = fmpy.read_model_description(str(fmu))
    instance = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(fmu), str(folder)),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=fmu.stem,
    )
    instance.instantiate()
    return instance


@dataclass(frozen=True)
class Importer:
    """A function of this file, and the distribution that it needs."""

    run: Callable[[ImporterJob], Reports]
    distribution: str


IMPORTERS = {
    "fmpy_ssp": Importer(fmpy_ssp, "fmpy"),
    "libcosim": Importer(libcosim, "libcosimpy"),
    "ecos": Importer(ecos, "ecospy"),
    "fmucontainer": Importer(fmucontainer, "fmu-manipulation-toolbox"),
}
if find_spec("OMSimulator"):  # installs only where build.openmodelica.org can be reached
    IMPORTERS["omsimulator"] = Importer(omsimulator, "OMSimulator")


def run_job(parent: Parent) -> None:
    """Run the job that is sent with the name of an importer; send its trajectory."""
    importer, job = parent.receive()
    with tempfile.TemporaryFile() as printed:
        usual = os.dup(sys.stderr.fileno())
        for stream in (sys.stdout, sys.stderr):
            os.dup2(printed.fileno(), stream.fileno())
        try:
            time, values = map(np.asarray, IMPORTERS[importer].run(job))
        finally:
            os.dup2(usual, sys.stderr.fileno())  # where the reason of a failure is looked for
            printed.seek(0)
            text = printed.read().decode("utf-8", "replace")
            sys.stderr.write(text)
    parent.send(Trajectory(time, values, text))
