"""What a native FMU of FMI 3.0.2 must answer in co-simulation, where that is not what FMI 2.0 has."""

from functools import cache
from typing import ClassVar

from fmus.block import Block
from fmus.build.fmi3 import extents

from .native_model import ALL, ERROR, INITIALIZATION, OK, TYPES, Model, Null

_NO_VARIABLE = 2**32 - 1
_extents = cache(extents)


class Model3(Model):
    """One instance, as it must behave: value references are those of whole arrays."""

    fmi: ClassVar[int] = 3
    kinds: ClassVar[dict[str, str]] = {name: name[0] for name in TYPES}

    def __init__(self, block: Block, logging: bool) -> None:
        super().__init__(block, logging)
        self.extents = _extents(block)
        self.log = set(ALL) if logging else set()

    def scalars(self, references: list[int]) -> list[int]:
        if isinstance(references, Null):
            return references
        found: list[int] = []
        for r in references:
            extent = self.extents[r] if r < len(self.extents) else 0
            found += range(r, r + extent) if extent else [_NO_VARIABLE]
        return found

    # values

    def get(self, kind: str, references: list[int] | Null, out: bool) -> tuple[int, list | None]:
        return super().get(kind, self.scalars(references), out)

    def set(self, kind: str, references: list[int] | Null, values: list | Null) -> tuple[int, None]:
        scalars = self.scalars(references)
        if not isinstance(references, Null) and not isinstance(values, Null) and len(values) != len(scalars):
            return self._error()
        return super().set(kind, scalars, values)

    # modes and messages

    def enter(self, start: float = 0.0, has_stop: bool = False, stop: float = 0.0) -> tuple[int, None]:
        return super().enter() if self.setup(start, has_stop, stop)[0] == OK else (ERROR, None)

    def set_debug_logging(self, on: bool, categories: list[str | None] | Null) -> tuple[int, None]:
        if isinstance(categories, Null) and categories:
            return self._error()
        if any(category not in (*ALL, "logAll") for category in categories):
            return self._error()
        named = set(ALL) if not categories or "logAll" in categories else set(ALL) & set(categories)
        self.log = self.log | named if on else self.log - named
        return OK, None

    def step(self, t: float, h: float) -> tuple[int, list | None]:
        """With the last successful time."""
        status, _ = super().step(t, h)
        return status, [self.data.time] if status == OK else None

    # derivatives

    def directional_derivative(
        self, unknown: list[int] | Null, known: list[int] | Null, seed: list[float] | Null, out: bool
    ) -> tuple[int, list[float] | None]:
        return self._derive("forward", self.scalars(unknown), self.scalars(known), seed, out)

    def adjoint_derivative(
        self, unknown: list[int] | Null, known: list[int] | Null, seed: list[float] | Null, out: bool
    ) -> tuple[int, list[float] | None]:
        return self._derive("adjoint", self.scalars(unknown), self.scalars(known), seed, out)

    def is_unknown(self, reference: int) -> bool:
        """After the initialization calculated parameters rest."""
        is_initial = self.data.mode == INITIALIZATION
        return super().is_unknown(reference) and (is_initial or reference >= self.outputs.start)
