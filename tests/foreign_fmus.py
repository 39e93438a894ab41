"""FMUs of C that know nothing of the blocks: linear ones, functions, and one that misbehaves on demand.

Their sources stand in `test_fmus`; here are their model descriptions and archives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from importlib import resources
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy

from fmus.export import archive
from fmus.export.toolchain import compile_library
from fmus.files import write_archive
from fmus.platforms import host_platform, library_name

_SOURCES = Path(__file__).parent / "foreign_c"
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_STATUSES = ("Warning", "Discard", "Error", "Fatal")


class Misdeed(IntEnum):
    """What a rogue does from its `misdeed_time`; rogue.c tells the same in C."""

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
    CLOSE_FILES = 23
    CLOSE_OUTPUT = 24
    IGNORE_INTERRUPTS = 25
    CHANGE_LOCALE = 26


@dataclass(frozen=True)
class Capabilities:
    """What an FMU claims; its library refuses everything else."""

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

    def macros(self) -> dict[str, str]:
        return {
            "CAN_INTERPOLATE_INPUTS": str(int(self.interpolates_inputs)),
            "OUTPUT_DERIVATIVE_ORDER": str(self.output_derivative_order),
            "CAN_SAVE_STATE": str(int(self.saves_state)),
            "CAN_SERIALISE_STATE": str(int(self.serialises_state)),
            "CAN_VARY_STEP_SIZE": str(int(self.varies_step_size)),
        }


@dataclass(frozen=True)
class Variable:
    """A scalar variable; `follows` names what an output depends on in initialisation and in step mode."""

    name: str
    causality: str
    variability: str
    start: float = 0.0
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
    **capabilities: Any,
) -> Path:
    """x' = a x + b u, y = c x + d u: parameters `a` (tunable) and `initial_state`, inputs u[j], outputs y[i].

    passes_discrete: the outputs integer_out and boolean_out are the inputs integer_in and boolean_in.
    refuses_boolean_from: time [s] from which on boolean_in is discarded in a step.
    nominal: of inputs and outputs.
    declares_dependencies: whether the model description tells which outputs follow which inputs.
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
    macros = {
        "N_U": str(len(b)),
        "N_Y": str(len(c)),
        "N_DISCRETE": str(int(passes_discrete)),
        "REFUSES_BOOLEAN_FROM": repr(refuses_boolean_from),
        "B_VALUES": _array(b or (0.0,)),
        "C_VALUES": _array(c),
        "D_VALUES": "{" + ", ".join(_array(row or (0.0,)) for row in d) + "}",
    }
    return _write(path, "linear", variables, macros, Capabilities(**capabilities), declares_dependencies)


def function(path: Path, expression: str, start: float = 0.0, nominal: float | None = None) -> Path:
    """y = expression of u, in C, at once; where that has no finite value, reading y is discarded."""
    variables = [
        Variable("u", "input", "continuous", start=start, nominal=nominal),
        Variable("y", "output", "continuous", follows=("u",), initially_follows=("u",), nominal=nominal),
    ]
    return _write(path, "function", variables, {"EXPRESSION(u)": f"({expression})"}, Capabilities())


def rogue(path: Path, **capabilities: Any) -> Path:
    """y' = u: parameters `misdeed`, `misdeed_time` (s) and `longest_step` (s), input u, output y."""
    variables = [
        Variable("misdeed", "parameter", "fixed", start=Misdeed.NONE, kind="Enumeration"),
        Variable("misdeed_time", "parameter", "fixed"),
        Variable("longest_step", "parameter", "fixed"),
        Variable("u", "input", "continuous"),
        Variable("y", "output", "continuous"),
    ]
    return _write(path, "rogue", variables, {}, Capabilities(**capabilities))


def stair(path: Path, **capabilities: Any) -> Path:
    """Counts the seconds in the Integer output `counter`, from 1, and terminates the simulation at 10."""
    counter = Variable("counter", "output", "discrete", start=1, kind="Integer", initial="exact")
    return _write(path, "stair", [counter], {}, Capabilities(**capabilities))


def _write(
    path: Path,
    model: str,
    variables: Sequence[Variable],
    macros: dict[str, str],
    capabilities: Capabilities,
    declares_dependencies: bool = True,
) -> Path:
    headers = resources.files(fmpy) / "c-code"
    sources = {name: (headers / name).read_text("utf-8") for name in _HEADERS}
    sources |= {name: (_SOURCES / name).read_text("utf-8") for name in (f"{model}.c", "slave.h")}
    macros = {**macros, "START_VALUES": _array([v.start for v in variables]), **capabilities.macros()}

    config = {"MODEL_GUID": f'"{archive.GUID}"', **macros}
    text = "".join(f"#define {name} {value}\n" for name, value in config.items())
    xml = _description(model, archive.GUID, variables, capabilities, declares_dependencies)
    described = {"config.h": text.encode(), "modelDescription.xml": xml}
    _, members = archive.with_guid(described, recipe=repr(sorted(sources.items())))
    sources["config.h"] = members.pop("config.h").decode()
    library = compile_library(model, sources, [f"{model}.c"], host_platform())
    return write_archive(path, members | {library_name(model, host_platform()): library})


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


def _array(values: Sequence[float]) -> str:
    return "{" + ", ".join(repr(float(value)) for value in values) + "}"


def _text(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)
