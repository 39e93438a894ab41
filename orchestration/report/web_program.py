"""A scenario as a WebAssembly program: its FMUs' C sources and the communication loop, compiled together.

`files/web_program.c` is the program. `plan.h` has the wiring of the run: C arrays with the content of the
arrays of this process, and with names in place of addresses.
"""

import json
import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fmus.errors import FmuLoadError
from fmus.files import extract_archive
from fmus.fmi.variable_types import TRANSFER_TYPE
from orchestration.errors import ScenarioError
from orchestration.run.loop_data import Report, Storage
from orchestration.run.wiring import WiredRun, build_wiring
from orchestration.system.prepared_run import PreparedRun, Setting
from orchestration.system.system import CheckedSystem, LinearTransformation, Port

_TARGET = "a WebAssembly program"
_TYPES = ("Real", "Integer", "Boolean")  # of getters and setters, in the order of web_program.c
_NUMBERS = (*_TYPES, "Enumeration")
_OF_CALLER = ("wiring_points", "wiring_signal_values", "wiring_rows")  # the page writes or reads them
_EXPORTED = (*_OF_CALLER, "setting_values", "message")
_ADDRESSES = (  # endings of the names of arrays of addresses
    *("_function", "_references", "_buffer", "_instances", "_do_step"),
    *("_real_status", "_boolean_status", "_get_state", "_set_state"),
)
_C_TYPES = {"float64": "double", "int64": "int64_t", "int32": "int32_t", "uint32": "uint32_t"}
_ABSENT = ("fmi2GetFMUstate", "fmi2SetFMUstate")  # the program never goes back
_OPTIONS = ("-target", "wasm32-wasi", "-mexec-model=reactor")


@dataclass
class _UnloadedInstance:
    """An FMU that is not loaded; the address of a function is its position in `functions`, from 1."""

    description: Any
    functions: list[str]
    log: Any = field(default_factory=SimpleNamespace)
    address = number = busy = calls = 0

    def function(self, name: str) -> int:
        """Returns the number of a function of the FMU, 0 for one that the program does not call."""
        if name in _ABSENT:
            return 0
        self.functions.append(f"{_prefix(self.description)}_{name}")
        return len(self.functions)


def program(prepared: PreparedRun, settings: Sequence[Setting]) -> bytes:
    """Returns the WebAssembly module of a run; the page can change the values of `settings`.

    Raises ScenarioError for a run that the program cannot make, FmuLoadError for an FMU without C sources,
    ExportError if the sources do not compile.
    """
    from fmus.native.toolchain import FLAGS, FMI_HEADERS, zig

    system = prepared.system
    if prepared.experiment.tolerance:
        raise ScenarioError(f"{_TARGET} with a tolerance: expected none, its steps are on the grid")
    changed = [port for changes in prepared.changes.values() for port, _ in changes]
    ends = [port for connection in system.connections for port in connection]
    recorded = [system.ports[name] for name in prepared.recorded]
    for port in (*changed, *ends, *recorded, *(port for port, _ in settings)):
        if (kind := port.variable.type) not in _NUMBERS:
            raise ScenarioError(
                f"{_TARGET} with {port.name}: expected type {' or '.join(_NUMBERS)}, got {kind}"
            )
    here = resources.files("orchestration")
    with TemporaryDirectory(prefix="l1-depth-web-") as name:
        folder = Path(name)
        compiled = ["program/web_program.c", *_unpack_sources(system, folder, FMI_HEADERS)]
        (folder / "program").mkdir()
        for file in ("report/files/web_program.c", "run/loop.c", "run/process_guard.h"):
            text = (here / file).read_text("utf-8")
            (folder / "program" / Path(file).name).write_text(text, "utf-8", newline="\n")
        (folder / "program" / "plan.h").write_text(_plan(prepared, settings), "utf-8", newline="\n")
        exported = [f"-Wl,--export={name}" for name in _EXPORTED]
        arguments = ["cc", *FLAGS, *_OPTIONS, *exported, "-I", str(FMI_HEADERS), "-o", "program.wasm"]
        zig([*arguments, *compiled], folder)
        return (folder / "program.wasm").read_bytes()


