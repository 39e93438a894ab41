"""The layers of a scenario laid over each other, with its last FMUs and what joins them."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from fmus.fmi.description import start_value
from orchestration.errors import ScenarioError
from orchestration.scenarios.interface import Describe, Interface
from orchestration.scenarios.layers import Data, Layer, laid_over, names_in
from orchestration.scenarios.replaced import Replacement, renamed
from orchestration.scenarios.vehicle import PLANT, VehicleValues, description_file, unit_of
from orchestration.system.system import Port
from orchestration.system.values import fmi_value

_HANDLED = ("interface", "names")  # tables of layers that the composition follows


@dataclass(frozen=True)
class Composition:
    """A scenario of layers.

    data: the entries of all layers in one; replacements: of FMUs that stand in the place of others
    """

    data: Data
    interface: Interface
    replacements: Sequence[Replacement]


def compose(layers: Sequence[Layer], describe: Describe) -> Composition:
    """Returns the scenario of layers, the lowest first; ScenarioError for entries that do not fit."""
    interface = Interface(layers, describe)
    files = [file for layer in layers for file in layer.parameter_files]
    identified = {name for file in files for name in file.data.get("parameters", {})}

    def is_boolean(name: str) -> bool:
        port = interface.port(name)
        return port is not None and port.variable.type == "Boolean"

    data: Data = {}
    own: Collection[str] = ()
    replacements: list[Replacement] = []
    for index, layer in enumerate(layers):
        for component in interface.present.values():
            if names := component.given_names.get(index, {}):
                component.check_names(names, interface.names.union(names_in(data)))
            if component.former and component.layer == index:
                replacements.append(Replacement(component, interface, own, identified))
                data = renamed(data, component.name, interface.own_names(component))
                data = replacements[-1].fitting(data)
            else:
                data = renamed(data, component.name, names)
        plain = {key: value for key, value in layer.data.items() if key not in _HANDLED}
        data = laid_over(data, replace(layer, data=plain), is_boolean, interface.inputs)
        if index == interface.layer:
            own = frozenset(names_in(data))
            data |= {"record": interface.recorded(data["record"])} if "record" in data else {}
    return Composition(interface.joined(data), interface, replacements)


def with_actuators(
    data: Data, layers: Sequence[Layer], composition: Composition
) -> tuple[Data, dict[str, float]]:
    """Returns the data with what the actuators of a vehicle that replaces another say to other components.

    A value of the layer that replaces it, or of one above, stands. Returns the entries, too.
    """
    replaced = {x.component.name: x for x in composition.replacements if x.component.fmu}
    if PLANT not in replaced:
        return data, {}
    vehicle = composition.interface.present[PLANT]
    above = reduce(lambda a, x: a | x.data.get("parameters", {}), layers[vehicle.layer :], Data())
    given = {name.partition(".")[2]: value for name, value in above.items() if name.startswith(f"{PLANT}.")}
    file = description_file(vehicle.fmu)
    actuators = VehicleValues(file, vehicle.variables, vehicle.names, given).actuators
    entries: dict[str, float] = {}
    for component in composition.interface.present.values():
        if component.name == PLANT or component.name not in data["components"]:
            continue
        ports = {
            n: Port(component.name, v) for n, v in component.variables.items() if v.causality == "parameter"
        }
        own = {n: above.get(port.name, start_value(port.variable)) for n, port in ports.items()}
        # a controller that is set not to take a table takes a line
        points = sum(name.startswith("thruster_table_voltage[") for name in own)
        points *= above.get(f"{component.name}.thruster_tabulated") is not False
        if actuators.table and 0 < points < len(actuators.table.voltages):
            raise ScenarioError(
                f"{component.name}: expected a table of at most {points} points, got "
                f"{len(actuators.table.voltages)} of the thrusters of {Path(vehicle.fmu).name}; "
                f"--set {component.name}.thruster_tabulated=false takes a line in its place"
            )
        limit = own.get("voltage_limit")
        if isinstance(limit, str):
            limit = fmi_value(ports["voltage_limit"], limit)
        # actuators tell SI units, the controller may have others
        factor = {n: unit.factor for n, port in ports.items() if (unit := unit_of(port.variable))}
        told = actuators.parameters(factor.get("voltage_limit", 1.0) * float(limit or math.nan), points)
        entries |= {
            ports[name].name: value / factor[name] if name in factor else value
            for name, value in told.items()
            if name in own and (component.name not in replaced or component.has_part(name, "start", value))
        }
    parameters = data["parameters"] | {name: x for name, x in entries.items() if name not in above}
    return {**data, "parameters": parameters}, entries
