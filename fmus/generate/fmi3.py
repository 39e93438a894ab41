"""FMI 3.0.2, where it has more than FMI 2.0: arrays, further variables, and its modelDescription.xml.

Scalars of one array are one variable, with the value reference of the first. Time and event indicators are
variables, with the last value references.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.generate.model_description import (
    add,
    add_enumerations,
    add_experiment,
    add_units,
    attributes_of,
    model_attributes,
    parsable,
)
from fmus.generate.sensitivities import Mode, sensitivities
from fmus.generate.symbolic import indicator_count, restarted_states

TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"}
_CAPABILITIES = {
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}
_OF_CO_SIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "maxOutputDerivativeOrder": "0",
    "providesIntermediateUpdate": "true",
    "canReturnEarlyAfterIntermediateUpdate": "true",
}
_INDICES = re.compile(r"\[[\d,]+\]")
_TIME = "time"


def other_variables(block: Block) -> tuple[BlockVariable, ...]:
    """Returns the variables that FMI 3.0 alone has: the time and, as an array, the event indicators."""
    reference = len(block.variables) + len(block.states)
    is_taken = _TIME in {array_name(v) for v in block.variables}
    time = "independent.time" if is_taken else _TIME  # no variable of a block has a point in its name
    indicators = (f"event.indicators[{i + 1}]" for i in range(indicator_count(block)))
    about = "Changes its sign where a derivative has a corner or a jump"
    return (
        _variable(time, reference, "independent", "Time", "s"),
        *(_variable(name, reference + 1 + i, "local", about) for i, name in enumerate(indicators)),
    )


def _variable(
    name: str, reference: int, causality: str, description: str, unit: str | None = None
) -> BlockVariable:
    initial = "calculated" if causality == "local" else None
    nothing = (None, None, None, None)  # display unit, limits, nominal value
    return BlockVariable(
        name, reference, causality, "continuous", initial, 0.0, description, unit, *nothing, "", None
    )


def array_name(v: BlockVariable) -> str:
    """Returns the name of the array that a scalar belongs to; of any other, its own."""
    return _INDICES.sub("", v.name)


def variable_names(variables: Iterable[BlockVariable]) -> list[str]:
    """Returns the names of the variables that some scalars become."""
    return [name for name, *_ in arrays(variables)]


def arrays(variables: Iterable[BlockVariable]) -> Iterator[tuple[str, list[int], list[BlockVariable]]]:
    """Yields name, dimensions and scalars of each variable; no dimensions for one that is no array.

    Scalars that differ in more than their start values are no array, and neither are rows of several lengths,
    nor derivatives of states that are none.
    """
    variables = list(variables)
    of_states = {f"der({v.name})": _common(v) for v in variables}
    for name, group in groupby(variables, array_name):
        scalars = list(group)
        indices = _INDICES.search(scalars[-1].name)
        shape = [int(index) for index in indices[0][1:-1].split(",")] if indices else []
        is_array = (
            len(scalars) == math.prod(shape)
            and len({(_common(v), of_states.get(v.name)) for v in scalars}) == 1
        )
        if shape and is_array:
            yield name, shape, scalars
        else:
            yield from ((v.name, [], [v]) for v in scalars)


def _common(v: BlockVariable) -> tuple[Any, ...]:
    """Returns what the scalars of an array have in common."""
    return (
        v.type, v.variability, v.unit, v.display_unit, v.minimum, v.maximum, v.nominal, v.enumeration,
    )  # fmt: skip


def extents(block: Block) -> list[int]:
    """Returns by value reference how many scalars the variable has that begins there: 0 inside an array."""
    scalars = [group for *_, group in arrays((*block.variables, *block.states, *other_variables(block)))]
    return [extent for group in scalars for extent in (len(group), *[0] * (len(group) - 1))]


def model_description(block: Block, token: str) -> bytes:
    """Returns the XML of a block; token: the instantiation token.

    Raises ExportError for a unit that `fmus.block.units` does not know.
    """
    others, count = other_variables(block), len(block.states) // 2
    attributes = {"fmiVersion": "3.0", "instantiationToken": token, **model_attributes(block)}
    root = ElementTree.Element("fmiModelDescription", attributes)
    for name, own in (("ModelExchange", {}), ("CoSimulation", _OF_CO_SIMULATION)):
        add(root, name, modelIdentifier=block.name, **_CAPABILITIES, **own)
    add_units(root, (*block.variables, *others), block.states)
    add_enumerations(root, block, lambda parent, **named: add(parent, "EnumerationType", **named))
    add_experiment(root, block)
    variables = add(root, "ModelVariables")
    groups = [*arrays((*block.variables, *block.states, *others))]
    restarted = restarted_states(block)
    for name, shape, (v, *rest) in groups:
        of_state = v.value_reference - len(block.variables)
        of_all, of_type = attributes_of(name, (v, *rest))
        if restarted.intersection(scalar.value_reference for scalar in (v, *rest)):
            of_type["reinit"] = "true"
        elif count <= of_state < 2 * count:
            of_type["derivative"] = str(v.value_reference - count)
        elif v.causality in ("input", "output") and v.variability == "continuous":
            of_type["intermediateUpdate"] = "true"
        variable = add(variables, TYPES[v.type], **of_all, **of_type)
        for size in shape:
            add(variable, "Dimension", start=str(size))
    _add_structure(add(root, "ModelStructure"), block, groups)
    return parsable(root, block)


def _add_structure(
    structure: Any, block: Block, groups: Sequence[tuple[str, list[int], list[BlockVariable]]]
) -> None:
    first = {v.value_reference: scalars[0].value_reference for *_, scalars in groups for v in scalars}
    modes = sensitivities(block)
    present, initial = (_of_arrays(mode, first) for mode in ((modes.step, modes.exchange), (modes.initial,)))
    outputs = {first[v.value_reference] for v in block.of_causality("output")}
    indicators = [v for v in other_variables(block) if v.causality == "local"]
    for tag, known in (
        ("Output", {r: known for r, known in present.items() if r in outputs}),
        ("ContinuousStateDerivative", {r: known for r, known in present.items() if r not in outputs}),
        ("InitialUnknown", initial),
    ):
        for reference, behind in sorted(known.items()):
            add(
                structure, tag, valueReference=str(reference), dependencies=" ".join(map(str, sorted(behind)))
            )
    for v in indicators[:1]:
        add(structure, "EventIndicator", valueReference=str(v.value_reference))


def _of_arrays(modes: Iterable[Mode], first: Mapping[int, int]) -> dict[int, set[int]]:
    """Returns the dependencies between whole variables that hold in one of the modes."""
    found: dict[int, set[int]] = {}
    for mode in modes:
        for unknown, known in mode.dependencies().items():
            found.setdefault(first[unknown], set()).update(first[reference] for reference in known)
    return found
