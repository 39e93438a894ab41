"""A connection that carries another value than its output: SSP's linear transformation."""

import math
from dataclasses import dataclass, fields
from typing import Any

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError


@dataclass(frozen=True)
class LinearTransformation:
    """The input is factor * output + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        return self.factor * value + self.offset

    @classmethod
    def of(cls, given: Any, connection: str) -> "LinearTransformation":
        """Of a table with `factor` and `offset`; SystemDefinitionError names the connection."""
        known = [field.name for field in fields(cls)]
        if isinstance(given, cls):
            given = {name: getattr(given, name) for name in known}
        if not isinstance(given, dict):
            raise SystemDefinitionError(f"{connection}: expected {{factor, offset}} third, got {given!r}")
        for name, value in given.items():
            if name not in known:
                raise SystemDefinitionError(f"{connection}: unknown key {name!r}; {nearest(name, known)}")
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (is_number and math.isfinite(value)):
                raise SystemDefinitionError(f"{connection}: {name} = {value!r}: expected a finite number")
        return cls(**{name: float(value) for name, value in given.items()})
