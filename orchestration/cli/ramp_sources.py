"""FMUs that take the place of signals, built when a package needs them."""

import zipfile
from pathlib import Path

from fmus import catalogue
from fmus.platforms import PLATFORMS
from fmus.ramp_source import ramp_source
from fmus.units import BASE_UNITS
from orchestration.exchange.signal_sources import RampSource


def build_ramp_source(source: RampSource, folder: Path) -> Path:
    """Write the FMU of a source to a folder, for the platforms of the FMU that it drives.

    Its output has no unit where `fmus.units` does not know the input's: its values are then in that unit too.
    """
    unit = source.unit if source.unit in BASE_UNITS else None
    block = ramp_source(f"Ramps_{source.name}", source.name, unit, source.points)
    with zipfile.ZipFile(source.driven) as archive:
        names = archive.namelist()
    platforms = [p for p in PLATFORMS if any(name.startswith(f"binaries/{p}/") for name in names)]
    return catalogue.build_block(block, folder, platforms=platforms)
