"""Rules of the shared libraries of all platforms, read with LIEF without loading them."""

from collections.abc import Iterator
from typing import Any

from fmus.binding import platform_name
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Level, Stage, rule
from fmus.extras import require

lief: Any = require("lief", "check", "a check of FMUs")
lief.logging.disable()
_MACHINES = {
    "linux64": ("ELF", "X86_64"),
    "linux32": ("ELF", "I386"),
    "win64": ("PE", "AMD64"),
    "win32": ("PE", "I386"),
    "darwin64": ("MACHO", "X86_64"),
    "x86_64-linux": ("ELF", "X86_64"),
    "aarch64-linux": ("ELF", "AARCH64"),
    "x86_64-windows": ("PE", "AMD64"),
    "aarch64-windows": ("PE", "ARM64"),
    "x86_64-darwin": ("MACHO", "X86_64"),
    "aarch64-darwin": ("MACHO", "ARM64"),
}

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


def no_library(fmu: FmuFile) -> str:
    return "" if fmu.libraries() else "there is no library"


def _slices(content: bytes) -> Iterator[Any]:
    """The library, or each architecture's of a macOS one; none if it is no library.

    A slice is used before the next is asked for: it lives no longer than what LIEF read it from.
    """
    data = list(content)
    if lief.is_macho(data):
        universal: Any = lief.MachO.parse(data) or ()
        yield from (universal.at(i) for i in range(len(universal)))
        return
    parsed = lief.parse(content)
    if parsed is not None:
        yield parsed


def _machine(parsed: Any) -> tuple[str, str]:
    header = parsed.header
    kind = getattr(header, "machine_type", None) or getattr(header, "machine", None) or header.cpu_type
    return parsed.format.name, getattr(kind, "name", str(kind))  # a number that LIEF does not know


@rule("2.3 FMU Distribution (binaries)", Stage.LIBRARY, condition=no_library)
def library_format(fmu: FmuFile) -> Iterator[str]:
    """Each library has the format and the processor that its folder names."""
    for path, folder in fmu.libraries().items():
        expected = _MACHINES.get(folder)
        got = [_machine(parsed) for parsed in _slices(fmu.read(path))]
        if not got:
            yield f"{path} is not a shared library: expected one for {folder}"
        elif expected and expected not in got:
            machines = ", ".join(" ".join(machine) for machine in got)
            yield f"{path} is {machines}: expected {' '.join(expected)}"


@rule("2.1.1 Header Files and Naming of Functions", Stage.LIBRARY, condition=no_library)
def library_exports(fmu: FmuFile) -> Iterator[str]:
    """Each library exports every function of the interfaces that the description names."""
    expected = _functions(fmu)
    for path in fmu.libraries():
        for parsed in _slices(fmu.read(path)):
            exported = {str(function.name).removeprefix("_") for function in parsed.exported_functions}
            exported |= {
                str(function.name).removeprefix("_") for function in getattr(parsed, "exported_symbols", ())
            }
            missing = sorted(expected - exported)
            if missing:
                yield f"{path} does not export {', '.join(missing)}"


def _functions(fmu: FmuFile) -> set[str]:
    names = " ".join([_OF_EVERY_INTERFACE, *(_FUNCTIONS[kind] for kind in fmu.interfaces)])
    return {f"fmi2{name}" for name in names.split()}


def no_co_simulation(fmu: FmuFile) -> str:
    return "" if fmu.co_simulation is not None else "it has no co-simulation interface"


@rule("2.3 FMU Distribution (binaries)", Stage.LIBRARY, Level.WARNING, condition=no_co_simulation)
def runs_on_this_platform(fmu: FmuFile) -> Iterator[str]:
    """There is a library for the platform of this check, or its behaviour is not judged."""
    if not fmu.host_library:
        platforms = ", ".join(sorted(set(fmu.libraries().values()))) or "none"
        yield f"libraries for {platforms}: without one for {platform_name()} the behaviour is not judged"
