"""FMUs that are built for a package: sources of signals, and FMUs that start with a scenario's values."""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.fmi.variable_types import FmiValue
from fmus.generate import builder
from fmus.generate.package_blocks import ramp_source, with_start_values
from fmus.platforms import PLATFORMS
from fmus.registry import Flavour, block_fmus
from fmus.units import si_unit
from orchestration.exchange.limits import RampSource


def build_ramp_source(source: RampSource, folder: Path) -> Path:
    """Writes the FMU of a source to a folder, for the platforms of the FMU that it drives.

    Its output has no unit where the input's is no product of SI units: its values are then in that unit too.
    """
    known = si_unit(source.unit)
    unit = source.unit if known and (known.factor, known.offset) == (1.0, 0.0) else None
    block = ramp_source(f"Ramps_{source.name}", source.name, unit, source.points)
    block = with_start_values(block, source.starts)
    return builder.build_block(block, folder, platforms=_platforms(source.driven))


def build_started(fmu: Path, starts: Mapping[str, FmiValue], folder: Path) -> Path:
    """Writes the FMU with other start values to a folder and returns it.

    Returns the FMU itself if it is no native one of an installed block: the python flavour carries the
    modules of its block, which state the start values.
    """
    known = block_fmus([fmu])
    numbers = {name: value for name, value in starts.items() if not isinstance(value, str)}
    if not known or not numbers:
        return fmu
    ((name, flavour),) = known
    if flavour is not Flavour.NATIVE:
        return fmu
    block = with_start_values(builder.load_block(name), numbers)
    return builder.build_block(block, folder, platforms=_platforms(fmu))


def _platforms(fmu: Path) -> Sequence[str]:
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
    return [p for p in PLATFORMS if any(name.startswith(f"binaries/{p}/") for name in names)]
