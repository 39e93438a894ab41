"""The scalars of a model description as the arrays that their names spell: `voltage[1]`, `voltage[2]`."""

from collections.abc import Iterable
from typing import Any

from fmpy.model_description import ModelDescription, ScalarVariable


def arrays(variables: Iterable[ScalarVariable]) -> dict[str, list[ScalarVariable]]:
    """Name without subscript -> its scalars, in the order of the model description."""
    found: dict[str, list[ScalarVariable]] = {}
    for variable in variables:
        found.setdefault(base(variable.name), []).append(variable)
    return found


def base(name: str) -> str:
    """The name without its subscript."""
    return name.partition("[")[0]


def of_causality(description: ModelDescription, causality: str) -> list[ScalarVariable]:
    return [v for v in description.modelVariables if v.causality == causality]


def start_value(variable: ScalarVariable) -> Any:
    """The start value as float, int, bool or text; zero where the model description gives none."""
    text = str(variable.start or 0)
    if variable.type == "Boolean":
        return text.lower() in ("true", "1")
    if variable.type == "String":
        return str(variable.start or "")
    return float(text) if variable.type == "Real" else int(text)
