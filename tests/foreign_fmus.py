"""FMUs in C, independent of the blocks: linear, functions, a motor, and one that misbehaves on demand.

Their sources are in `foreign_c`; this module has their model descriptions and archives. A model is compiled
once; differences between its FMUs are written into the compiled library.
"""

import hashlib
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fmus import guid as guids
from fmus.files import write_archive
from fmus.native.toolchain import compile_library
from fmus.platforms import host_platform, library_name
from tests.shared_builds import built_once

_SOURCES = Path(__file__).parent / "foreign_c"
_CONFIG_MARK, _GUID_SIZE = b"the configuration goes here", 64  # of `Config` in slave.h
FORKING_CALLS = (  # in the order of forker.c
    "fmi2Instantiate",
    "fmi2SetReal",
    "fmi2GetReal",
    "fmi2EnterInitializationMode",
    "fmi2Reset",
    "fmi2DoStep",
)
_STATUSES = ("Warning", "Discard", "Error", "Fatal")


class Misdeed(IntEnum):
    """The misdeed of a rogue from its `misdeed_time` on; rogue.c has the same enumeration."""

    NONE = 1
    WARNING = 2
    DISCARD = 3
    TELLS_BEFORE = 4
    TELLS_AFTER = 5
    TELLS_NAN = 6
    TELLS_NOTHING = 7
    ERROR = 8
    FATAL = 9
    NAN_OUTPUT = 10
    INFINITE_OUTPUT = 11
    HANG = 12
    ABORT = 13
    SEGFAULT = 14
    REFUSE_STATE = 15
    REFUSE_INPUT = 16
    EXIT = 17
    CHANGE_FOLDER = 18
    ROUND_UPWARD = 19
    TERMINATE = 20
    TERMINATE_UNTIMED = 21
    EXIT_AT_ONCE = 22
    IGNORE_INTERRUPTS = 23
    NO_STATUS_OF_STEP = 24
    NO_STATUS_OF_INPUT = 25
    NO_STATUS_OF_STATE = 26
    BIG_STATUS_OF_STEP = 27
    HIDE_FILES = 28
    LEAVE_SESSION = 29
    LIMIT_FILES = 30
    RANDOM_OUTPUT = 31
    CRASH_IN_TERMINATE = 32
    CRASH_IN_FREE = 33
    HANG_IN_FREE = 34
    CRASH_IN_FREE_OF_STATE = 35


@dataclass(frozen=True)
class Capabilities:
    """The capabilities that an FMU declares; its library refuses all others."""

    interpolates_inputs: bool = False
    output_derivative_order: int = 0
    saves_state: bool = False
    serialises_state: bool = False
    varies_step_size: bool = True

    def attributes(self) -> dict[str, str]:
        return {
            "canInterpolateInputs": _text(self.interpolates_inputs),
            "maxOutputDerivativeOrder": _text(self.output_derivative_order),
            "canGetAndSetFMUstate": _text(self.saves_state),
            "canSerializeFMUstate": _text(self.serialises_state),
            "canHandleVariableCommunicationStepSize": _text(self.varies_step_size),
        }

    def numbers(self) -> list[float]:
        """The numbers in the order of `Config` in slave.h."""
        return [
            float(self.interpolates_inputs),
            float(self.output_derivative_order),
            float(self.saves_state),
            float(self.serialises_state),
            float(self.varies_step_size),
        ]


@dataclass(frozen=True)
class Variable:
    """A scalar variable; `follows` names the dependencies of an output in initialisation and in step mode."""

    name: str
    causality: str
    variability: str
    start: Any = 0.0
    kind: str = "Real"
    follows: tuple[str, ...] = ()
    initially_follows: tuple[str, ...] = ()
    nominal: float | None = None
    initial: str | None = None