def _prefix(description: Any) -> str:
    return description.coSimulation.modelIdentifier


def _unpack_sources(system: CheckedSystem, folder: Path, headers: Path) -> Iterator[str]:
    """Unpacks the sources of each FMU; yields the files to compile, relative to the folder.

    Each file includes one source of the FMU and renames its functions with the prefix of a static library
    (2.1.1).
    """
    functions = re.findall(r"fmi2FullName\((fmi2\w+)\)", (headers / "fmi2Functions.h").read_text("utf-8"))
    paths: dict[str, Path] = {}
    for component, path in system.components.items():
        description, identifier = system.descriptions[component], _prefix(system.descriptions[component])
        if description.fmiVersion != "2.0":
            raise FmuLoadError(f"{_TARGET} with {path}, of FMI {description.fmiVersion}: expected FMI 2.0")
        if description.is_model_exchange:
            raise FmuLoadError(f"{_TARGET} with {path}, for model exchange alone: expected co-simulation")
        if other := paths.get(identifier):
            if other != path:
                raise FmuLoadError(f"{_TARGET} with {other} and {path}: expected different model identifiers")
            continue
        paths[identifier] = path
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            sources = [name for name in archive.namelist() if name.startswith("sources/")]
        listed = [file.get("name", "") for file in root.iterfind("CoSimulation/SourceFiles/File")]
        if not listed or not {f"sources/{name}" for name in listed} <= {*sources}:
            raise FmuLoadError(
                f"{_TARGET} with {component}, {path}, without C sources: expected an FMU whose model "
                "description lists SourceFiles that it has, as the native flavour's of l1-depth build"
            )
        extract_archive(path, folder / identifier, sources)
        prefixed = '#include "fmi2Functions.h"\n'
        prefixed += "".join(f"#undef {name}\n#define {name} {identifier}_{name}\n" for name in functions)
        for number, source in enumerate(listed):
            file = f"{identifier}/{number}.c"
            (folder / file).write_text(f'{prefixed}#include "sources/{source}"\n', "utf-8", newline="\n")
            yield file


def _plan(prepared: PreparedRun, settings: Sequence[Setting]) -> str:
    """Returns the text of plan.h."""
    system, experiment = prepared.system, prepared.experiment
    functions: list[str] = []
    instances: Any = {
        name: _UnloadedInstance(description, functions) for name, description in system.descriptions.items()
    }
    storage = Storage(np.zeros(prepared.shape), np.zeros(len(Report), np.int64))
    wired = build_wiring(prepared, instances, storage)
    numbers = {name: c for c, name in enumerate(system.components)}

    def port(port: Port) -> str:
        variable = port.variable
        kind = _TYPES.index(TRANSFER_TYPE[variable.type])
        return f"{{{numbers[port.component]}, {kind}, {variable.valueReference}u}}"

    changes = [(point, *setting) for point, made in sorted(prepared.changes.items()) for setting in made]
    tables = {
        "Component COMPONENTS": [
            f"COMPONENT({json.dumps(name)}, {_prefix(description)}, {json.dumps(description.guid)})"
            for name, description in system.descriptions.items()
        ],
        "Port SETTINGS": [port(variable) for variable, _ in settings],
        "int SETTING_IS_INPUT": [str(int(p.variable.causality == "input")) for p, _ in settings],
        "InitialConnection INITIAL_CONNECTIONS": list(_initial_connections(system, port)),
        "Event EVENTS": [
            f"{{{point}, {wired.bus.index.get(p.name, -1)}, {port(p)}, {_number(float(value))}}}"
            for point, p, value in changes
        ],
    }
    lines = [f"DECLARE_FMU({prefix})" for prefix in dict.fromkeys(map(_prefix, system.descriptions.values()))]
    times = {"START_TIME": experiment.start_time, "STOP_TIME": experiment.stop_time}
    times["FMU_TOLERANCE"] = experiment.fmu_tolerance or 0.0
    lines += [f"static const double {name} = {_number(value)};" for name, value in times.items()]
    for declared, rows in tables.items():
        name = declared.split()[1]
        lines.append(f"enum {{ N_{name} = {len(rows)} }};")
        lines.append(f"static const {declared}[] = {{{', '.join(rows) or '{0}'}}};")
    values = np.array([float(value) for _, value in settings])
    return "\n".join([*lines, _array("double setting_values", values), *_wiring(wired, functions), ""])


