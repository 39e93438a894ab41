"""The vehicle of a study: the vehicle of a shipped base, or another in its place."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import TypeAdapter

from fmus.errors import listed, nearest
from fmus.fmi.description import describe
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios.actuators import FORCE, VOLTAGES, Actuators
from orchestration.scenarios.file_tables import OneOf, Table, checked, table_of
from orchestration.scenarios.fmu_files import build_missing, fmu_file
from orchestration.scenarios.layers import components_of, file_layers, named_fmu, shipped_bases
from orchestration.scenarios.toml_file import TomlFile
from orchestration.scenarios.vehicle import (
    PLANT,
    VehicleFile,
    VehicleValues,
    description_file,
    description_of,
)
from orchestration.sweep.distributions import FUNCTIONS, Distribution
from orchestration.system.quantities import are_equal, in_unit_of

if TYPE_CHECKING:
    from orchestration.cli.changes import Changes

PREFIX = f"{PLANT}."
"""Before the name of a variable of the vehicle."""
DEPTH = f"{PREFIX}depth"
_EXPECTED = "expected an output depth, and an input control_force or inputs voltage[1] and voltage[2]"
_LISTED = 12  # names in a message


def _distribution(**also: Any) -> OneOf:
    """Returns the tables of a distribution of numbers, by its name, with entries beyond its arguments."""
    laws = {name: law for name, law in FUNCTIONS.items() if name not in ("seed", "choice")}
    key = "distribution"
    return OneOf(key, {name: table_of(key, name, law, also=also) for name, law in laws.items()})


DISTRIBUTION, DRAWN = _distribution(), _distribution(variables=(list[str], ...), unit=(str, ""))
_VARY: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[str, Annotated[Table, DRAWN]])


def distribution_of(table: Table) -> Distribution:
    """Returns the distribution that a table of draws declares."""
    arguments = {name: value for name, value in table.given().items() if name not in ("variables", "unit")}
    return FUNCTIONS[arguments.pop("distribution")](**arguments)


@cache
def built(fmu: str) -> Path:
    """Returns the file of an FMU, built if it is missing or stale, once in a process."""
    file = fmu_file(fmu)
    build_missing([file])
    return file


@dataclass(frozen=True)
class Vehicle:
    """A vehicle.

    fmu: an .fmu, a block or its .py file; is_of_base: whether it is the one of the protocol's base
    mapping: name of the vehicle's interface -> variable that stands for it
    settings: "plant.variable" -> value
    """

    name: str
    fmu: str
    file: TomlFile
    described: VehicleFile
    is_of_base: bool = False
    mapping: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, FmiValue] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        given: str,
        mapping: Mapping[str, str] | None = None,
        settings: Mapping[str, FmiValue] | None = None,
    ) -> "Vehicle":
        """Returns the vehicle of a block, an FMU or a Python file; ScenarioError for any other file."""
        file = description_file(given)
        named = named_fmu(given, Path(), lambda keys: f"plant = {given}", ("plant",))
        vehicle = cls(
            Path(given).stem, named, file, description_of(file), False, mapping or {}, settings or {}
        )
        vehicle.check()
        return vehicle

    @classmethod
    def of_changes(cls, changes: "Changes") -> "Vehicle":
        """Returns the vehicle that --plant names, with its settings and names."""
        values, mapping = changes.of_component(PLANT)
        return cls.of(changes.components[PLANT], mapping, {PREFIX + name: x for name, x in values.items()})

    @classmethod
    def of_base(cls, base: str) -> "Vehicle":
        """Returns the vehicle of a shipped base."""
        fmu = components_of(file_layers(shipped_bases()[base]))["plant"]
        file = description_file(fmu)
        return cls(fmu, fmu, file, description_of(file), is_of_base=True)

    @property
    def key(self) -> list[Any]:
        """The content that determines a score together with the FMU."""
        return [dict(self.mapping), dict(self.settings), self.file.data]

    @property
    def start_depth(self) -> str:
        """The parameter of the depth at the start, by the name of the interface."""
        return PREFIX + self.described.variables.start_depth

    def has(self, name: str) -> bool:
        """Checks whether the vehicle has a variable, "plant.NAME" by the name of the interface."""
        return self.variable(name).removeprefix(PREFIX) in self.variables

    def variable(self, name: str) -> str:
        """Returns the variable that stands for "plant.NAME"; of other components the name itself."""
        own = name.removeprefix(PREFIX)
        return PREFIX + self.mapping.get(own, own) if name.startswith(PREFIX) else name

    @property
    def variables(self) -> Mapping[str, ScalarVariable]:
        """The variables of the FMU, which is built if it has to be."""
        return {v.name: v for v in describe(built(self.fmu)).modelVariables}

    @property
    def actuators(self) -> Actuators:
        """The actuators of the unchanged vehicle, whose data controllers receive."""
        return self.values().actuators

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs of the actuators, "plant.NAME" by the name of the interface."""
        return tuple(PREFIX + name for name in self.actuators.inputs)

    def values(self, changed: Mapping[str, Any] = {}) -> VehicleValues:
        """Returns the values of its parameters; changed: "plant.variable" -> value of a run, over its own."""
        given = {name.removeprefix(PREFIX): value for name, value in {**self.settings, **changed}.items()}
        return VehicleValues(self.file, self.variables, self.mapping, given)

    @cached_property
    def vary(self) -> dict[str, Any]:
        """The draws in the description, name -> variables and distribution."""
        return checked(_VARY, self.file.data.get("vary", {}), lambda keys: self.file.at(("vary", *keys)))

    def law(self, name: str, entry: Any, place: str) -> Distribution:
        """Returns the distribution of a draw, in the unit of its variables.

        name, entry: of the draw; place: file and line of its unit
        """
        if not entry.unit:
            return distribution_of(entry)
        names = [self.variable(variable).removeprefix(PREFIX) for variable in entry.variables]
        try:
            known = [self.variables[own] for own in names if own in self.variables]
            changes = {in_unit_of(variable, entry.unit) for variable in known}
            if len(known) < len(names) or len(changes) > 1:
                raise SystemDefinitionError("unit: expected variables of the plant, all of one unit")
        except SystemDefinitionError as error:
            raise ScenarioError(f"{place}: vary.{name}: {error}") from None
        return distribution_of(entry).converted(changes.pop())

    def check_names(self, names: Iterable[tuple[str, str]]) -> None:
        """Refuses variables that the vehicle lacks; names: file and line, "component.variable"."""
        known = [f"{PREFIX}{variable}" for variable in (*self.variables, *self.mapping)]
        for place, name in names:
            if name.startswith(PREFIX) and not self.has(name):
                raise ScenarioError(f"{place}: no variable {name}; {nearest(name, known)}")

    def check(self) -> None:
        """Refuses a vehicle without a depth or without an actuator."""
        for causality, names in (("output", (DEPTH,)), ("input", (PREFIX + FORCE, PREFIX + VOLTAGES[0]))):
            own = [name for name, v in self.variables.items() if v.causality == causality]
            if any(self.variable(name).removeprefix(PREFIX) in own for name in names):
                continue
            raise ScenarioError(
                f"plant is {self.name}, which lacks {' and '.join(names)}, so it is no vehicle: {_EXPECTED}; "
                f"name the {causality} that stands for it by --map {names[0]}=NAME; its {causality}s are "
                f"{listed(own, _LISTED) or '(none)'}"
            )
        for name in (DEPTH, self.start_depth):
            variable = self.variables.get(self.variable(name).removeprefix(PREFIX))
            if variable and not are_equal(variable.unit, "m", {}, variable.units):
                raise ScenarioError(
                    f"plant is {self.name}: {variable.name} is in {variable.unit}: expected m"
                )
        for name, own in self.mapping.items():
            if own not in self.variables:
                raise ScenarioError(f"--map {PREFIX}{name}={own}: {nearest(own, self.variables)}")
