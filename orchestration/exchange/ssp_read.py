"""Reader of an SSP package, 1.0 or 2.0, as a scenario that our master runs.

Systems inside systems become components of one level, "system.component". Values are converted to the units
of the FMUs. Geometry and annotations are ignored, but for the step size; a name that fits no variable is
refused, which SSP permits.
"""

import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmus.errors import FmuLoadError, nearest
from fmus.files import extract_archive
from fmus.fmi.description import describe
from fmus.fmi.model_description import ModelDescription
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.exchange.ssp_package import OpenedPackage
from orchestration.exchange.ssp_structure import Structure
from orchestration.exchange.ssp_values import Values, bound_values, chosen_values
from orchestration.exchange.ssp_xml import STRUCTURE, tag
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import CheckedSystem, Port, System

Settings = dict[str, FmiValue]


@contextmanager
def opened(path: Path, parameter_set: str = "") -> Iterator[Scenario]:
    """Reads the scenario in a package; its FMUs are extracted until the context ends.

    parameter_set: name of an .ssv in the package, whose values replace those bound in it.
    Raises ScenarioError for a package that cannot be read.
    """
    if not path.is_file():
        beside = [package.name for package in path.parent.glob("*.ssp")]
        raise ScenarioError(f"no package {path}; beside it, {nearest(path.name, beside)}")
    with tempfile.TemporaryDirectory(prefix="l1-depth-ssp-") as folder:
        try:
            extract_archive(path, Path(folder))
        except (zipfile.BadZipFile, EOFError, zlib.error, RuntimeError, ValueError) as error:
            raise ScenarioError(f"{path}: expected an SSP package, a zip: {error}") from error
        try:
            yield _scenario(OpenedPackage(path, Path(folder)), parameter_set)
        except FmuLoadError as error:
            # nobody who reads the message finds the folder
            raise FmuLoadError(str(error).replace(f"{folder}{os.sep}", f"{path}: ")) from error


def _scenario(package: OpenedPackage, parameter_set: str) -> Scenario:
    if set(parameter_set) & set("/\\:") or not parameter_set.isprintable():
        raise package.error(
            f"parameter set {parameter_set!r}: expected a name of a file, without / and \\ and :"
        )
    root = _checked_root(package)
    system = root.find(tag("ssd:System"))
    if system is None:
        raise package.error(f"{STRUCTURE}: expected a System")
    structure = Structure.of(root, package)
    components = structure.components
    if not components:
        raise package.error(f"{STRUCTURE}: no component: expected at least one FMU")
    descriptions = {name: describe(path) for name, path in components.items()}
    ports = {f"{name}.{v.name}": Port(name, v) for name, d in descriptions.items() for v in d.modelVariables}
    structure.check_units(ports)
    connections = tuple(structure.connections(ports))
    bound = chosen_values(parameter_set, package) if parameter_set else bound_values(system, root, package)
    values = structure.of_components(bound, ports)
    known = CheckedSystem(components, descriptions, ports, ())
    parameters, inputs = _by_causality(values, known, {target for _, target, *_ in connections})
    settings: dict[str, Any] = {**_times(root, descriptions, package), "open_inputs": "start"}
    stem = package.path.stem
    return Scenario(
        name=parameter_set or stem,
        title=parameter_set or system.get("description") or stem,
        system=System(components, connections),
        experiment=Experiment(
            **settings, parameters=parameters, inputs=inputs, record=tuple(structure.outputs)
        ),
        metrics={},
        resolved={
            "components": {name: path.name for name, path in components.items()},
            "connections": [_as_data(connection) for connection in connections],
            "experiment": settings,
            "parameters": parameters,
            "inputs": inputs,
        },
    )


def _checked_root(package: OpenedPackage) -> Element:
    """Returns the root of the structure; raises ScenarioError for an element that is not supported."""
    root = package.root(package.folder / STRUCTURE)
    if root.tag != tag("ssd:SystemStructureDescription"):
        raise package.error(f"{STRUCTURE}: expected a SystemStructureDescription of SSP")
    version = root.get("version", "")
    if not version.startswith(("1.", "2.")):
        raise package.error(f"{STRUCTURE}: version {version!r}: expected 1.0 or 2.0")
    return root


def _as_data(connection: tuple[Any, ...]) -> list[Any]:
    """Returns a connection as a scenario file has it."""
    source, target, *given = connection
    return [source, target, *({"factor": t.factor, "offset": t.offset} for t in given)]


def _by_causality(values: Values, known: CheckedSystem, connected: set[str]) -> tuple[Settings, Settings]:
    """Returns (parameters, inputs); SystemDefinitionError names file and line of what does not fit."""
    parameters, inputs = Settings(), Settings()
    for name, value in values.items():
        if name in connected:
            continue
        try:
            port = known.port(name, "parameter")
            settings = inputs if port.variable.causality == "input" else parameters
            settings[name] = value.of(port)
        except SystemDefinitionError as error:
            raise SystemDefinitionError(f"{value.place}{error}") from None
    return parameters, inputs


def _times(
    root: Element, descriptions: Mapping[str, ModelDescription], package: OpenedPackage
) -> dict[str, float]:
    """Returns the times of an experiment [s]; without one, the longest and the smallest step of the FMUs."""
    default = root.find(tag("ssd:DefaultExperiment"))
    times = {} if default is None else default.attrib
    ends = [d.defaultExperiment.stopTime for d in descriptions.values() if d.defaultExperiment]
    stop = times.get("stopTime") or max((float(end) for end in ends if end), default=None)
    if stop is None:
        raise package.error("expected a default experiment with a stop time, of it or of an FMU")
    given = [algorithm.get("baseStepSize") for algorithm in root.iter(tag("osp:FixedStepAlgorithm"))]
    given = given or [master.get("stepSize") for master in root.iter(tag("oms:FixedStepMaster"))]
    suggested = [d.defaultExperiment.stepSize for d in descriptions.values() if d.defaultExperiment]
    try:
        steps = [float(step) for step in given or suggested if step]
        start_time, stop_time = float(times.get("startTime", "0")), float(stop)
    except ValueError as error:
        raise package.error(f"default experiment: {error}; expected numbers of seconds") from error
    # SSP has no place for a step size: a thousandth of the run where no file states one
    step_size = min(steps, default=(stop_time - start_time) / 1000)
    return {"start_time": start_time, "stop_time": stop_time, "step_size": step_size}
