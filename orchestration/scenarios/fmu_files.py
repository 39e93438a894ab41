"""The FMUs that scenarios name, and building those that need it: the only file of this room that builds."""

from collections.abc import Iterable
from pathlib import Path

from fmus.registry import Flavour, fmu_path


def fmu_file(fmu: str, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the file of an FMU: an .fmu as it is, or where that of a block is found.

    The FMU of a Python file's only block is built if it is missing or stale; ExportError if it cannot be.
    """
    if not fmu.endswith(".py"):
        return Path(fmu) if fmu.endswith(".fmu") else fmu_path(fmu, flavour)
    from fmus.generate import cache

    if current := cache.BuildCache().current(cache.order_of_file(Path(fmu), flavour), to_run=True):
        return current[0]
    from fmus.generate import builder  # which loads CasADi

    return builder.fmu_of_file(Path(fmu), flavour)


def build_missing(fmus: Iterable[Path]) -> None:
    """Builds the FMUs of our blocks that are missing or stale."""
    from fmus.generate import cache

    if stale := cache.stale(fmus):
        from fmus.generate import builder

        builder.build_missing(stale)