def _initial_connections(system: CheckedSystem, port: Any) -> Iterator[str]:
    from orchestration.run.initialisation import nominal_of

    for number, group in enumerate(system.connection_groups):
        for source, target in group.connections:
            change = system.transformations.get(target.name, LinearTransformation(1.0, -0.0))
            numbers = map(_number, (change.factor, change.offset, nominal_of((source, target))))
            yield f"{{{number}, {int(group.is_loop)}, {port(source)}, {port(target)}, {', '.join(numbers)}}}"


def _wiring(wired: WiredRun, functions: Sequence[str]) -> Iterator[str]:
    """Yields the arrays of a wiring and the wiring itself, member by member as loop.c declares it."""
    # `memory` is for arrays of a state that is saved, and this program saves none
    members = dict(_leaves(wired.wiring._replace(memory=np.zeros(0)), "wiring"))
    arrays = {name: value for name, value in members.items() if isinstance(value, np.ndarray)}
    del arrays["wiring_team"]
    addresses = {name: arrays.pop(name) for name in [*arrays] if name.endswith(_ADDRESSES)}
    arrays |= {f"wiring_references{i}": array for i, array in enumerate(wired.references)}

    def named(address: int) -> str:
        """Returns an address of this process, or the number of a function, as an expression of C."""
        for name, array in arrays.items():
            if 0 <= address - array.ctypes.data < array.nbytes:
                return f"(intptr_t)({name} + {(address - array.ctypes.data) // array.itemsize})"
        return f"(intptr_t){functions[address - 1]}" if address else "0"

    for name, array in arrays.items():
        if name in _OF_CALLER:
            yield f"double {name}[{max(array.size, 1)}];"
        else:
            yield _array(f"static {_C_TYPES[array.dtype.name]} {name}", array)
    for name, array in addresses.items():
        yield f"static intptr_t {name}[] = {{{', '.join(map(named, array.tolist())) or '0'}}};"
    members["wiring_orders"] = np.ones(0)  # an array, so that the wiring has its name
    counted = ("points", "instances", "connections_source", "signal_index", "record_index", "memory")
    counts = [str(members[f"wiring_{name}"].size) for name in counted]
    values = [name if isinstance(value, np.ndarray) else str(value) for name, value in members.items()]
    yield "static Team wiring_team[1];\n#define wiring_orders wiring_references0"
    yield f"static Wiring wiring = {{{', '.join([*counts, *values])}}};"


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yields the members of a tuple of tuples with their names, in order."""
    if isinstance(value, tuple):
        for member, inner in zip(value._fields, value, strict=True):  # type: ignore[attr-defined]
            yield from _leaves(inner, f"{name}_{member}")
    else:
        yield name, value


def _array(declared: str, values: np.ndarray) -> str:
    """Returns the definition of an array of C, which has at least one element."""
    # bytes, because -0.0 equals 0.0 but another bit
    rows = ", ".join(map(_number, values.ravel().tolist())) if any(values.tobytes()) else "0"
    return f"{declared}[{max(values.size, 1)}] = {{{rows}}};"


def _number(value: float) -> str:
    """Returns a number of C with all its bits."""
    if isinstance(value, float) and not np.isfinite(value):
        return "NAN" if np.isnan(value) else "INFINITY" if value > 0.0 else "-INFINITY"
    return value.hex() if isinstance(value, float) else str(int(value))
