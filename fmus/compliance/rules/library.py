"""Rules of the shared libraries of all platforms, read with LIEF without loading them."""

import posixpath
from collections.abc import Iterator, Sequence

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.library_reader import Library, no_library, start_reading
from fmus.compliance.rows import add_rows, row
from fmus.compliance.rule import IS_BROKEN, NotJudgedError, Stage, rule
from fmus.fmi.binding import CO_SIMULATION, MODEL_EXCHANGE, platform_name, signatures

_MACHINES = {
    "linux64": "ELF X86_64", "linux32": "ELF X86", "x86_64-linux": "ELF X86_64", "aarch64-linux": "ELF ARM64",
    "win64": "PE X86_64", "win32": "PE X86", "x86_64-windows": "PE X86_64", "aarch64-windows": "PE ARM64",
    "darwin64": "MACHO X86_64", "x86_64-darwin": "MACHO X86_64", "aarch64-darwin": "MACHO ARM64",
}  # fmt: skip
_TYPES = {"CoSimulation": CO_SIMULATION, "ModelExchange": MODEL_EXCHANGE}


def _libraries(fmu: FmuFile) -> Sequence[Library]:
    """Returns every library that LIEF can read. Raises NotJudgedError if it crashes or hangs on one."""
    libraries, failure = start_reading(fmu).result
    if failure:
        raise NotJudgedError(f"library-format{IS_BROKEN}")
    return libraries


@rule("2.3", Stage.LIBRARY, condition=no_library)
def library_format(fmu: FmuFile) -> Iterator[str]:
    """Each library has the format and the processor that its folder names."""
    libraries, failure = start_reading(fmu).result
    if failure:
        yield failure
        return
    for path, folder in fmu.libraries().items():
        expected = _MACHINES.get(folder)
        got = [library.machine for library in libraries if library.path == path]
        if not got and expected:
            yield f"{path} is not a shared library: expected one for {folder}"
        elif expected and expected not in got:
            yield f"{path} is {', '.join(got)}: expected {expected}"


@rule("advice: behaviour is judged where the library runs", Stage.LIBRARY)
def runs_on_this_platform(fmu: FmuFile) -> Iterator[str]:
    """There is a library for the platform of this check, or its behaviour is not judged."""
    if not fmu.host_library:
        platforms = ", ".join(sorted(set(fmu.libraries().values()))) or "none"
        yield f"libraries for {platforms}: without one for {platform_name()} the behaviour is not judged"


def _missing_functions(library: Library, fmu: FmuFile) -> str:
    """Returns the functions that the interfaces with the library's name as modelIdentifier have beside it."""
    identifier = posixpath.basename(library.path).rpartition(".")[0]
    kinds = [kind for kind, stated in fmu.interfaces.items() if stated.get("modelIdentifier") == identifier]
    expected = {name for kind in kinds for name in signatures(_TYPES[kind])}
    return ", ".join(sorted(expected - library.exports))


def _missing_libraries(library: Library, fmu: FmuFile) -> str:
    is_documented = any(path.startswith("documentation/externalDependencies.") for path in fmu.names)
    missing = [
        name for name in library.needed if f"{posixpath.dirname(library.path)}/{name}" not in fmu.paths
    ]
    return "" if is_documented else ", ".join(missing)


def _unsought_libraries(library: Library, fmu: FmuFile) -> str:
    is_sought = any(path.startswith(("$ORIGIN", "${ORIGIN}")) for path in library.search_paths)
    inside = [name for name in library.needed if f"{posixpath.dirname(library.path)}/{name}" in fmu.paths]
    return "" if is_sought else ", ".join(inside)


def _own_memory(library: Library, fmu: FmuFile) -> str:
    is_claimed = fmu.claims("canNotUseMemoryManagementFunctions")
    return "" if is_claimed else ", ".join(sorted(library.imports & {"malloc", "calloc", "realloc"}))


add_rows(__name__, Stage.LIBRARY, condition=no_library, rows=(
    row("library-exports", _libraries,
        (_missing_functions, "{path} does not export {value}")),
    row("libraries-are-complete", _libraries, (_missing_libraries,
        "{path} needs {value}: expected it in the FMU, or documentation/externalDependencies.txt")),
    row("libraries-have-an-rpath", _libraries,
        (_unsought_libraries, "{path} needs {value}, without RPATH: expected $ORIGIN")),
    row("memory-functions-are-callbacks", _libraries, (_own_memory,
        "{path} uses {value}: expected canNotUseMemoryManagementFunctions, or allocateMemory alone")),
))  # fmt: skip
