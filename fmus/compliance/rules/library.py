"""Rules of the shared libraries of all platforms, read with LIEF without loading them."""

from collections.abc import Iterator, Sequence

from fmus.compliance.fmu_file import FmuFile, no_co_simulation
from fmus.compliance.library_reader import Library, no_library, start_reading
from fmus.compliance.rows import add_rows, row
from fmus.compliance.rule import IS_BROKEN, NotJudgedError, Stage, rule
from fmus.fmi.binding import platform_name

_BINARIES = "2.3 FMU Distribution (binaries)"
_MACHINES = {
    "linux64": ("ELF", "X86_64"), "linux32": ("ELF", "I386"),
    "win64": ("PE", "AMD64"), "win32": ("PE", "I386"), "darwin64": ("MACHO", "X86_64"),
    "x86_64-linux": ("ELF", "X86_64"), "aarch64-linux": ("ELF", "AARCH64"),
    "x86_64-windows": ("PE", "AMD64"), "aarch64-windows": ("PE", "ARM64"),
    "x86_64-darwin": ("MACHO", "X86_64"), "aarch64-darwin": ("MACHO", "ARM64"),
}  # fmt: skip

# functions of FMI 2.0.5, 2.1 to 2.3, 3.2 and 4.2, without their prefix
_OF_EVERY_INTERFACE = """
    GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
    EnterInitializationMode ExitInitializationMode Terminate Reset
    GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString
    GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate
    GetDirectionalDerivative
"""
_FUNCTIONS = {
    "CoSimulation": """
        SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep
        GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
    """,
    "ModelExchange": """
        EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime
        SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates
        GetNominalsOfContinuousStates
    """,
}


def _libraries(fmu: FmuFile) -> Sequence[Library]:
    """Returns every library that LIEF can read. Raises NotJudgedError if it crashes or hangs on one."""
    reading = start_reading(fmu)
    if reading.failure:
        raise NotJudgedError(f"library-format{IS_BROKEN}")
    return reading.libraries


@rule(_BINARIES, Stage.LIBRARY, condition=no_library)
def library_format(fmu: FmuFile) -> Iterator[str]:
    """Each library has the format and the processor that its folder names."""
    if failure := start_reading(fmu).failure:
        yield failure
        return
    for path, folder in fmu.libraries().items():
        expected = _MACHINES.get(folder)
        got = [library.machine for library in _libraries(fmu) if library.path == path]
        if not got and expected:
            yield f"{path} is not a shared library: expected one for {folder}"
        elif expected and expected not in got:
            machines = ", ".join(" ".join(machine) for machine in got)
            yield f"{path} is {machines}: expected {' '.join(expected)}"


def _functions(fmu: FmuFile, path: str) -> set[str]:
    """Returns the functions of the interfaces whose modelIdentifier the library has as its name."""
    identifier = path.rpartition("/")[2].rpartition(".")[0]
    kinds = [kind for kind, stated in fmu.interfaces.items() if stated.get("modelIdentifier") == identifier]
    names = " ".join([_OF_EVERY_INTERFACE, *(_FUNCTIONS[kind] for kind in kinds)])
    return {f"fmi2{name}" for name in names.split()}


@rule("advice: behaviour is judged where the library runs", Stage.LIBRARY, no_co_simulation)
def runs_on_this_platform(fmu: FmuFile) -> Iterator[str]:
    """There is a library for the platform of this check, or its behaviour is not judged."""
    if not fmu.host_library:
        platforms = ", ".join(sorted(set(fmu.libraries().values()))) or "none"
        yield f"libraries for {platforms}: without one for {platform_name()} the behaviour is not judged"


def _missing_functions(library: Library, fmu: FmuFile) -> str:
    return ", ".join(sorted(_functions(fmu, library.path) - library.exports))


def _missing_libraries(library: Library, fmu: FmuFile) -> str:
    is_documented = any(path.startswith("documentation/externalDependencies.") for path in fmu.names)
    missing = [name for name in library.needed if f"{library.directory}/{name}" not in fmu.paths]
    return "" if is_documented else ", ".join(missing)


def _unsought_libraries(library: Library, fmu: FmuFile) -> str:
    is_sought = any(path.startswith(("$ORIGIN", "${ORIGIN}")) for path in library.search_paths)
    inside = [name for name in library.needed if f"{library.directory}/{name}" in fmu.paths]
    return "" if is_sought else ", ".join(inside)


def _without_callbacks(fmu: FmuFile) -> str:
    """Returns the reason why the functions for memory need not be callbacks."""
    is_claimed = fmu.claims("canNotUseMemoryManagementFunctions")
    reason = "canNotUseMemoryManagementFunctions is claimed" if is_claimed else no_co_simulation(fmu)
    return no_library(fmu) or reason


add_rows(__name__, _BINARIES, Stage.LIBRARY, condition=no_library, rows=(
    row("library-exports",
        "Each library exports every function of the interfaces that the description names.", _libraries,
        (_missing_functions, "{path} does not export {value}"),
        clause="2.3 FMU Distribution, 2.1.1 Header Files and Naming of Functions"),
    row("libraries-are-complete",
        "Libraries for Linux need those of the FMU and of the system alone, or externalDependencies tells.",
        _libraries, (_missing_libraries,
        "{path} needs {value}: expected it in the FMU, or documentation/externalDependencies.txt")),
    row("libraries-have-an-rpath",
        "Libraries for Linux that need others of the FMU have the RPATH $ORIGIN.", _libraries,
        (_unsought_libraries, "{path} needs {value}, without RPATH: expected $ORIGIN")),
))  # fmt: skip
_MEMORY = "2.1.5 Creation, Destruction and Logging of FMU Instances"
add_rows(__name__, _MEMORY, Stage.LIBRARY, condition=_without_callbacks, rows=[
    row("memory-functions-are-callbacks",
        "Without canNotUseMemoryManagementFunctions, a library does not import malloc, calloc or realloc.",
        _libraries,
        (lambda library, _: ", ".join(sorted(library.imports & {"malloc", "calloc", "realloc"})),
         "{path} uses {value}: expected canNotUseMemoryManagementFunctions, or allocateMemory alone")),
])  # fmt: skip
