"""The protocol of the score: its cases, figures and controllers, from protocol.toml.

What is kept for the table of a score alone stands in table.toml, which `study.table_seeds` reads.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.fmi_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.results.metrics import FUNCTIONS
from orchestration.scenarios.file_tables import checked
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.study.protocol_format import ControllerTable, FigureTable, ProtocolFile

FILE = Path(__file__).with_name("protocol.toml")
REFERENCE = "controller.depth_reference"
SENSOR_SEED = "plant.sensor_seed"
_BAND = 0.05  # of the target: the paper's settling band
_FILE = TypeAdapter(ProtocolFile)


@dataclass(frozen=True)
class Target:
    """A depth [m] that the reference comes to, and the window [s] from the start until it leaves.

    moves: whether it comes there from another depth
    """

    depth: float
    window: tuple[float, float]
    moves: bool = True

    @property
    def band(self) -> float:
        """Half the width [m] of the band in which the depth has settled: 5 % of the target."""
        return _BAND * self.depth


@dataclass(frozen=True)
class Case:
    """A run of the vehicle: what differs from the base scenario, and what of it is judged.

    layer: as a scenario file gives it; values: parameters and constant inputs laid over it
    trajectory: [time, depth] of the reference in place of that of the layer; judged: [start, end] in s
    """

    name: str
    title: str
    layer: Mapping[str, Any]
    target: Target
    judged: tuple[float, float]
    tuned_on: bool = False
    values: Mapping[str, FmiValue] = field(default_factory=dict)
    trajectory: Sequence[Sequence[float]] = ()

    def with_seed(self, seed: int) -> "Case":
        """The same with another seed of the sensor's noise."""
        return replace(self, values={**self.values, SENSOR_SEED: seed})


@dataclass(frozen=True)
class Protocol:
    """A protocol file, read and checked."""

    file: TomlFile
    tables: ProtocolFile

    @property
    def version(self) -> str:
        return self.tables.version

    @property
    def statement(self) -> str:
        return self.tables.statement.strip()

    @property
    def figures(self) -> Mapping[str, FigureTable]:
        return self.tables.figures

    @property
    def controllers(self) -> Mapping[str, ControllerTable]:
        return self.tables.controllers

    @cached_property
    def cases(self) -> dict[str, Case]:
        """The cases of the table by name, at the first practice seed."""
        return {name: self._case(name) for name in self.tables.cases}

    @property
    def nominal(self) -> Case:
        """The case of the paper: the first."""
        return next(iter(self.cases.values()))

    def _case(self, name: str) -> Case:
        table = self.tables.cases[name]
        points = self.tables.trajectory
        stop = table.stop_time or points[-1][0]
        layer = {key: value for key, value in self.file.data["cases"][name].items() if key in _LAYER_KEYS}
        reference = {"kind": "ramps", "smooth": False, "points": points}
        if table.hold:
            reference = {"kind": "constant", "value": table.hold}
            layer["parameters"] = {"plant.initial_depth": table.hold, **layer.get("parameters", {})}
        layer["signals"] = {REFERENCE: reference, **layer.get("signals", {})}
        layer["experiment"] = {"stop_time": stop}
        start, end = table.judged or (0.0, stop)
        target = Target(table.hold, (start, end), moves=False) if table.hold else first_target(points)
        seed = {SENSOR_SEED: self.tables.practice_seeds[0]}
        return Case(name, table.title, layer, target, (start, end), table.tuned_on, seed)


_LAYER_KEYS = ("parameters", "inputs", "signals", "faults")


def first_target(points: Iterable[Sequence[float]]) -> Target:
    """The first depth that a trajectory holds; ScenarioError if it holds none."""
    listed = list(points)
    for (_, before), (until, after) in pairwise(listed):
        if before == after:
            return Target(after, (listed[0][0], until))
    raise ScenarioError(f"trajectory {listed}: expected two points in a row of one depth")


def read_protocol(path: Path = FILE) -> Protocol:
    """The protocol of a file, by default of the one that ships; ScenarioError names file and line."""
    file = read_toml(path)
    tables = checked(_FILE, file.data, file.at)
    names = (
        *((("cost", "cases"), name, tables.cases) for name in tables.cost.cases),
        (("cost", "figure"), tables.cost.figure, tables.figures),
        *((("failure", name), name, tables.figures) for name in tables.failure),
        *((("figures", name, "function"), f.function, FUNCTIONS) for name, f in tables.figures.items()),
        *((("controllers", n, "league"), c.league, tables.leagues) for n, c in tables.controllers.items()),
    )
    for keys, name, known in names:
        _check_known(file, keys, name, known)
    return Protocol(file, tables)


def _check_known(file: TomlFile, keys: KeyPath, name: str, known: Collection[str]) -> None:
    if name not in known:
        raise ScenarioError(f"{file.at(keys)}: {'.'.join(map(str, keys))} = {name!r}; {nearest(name, known)}")