def linear(
    path: Path,
    a: float = -1.0,
    b: Sequence[float] = (1.0,),
    c: Sequence[float] = (1.0,),
    d: Sequence[Sequence[float]] = ((0.0,),),
    initial_state: float = 1.0,
    passes_discrete: bool = False,
    refuses_boolean_from: float = 1e300,
    nominal: float | None = None,
    declares_dependencies: bool = True,
    solver_error: float = 0.0,
    solver_step: float = 1e-6,
    fmi: int = 2,
    **capabilities: Any,
) -> Path:
    """x' = a x + b u, y = c x + d u: parameters `a` (tunable) and `initial_state`, inputs u[j], outputs y[i].

    passes_discrete: the outputs integer_out and boolean_out are the inputs integer_in and boolean_in.
    refuses_boolean_from: time [s] after which boolean_in is discarded in a step.
    nominal: of inputs and outputs.
    declares_dependencies: whether the model description declares which outputs depend on which inputs.
    solver_error: largest error of the state that each step of at least `solver_step` [s] leaves.
    """
    inputs = [Variable(f"u[{j + 1}]", "input", "continuous", nominal=nominal) for j in range(len(b))]
    outputs = []
    for i, row in enumerate(d):
        fed = tuple(f"u[{j + 1}]" for j, gain in enumerate(row) if gain)
        first = ("initial_state", *fed) if c[i] else fed
        outputs.append(
            Variable(
                f"y[{i + 1}]", "output", "continuous", follows=fed, initially_follows=first, nominal=nominal
            )
        )
    discrete = []
    if passes_discrete:
        kinds = ("Integer", "Boolean")
        discrete = [Variable(f"{k.lower()}_in", "input", "discrete", kind=k) for k in kinds]
        for k in kinds:
            source = (f"{k.lower()}_in",)
            name = f"{k.lower()}_out"
            discrete.append(
                Variable(name, "output", "discrete", kind=k, follows=source, initially_follows=source)
            )
    variables = [
        Variable("a", "parameter", "tunable", start=a),
        Variable("initial_state", "parameter", "fixed", start=initial_state),
        *inputs,
        *outputs,
        *discrete,
    ]
    shape = {"N_U": len(b), "N_Y": len(c), "N_DISCRETE": int(passes_discrete)}
    numbers = [refuses_boolean_from, solver_error, solver_step, *b, *c, *(gain for row in d for gain in row)]
    claims = Capabilities(**capabilities)
    return _write(path, "linear", variables, claims, shape, numbers, declares_dependencies, fmi)


def function(path: Path, expression: str, start: float = 0.0, nominal: float | None = None) -> Path:
    """y = expression of u, in C, with feedthrough; if the value is not finite, reading y is discarded."""
    variables = [
        Variable("u", "input", "continuous", start=start, nominal=nominal),
        Variable("y", "output", "continuous", follows=("u",), initially_follows=("u",), nominal=nominal),
    ]
    return _write(path, "function", variables, Capabilities(), {"EXPRESSION(u)": f"({expression})"})


def rogue(path: Path, fmi: int = 2, **capabilities: Any) -> Path:
    """y' = u: parameters `misdeed`, `misdeed_time` (s) and `longest_step` (s), input u, output y."""
    variables = [
        Variable("misdeed", "parameter", "fixed", start=Misdeed.NONE, kind="Enumeration"),
        Variable("misdeed_time", "parameter", "fixed"),
        Variable("longest_step", "parameter", "fixed"),
        Variable("u", "input", "continuous"),
        Variable("y", "output", "continuous"),
    ]
    return _write(path, "rogue", variables, Capabilities(**capabilities), fmi=fmi)


def forker(path: Path, call: str, waits: str, child: str = "returns") -> Path:
    """y' = u; the first call of one of `FORKING_CALLS` forks the process.

    waits: "child" or "parent", for 0.1 s after the fork; child: "returns" from the call too, "exits" or
    "becomes" another program
    """
    variables = [
        Variable("u", "input", "continuous"),
        Variable("y", "output", "continuous"),
    ]
    numbers = [FORKING_CALLS.index(call), waits == "child", ("returns", "exits", "becomes").index(child)]
    return _write(path, "forker", variables, Capabilities(), numbers=numbers)


def stair(path: Path, fmi: int = 2, **capabilities: Any) -> Path:
    """Counts the seconds in the Integer output `counter`, from 1, and terminates the simulation at 10."""
    counter = Variable("counter", "output", "discrete", start=1, kind="Integer", initial="exact")
    return _write(path, "stair", [counter], Capabilities(**capabilities), fmi=fmi)


