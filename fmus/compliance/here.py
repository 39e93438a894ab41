"""Which library of an FMU this machine runs."""

from contextlib import suppress

import fmpy

from fmus.compliance.fmu_file import FmuFile
from fmus.errors import ExportError
from fmus.platforms import host_platform, library_name


def platform() -> str:
    """This machine's platform by its FMI name, else by what FMPy calls it."""
    try:
        return host_platform()
    except ExportError:
        return fmpy.platform


def library_here(fmu: FmuFile) -> str:
    """Path inside the archive: of the FMI name, else of FMPy's; empty if there is neither."""
    identifier = (fmu.co_simulation or {}).get("modelIdentifier", "")
    candidates = [f"binaries/{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"]
    with suppress(ExportError):  # of a machine that FMPy alone knows
        candidates.insert(0, library_name(identifier, host_platform()))
    return next((each for each in candidates if each in fmu.names), "")
