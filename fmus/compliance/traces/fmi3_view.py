"""The model description of FMI 3.0 as one of FMI 2.0: the behaviour of both is judged by the same calls.

Arrays become scalars, which `fmi3_calls.c` transfers. Clocks, clocked variables and binary ones are left out.
"""

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

from fmus.compliance.rule import repeated
from fmus.compliance.variable import Variable, integer, is_true
from fmus.extras import require
from fmus.fmi.fmi3_description import fmi3_description
from fmus.fmi.model_description import Element, ScalarVariable

etree: Any = require("lxml.etree", "check", "a check of FMUs")  # without types
FLAGS = {  # of FMI 2.0 -> of FMI 3.0, where the names differ
    "canGetAndSetFMUstate": "canGetAndSetFMUState",
    "canSerializeFMUstate": "canSerializeFMUState",
    "providesDirectionalDerivative": "providesDirectionalDerivatives",
}
_OF_FMI2 = {new: old for old, new in FLAGS.items()}
_NOT_JUDGED = "maxOutputDerivativeOrder"  # of FMI 3.0
LISTS = {  # of ModelStructure in FMI 2.0 -> elements of FMI 3.0
    "Outputs": "Output",
    "Derivatives": "ContinuousStateDerivative",
    "InitialUnknowns": "InitialUnknown",
}
_NUMBERS = "min", "max", "nominal", "reinit"


def as_fmi2(root: Any, variables: Sequence[Variable]) -> tuple[Any, list[Element]]:
    """Returns the description of FMI 2.0, and the elements of `Fmi3Library`.

    Raises ValueError for a description that cannot be read.
    """
    if names := repeated(v.reference for v in variables):
        raise ValueError(f"value reference {next(iter(names))} is of several variables")
    description = fmi3_description(root)
    scalars: dict[int | None, list[int]] = {}  # by value reference, their indices in FMI 2.0
    for number, element in enumerate(description.elements, 1):
        scalars.setdefault(element.reference, []).append(number)
    stated = {"fmiVersion": "2.0", "guid": description.guid or ""}
    stated["numberOfEventIndicators"] = str(description.numberOfEventIndicators)
    view = etree.Element("fmiModelDescription", stated)
    for interface in root.iterchildren("ModelExchange", "CoSimulation"):
        _add_interface(view, interface)
    types = etree.SubElement(view, "TypeDefinitions")
    for declared in root.iterfind("TypeDefinitions/EnumerationType"):
        of_type = etree.SubElement(types, "SimpleType", name=declared.get("name", ""))
        etree.SubElement(of_type, "Enumeration").extend(deepcopy(item) for item in declared.iterfind("Item"))
    view.extend(deepcopy(part) for part in root.iterchildren("LogCategories", "DefaultExperiment"))
    listed = etree.SubElement(view, "ModelVariables")
    for v in variables:
        for place, number in enumerate(scalars.get(v.reference, ())):
            _add_variable(listed, description.modelVariables[number - 1], v, scalars, place)
    structure = etree.SubElement(view, "ModelStructure")
    for name, tag in LISTS.items():
        unknowns = etree.SubElement(structure, name)
        for element in root.iterfind(f"ModelStructure/{tag}"):
            known = (scalars.get(integer(text), ()) for text in element.get("dependencies", "").split())
            text = " ".join(str(number) for numbers in known for number in numbers)
            given = {"dependencies": text} if "dependencies" in element.attrib else {}
            # one element for all scalars of an array: their dependencies are as many as the scalars, each
            numbers = scalars.get(integer(element.get("valueReference")), ())
            if numbers:
                etree.SubElement(unknowns, "Unknown", {"index": " ".join(map(str, numbers)), **given})
    return view, list(description.elements)


def _add_interface(view: Any, interface: Any) -> None:
    stated = ((name, text) for name, text in interface.attrib.items() if name != _NOT_JUDGED)
    claims = {_OF_FMI2.get(name, name): text for name, text in stated}
    needed = is_true(interface.get("needsCompletedIntegratorStep"))
    etree.SubElement(view, interface.tag, claims, completedIntegratorStepNotNeeded=str(not needed).lower())


def _add_variable(
    listed: Any, scalar: ScalarVariable, v: Variable, scalars: dict[int | None, list[int]], place: int
) -> None:
    """Adds a scalar of a variable: of an array, the element at that place."""
    is_size = v.causality == "structuralParameter"  # which configuration mode alone can set
    stated = {
        "name": scalar.name,
        "valueReference": str(scalar.valueReference),
        "causality": "local" if is_size else v.causality,
        "variability": v.variability,
        "initial": "" if v.causality == "input" else "calculated" if is_size else v.initial,
    }
    element = etree.SubElement(listed, "ScalarVariable", {key: x for key, x in stated.items() if x})
    numbers = {name: text for name in _NUMBERS if (text := v.get(name)) is not None}
    typed = etree.SubElement(element, scalar.type, numbers, single=str(scalar.is_float32).lower())
    of = scalars.get(integer(v.typed.get("derivative")), ())
    given = {
        "start": None if is_size else scalar.start,
        "declaredType": v.typed.get("declaredType") if scalar.type == "Enumeration" else None,
        "derivative": str(of[place]) if place < len(of) else None,
    }
    for name, text in given.items():
        if text is not None:
            typed.set(name, text)