def mirror(
    path: Path,
    pairs: Mapping[str, tuple[str, str]],
    macros: Mapping[str, object] = {},
    changes: Sequence[tuple[str, str]] = (),
    **capabilities: Any,
) -> Path:
    """An FMU of FMI 3.0 whose outputs NAME_out are its inputs NAME_in of the step before.

    pairs: name -> type of FMI 3.0, and start values of the scalars by their indices, "[1,1] 1.0 [1,2] 2.0"
    macros: of fmi3.h; changes: of the model description, old and new text
    """
    variables, texts = [], []
    for suffix, causality in (("in", "input"), ("out", "output")):
        for name, (kind, starts) in pairs.items():
            words = starts.split() if starts.startswith("[") else ["", *starts.split()]
            for index, start in zip(words[::2], words[1::2], strict=True):
                follows = (f"{name}_in{index}",) if suffix == "out" else ()
                variability = "continuous" if kind.startswith("Float") else "discrete"
                given = start if kind == "String" else float(start)
                v = Variable(f"{name}_{suffix}{index}", causality, variability, given, kind, follows, follows)
                (texts if kind == "String" else variables).append(v)
    shape = {"N_PAIRS": len(variables) // 2, "N_TEXTS": len(texts), **macros}
    shape["TEXT_STARTS"] = ", ".join(f'"{v.start}"' for v in texts) or '""'
    claims = Capabilities(**capabilities)
    return _write(path, "mirror", variables, claims, shape, fmi=3, texts=texts, changes=changes)


def motor(path: Path, solver_tolerance: float = 1e-3, **capabilities: Any) -> Path:
    """A DC motor with an adaptive solver: input voltage [V], outputs current [A] and speed [rad/s].

    solver_tolerance: error that an inner step may have, of 1 + |x|, unless the importer gives a tolerance
    """
    variables = [
        Variable("voltage", "input", "continuous"),
        *(Variable(name, "output", "continuous") for name in ("current", "speed")),
    ]
    return _write(path, "motor", variables, Capabilities(**capabilities), numbers=[solver_tolerance])


def _write(
    path: Path,
    model: str,
    variables: Sequence[Variable],
    capabilities: Capabilities,
    macros: Mapping[str, object] = {},
    numbers: Sequence[float] = (),
    declares_dependencies: bool = True,
    fmi: int = 2,
    texts: Sequence[Variable] = (),
    changes: Sequence[tuple[str, str]] = (),
) -> Path:
    """Writes the archive.

    macros: of the library; numbers: of the model, after the other numbers of `Config`
    fmi: the version of the standard; texts: Strings, of FMI 3.0; changes: of the model description
    """
    if fmi == 3:
        arrays = [*_arrays(variables), *_arrays(texts)]
        macros = {**macros, "ARRAYS": ", ".join(array.initializer() for array in arrays)}
        xml = _fmi3_description(model, guids.GUID, arrays, capabilities, declares_dependencies)
    else:
        xml = _description(model, guids.GUID, variables, capabilities, declares_dependencies)
    definitions = "".join(f"#define {name} {macros[name]}\n" for name in macros)
    library = _compiled(path.parent, model, definitions, fmi)
    content = [*capabilities.numbers(), *(v.start for v in variables), *numbers]
    config = struct.pack(f"{len(content)}d", *content)
    recipe = hashlib.sha256(library + config).hexdigest()
    for old, new in changes:
        assert old.encode() in xml
        xml = xml.replace(old.encode(), new.encode())
    guid, members = guids.with_guid({"modelDescription.xml": xml}, recipe)
    reserved = _CONFIG_MARK.ljust(_GUID_SIZE + len(config), b"\0")
    assert library.count(reserved) == 1
    configured = library.replace(reserved, guid.encode().ljust(_GUID_SIZE, b"\0") + config)
    return write_archive(path, members | {library_name(model, host_platform(), fmi): configured})


def _compiled(folder: Path, model: str, config: str, fmi: int) -> bytes:
    """Returns the library of a model, compiled once for all users of the folder."""
    files = [f"{model}.c", "slave.h", *(["fmi3.h"] if fmi == 3 else [])]
    sources = {name: (_SOURCES / name).read_text("utf-8") for name in files}
    sources["config.h"] = config
    main = f"{model}.c"
    if fmi == 3:
        main = "main.c"
        sources[main] = f'#include "config.h"\n#include "{model}.c"\n#include "fmi3.h"\n'
    key = hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()[:16]

    def compile_to(path: Path) -> None:
        path.write_bytes(compile_library(model, sources, [main], host_platform()))

    return built_once(folder / f"{model}-{key}.library", compile_to).read_bytes()


_FMI3_TYPES = {"Real": "Float64", "Integer": "Int32"}


@dataclass(frozen=True)
class _Array:
    """An array of FMI 3.0, or a scalar: its value reference, first variable, scalars and dimensions."""

    name: str
    reference: int
    first: int
    scalars: Sequence[Variable]
    shape: Sequence[int]

    @property
    def type(self) -> str:
        return _FMI3_TYPES.get(self.scalars[0].kind, self.scalars[0].kind)

    def initializer(self) -> str:
        kind = "Int64" if self.type == "Enumeration" else self.type
        return f"{{{self.reference}, {kind}, {self.first}, {len(self.scalars)}}}"


def _arrays(variables: Sequence[Variable]) -> list[_Array]:
    """Returns arrays whose value references decrease with gaps; Strings have separate ones."""
    groups = [
        (name, list(members))
        for name, members in groupby(enumerate(variables), lambda v: re.sub(r"\[.*\]", "", v[1].name))
    ]
    arrays = []
    for k, (name, members) in enumerate(groups):
        indices = re.search(r"\[(.*)\]", members[-1][1].name)
        shape = [int(index) for index in indices[1].split(",")] if indices else []
        scalars = [v for _, v in members]
        reference = (10_000 if scalars[0].kind == "String" else 1_000) - 7 * k
        arrays.append(_Array(name, reference, members[0][0], scalars, shape))
    return arrays


def _fmi3_description(
    model: str, token: str, arrays: Sequence[_Array], capabilities: Capabilities, declares_dependencies: bool
) -> bytes:
    """Returns the description of FMI 3.0, without capabilities that FMI 3.0 does not have."""
    attributes = {"fmiVersion": "3.0", "modelName": model, "instantiationToken": token}
    root = ElementTree.Element("fmiModelDescription", attributes)
    root.set("variableNamingConvention", "structured")
    claims = {name.replace("FMUstate", "FMUState"): v for name, v in capabilities.attributes().items()}
    claims.pop("canInterpolateInputs")
    _add(root, "CoSimulation", modelIdentifier=model, **claims)
    if any(array.type == "Enumeration" for array in arrays):
        items = _add(_add(root, "TypeDefinitions"), "EnumerationType", name="Misdeed")
        for misdeed in Misdeed:
            _add(items, "Item", name=misdeed.name.lower(), value=str(misdeed.value))
    categories = _add(root, "LogCategories")
    for status in _STATUSES:
        _add(categories, "Category", name=f"logStatus{status}")
    _add(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize="0.01")
    listed = _add(root, "ModelVariables")
    _add(listed, "Float64", name="time", valueReference="0", causality="independent")
    for array in arrays:
        _fmi3_variable(listed, array)
    structure = _add(root, "ModelStructure")
    references = {v.name: array.reference for array in arrays for v in array.scalars}
    dependencies: dict[str, Callable[[Variable], tuple[str, ...]]] = {
        "Output": lambda v: v.follows,
        "InitialUnknown": lambda v: v.initially_follows,
    }
    for tag, of in dependencies.items():
        for array in arrays:
            first = array.scalars[0]
            if first.causality == "output" and (tag == "Output" or first.initial != "exact"):
                known = sorted({references[name] for v in array.scalars for name in of(v)})
                unknown = _add(structure, tag, valueReference=str(array.reference))
                if declares_dependencies:
                    unknown.set("dependencies", " ".join(map(str, known)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, xml_declaration=True, encoding="UTF-8")


def _fmi3_variable(parent: Any, array: _Array) -> None:
    v = array.scalars[0]
    common = {"causality": v.causality, "variability": v.variability}
    initial = v.initial or {"parameter": "exact", "output": "calculated"}.get(v.causality)
    if initial and v.causality != "input":
        common["initial"] = initial
    typed = _add(parent, array.type, name=array.name, valueReference=str(array.reference), **common)
    if array.type == "Enumeration":
        typed.set("declaredType", "Misdeed")
    for size in array.shape:
        _add(typed, "Dimension", start=str(size))
    if v.causality != "output" or v.initial == "exact":
        python_type = {"Boolean": bool, "Float64": float, "Float32": float, "String": str}.get(
            array.type, int
        )
        starts = [python_type(scalar.start) for scalar in array.scalars]
        if array.type == "String":
            for start in starts:
                _add(typed, "Start", value=start)
        else:
            typed.set("start", " ".join(map(_text, starts)))
    if v.nominal is not None:
        typed.set("nominal", _text(v.nominal))


def _description(
    model: str,
    guid: str,
    variables: Sequence[Variable],
    capabilities: Capabilities,
    declares_dependencies: bool,
) -> bytes:
    attributes = {"fmiVersion": "2.0", "modelName": model, "guid": guid}
    root = ElementTree.Element("fmiModelDescription", attributes)
    root.set("variableNamingConvention", "structured")
    _add(root, "CoSimulation", modelIdentifier=model, **capabilities.attributes())
    if any(v.kind == "Enumeration" for v in variables):
        declared = _add(_add(root, "TypeDefinitions"), "SimpleType", name="Misdeed")
        items = _add(declared, "Enumeration")
        for misdeed in Misdeed:
            _add(items, "Item", name=misdeed.name.lower(), value=str(misdeed.value))
    categories = _add(root, "LogCategories")
    for status in _STATUSES:
        _add(categories, "Category", name=f"logStatus{status}")
    _add(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize="0.01")
    listed = _add(root, "ModelVariables")
    for reference, v in enumerate(variables):
        _scalar_variable(listed, reference, v)
    _structure(_add(root, "ModelStructure"), variables, declares_dependencies)
    ElementTree.indent(root)
    return ElementTree.tostring(root, xml_declaration=True, encoding="UTF-8")


def _scalar_variable(parent: Any, reference: int, v: Variable) -> None:
    common = {"causality": v.causality, "variability": v.variability}
    initial = v.initial or {"parameter": "exact", "output": "calculated"}.get(v.causality)
    if initial:
        common["initial"] = initial
    scalar = _add(parent, "ScalarVariable", name=v.name, valueReference=str(reference), **common)
    typed = _add(scalar, v.kind)
    if v.kind == "Enumeration":
        typed.set("declaredType", "Misdeed")
    if v.causality != "output" or v.initial == "exact":
        python_type = {"Boolean": bool, "Integer": int, "Enumeration": int}.get(v.kind, float)
        typed.set("start", _text(python_type(v.start)))
    if v.nominal is not None:
        typed.set("nominal", _text(v.nominal))


def _structure(structure: Any, variables: Sequence[Variable], declares_dependencies: bool) -> None:
    index = {v.name: str(i + 1) for i, v in enumerate(variables)}
    dependencies: dict[str, Callable[[Variable], tuple[str, ...]]] = {
        "Outputs": lambda v: v.follows,
        "InitialUnknowns": lambda v: v.initially_follows,
    }
    for section, of in dependencies.items():
        outputs = [v for v in variables if v.causality == "output"]
        unknowns = [v for v in outputs if section == "Outputs" or v.initial != "exact"]
        listed = _add(structure, section) if unknowns else None
        for v in unknowns:
            unknown = _add(listed, "Unknown", index=index[v.name])
            if declares_dependencies:
                unknown.set("dependencies", " ".join(index[name] for name in of(v)))


def _add(parent: Any, tag: str, **attributes: str) -> Any:
    return ElementTree.SubElement(parent, tag, attributes)


def _text(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)
