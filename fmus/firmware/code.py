"""Traced block -> C for a microcontroller: header, equations, an example and programs that measure it.

A third dialect of `fmus/generate/c_code.py`: columns are structs with the names of the model description. It
has no heap, no global state, no header of FMI, and one loop, over the internal steps of a step.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import resources
from string import Template

import numpy as np

from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.generate.c_code import CFunction, ScalarC, c_function, c_functions
from fmus.generate.operations import CALLS, Operation
from fmus.generate.trace import Traced

# column of the traced functions -> its struct; a step writes the next state
_STRUCTS = {
    "p": "parameters",
    "c": "calculated",
    "u": "inputs",
    "x": "state",
    "next": "state",
    "y": "outputs",
}
_CAUSALITIES = {"p": "parameter", "c": "calculatedParameter", "u": "input", "y": "output"}
# words of C and C++, which Python takes as names
_RESERVED = (
    "auto bool case catch char const default delete do double enum explicit extern float friend goto inline "
    "int long mutable namespace new operator private protected public register restrict short signed sizeof "
    "static struct switch template this throw typedef typename union unsigned using virtual void volatile"
)
# Of a statement in single precision: calls and literals; calls that do not just get an f; the normal numbers.
_DOUBLE = re.compile(rf"\b({'|'.join(CALLS.values())})(?=\()|(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)")
_SINGLE = {"smaller": "fminf", "larger": "fmaxf", "fmod_by_whole": "fmodf"}
_SMALLEST, _LARGEST = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
_ABOUT = {
    "double": "bit for bit, where the C library's math.h has the same bits. All are doubles",
    "float": "nearly, in floats: see README.md. Parameters and states that are times or counts are doubles",
}
# a sum with a double is one, a product if all its factors are
_SPREADING = "ADD", "SUB", "FMIN", "FMAX", "CHOICE"
_CONDITIONS = "LT", "LE", "EQ", "NE", "NOT", "AND", "OR"


class FirmwareC(ScalarC):
    """C99 whose columns are structs; their members have the names of the model description.

    number: `double` or `float`. A float has 24 bits, too few for times of a day in steps of ms, and for
    counts: they stay doubles, as do numbers that follow from t, or from doubles alone.

    members: column of the traced functions -> name in C of each element -> its comment
    types: column -> type in C of each element
    """

    def __init__(self, traced: Traced, number: str = "double") -> None:
        block = traced.block
        self.name, self.number, self.column = block.name, number, f"{number} *"
        variables = {column: block.of_causality(causality) for column, causality in _CAUSALITIES.items()}
        variables["x"] = block.state_variables
        self.members = {column: dict(_members(those)) for column, those in variables.items()}
        self.types = {
            column: ["double" if column in "pcx" and _is_exact(v) else number for v in those]
            for column, those in variables.items()
        }
        self.members["next"], self.types["next"] = self.members["x"], self.types["x"]
        self._names = {column: [*members] for column, members in self.members.items()}
        self._doubles, self._narrows = list[bool](), False

    def function(self, f: CFunction) -> str:
        self._doubles = self._doubles_of(f.operations)
        return super().function(f)

    def _doubles_of(self, operations: Sequence[Operation]) -> list[bool]:
        """Returns whether the number of each operation is a double."""
        doubles, timed = list[bool](), list[bool]()
        for o in operations:
            # of a choice, the condition does not count
            used = o.arguments[1:] if o.name in ("CHOICE", "IF_ELSE_ZERO") else o.arguments
            used = () if o.name in _CONDITIONS else used
            those = [doubles[i] for i in used if operations[i].name != "CONST"]
            column, _, index = o.text.partition("[")
            if o.name == "INPUT" and column in self.types:
                those = [self.types[column][int(index[:-1])] == "double"]
            timed.append(o.text == "t" or any(timed[i] for i in used))
            spreads = timed[-1] or o.name in _SPREADING
            doubles.append((any if spreads else all)(those or [timed[-1]]) or self.number == "double")
        return doubles

    def _type(self, number: int) -> str:
        return "double" if self._doubles[number] else self.number

    def _argument(self, name: str) -> str:
        return f"{self.number} h" if name == "h" else super()._argument(name)

    def _statement(self, f: CFunction, number: int) -> str:
        if self.number == "double":
            return super()._statement(f, number)
        operation = f.operations[number]
        compares = operation.name in _CONDITIONS and any(self._doubles[i] for i in operation.arguments)
        # doubles are made floats before a sum or a product with floats, not after it
        self._narrows = not (self._doubles[number] or compares)
        text = super()._statement(f, number)
        return _DOUBLE.sub(_single, text) if self._narrows else text

    def _term(self, f: CFunction, number: int) -> str:
        text = super()._term(f, number)
        return f"({self.number}){text}" if self._narrows and self._doubles[number] else text

    def _column(self, name: str) -> str:
        kind = _STRUCTS.get(name)
        return f"{self.name}_{kind} *{name}" if kind else super()._column(name)

    def _text(self, operation: Operation) -> str:
        column, _, index = operation.text.partition("[")
        return f"{column}->{self._names[column][int(index[:-1])]}" if column in _STRUCTS else operation.text


def _is_exact(variable: BlockVariable) -> bool:
    """Whether a variable is a time or a whole number, for which 24 bits are too few."""
    return variable.unit == "s" or variable.type == "Integer"


def _single(double: re.Match[str]) -> str:
    """Returns a call or a literal in single precision."""
    if name := double[1]:
        return _SINGLE.get(name, f"{name}f")
    value = float(double[2])
    return f"{min(max(value, _SMALLEST), _LARGEST) if value else value!r}f"


def _members(variables: Sequence[BlockVariable]) -> Iterator[tuple[str, str]]:
    """Yields the name in C and the comment of each variable: `theta[1,2]` is theta_1_2."""
    taken: set[str] = {*_RESERVED.split()}
    for v in variables:
        member = re.sub(r"\W+", "_", v.name).strip("_")
        while member in taken:
            member += "_"
        taken.add(member)
        yield member, f"{v.description or v.name}: {v.expected}".replace("*/", "* /")


def firmware_sources(traced: Traced, number: str = "double") -> dict[str, str]:
    """Returns file name -> text: header, C file, an example, programs for a board and for a comparison."""
    block, dialect = traced.block, FirmwareC(traced, number)
    files = resources.files("fmus")
    step, constants = c_functions(traced.step, "block_step", held=("h", "p", "c"), inputs="u")
    others = ("calculate", "requirements", "initial_state", "output")
    functions: list[CFunction] = [*step, *(c_function(getattr(traced, f), f"block_{f}") for f in others)]
    if number != "double":
        # calls remember doubles alone
        functions = [replace(f, operations=[replace(o, place="") for o in f.operations]) for f in functions]
    values = {
        "name": block.name,
        "number": number,
        "about": _ABOUT[number],
        "moves": ", ".join(map(repr, map(_move, block.of_causality("input")))) or "0",
        "description": " ".join(block.description.split()).replace("*/", "* /"),
        "structs": "\n".join(_struct(dialect, column) for column in ("p", "c", "u", "y", "x")),
        "parameters": _starts(block.parameters()),
        "inputs": _starts(block.inputs()),
        "constants": constants + 1,
        "requirements": len(traced.required),
        "required": "".join(f" *   {i}: expected {text}\n" for i, text in enumerate(traced.required, 1)),
        "elementary": (files / "native/elementary.h").read_text("utf-8"),
        "equations": "\n".join(map(dialect.function, functions)),
        "step_size": repr(float(block.step_size)),
    }
    template = (files / "firmware/firmware.c.in").read_text("utf-8")
    parts = re.split(r"^//// (.+)\n", Template(template).substitute(values), flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _struct(dialect: FirmwareC, column: str) -> str:
    members = dialect.members[column] or {"none": "C99 has no empty struct"}
    types = dialect.types[column] or [dialect.number]
    lines = "".join(
        f"    {kind} {name}; /* {text} */\n"
        for kind, (name, text) in zip(types, members.items(), strict=True)
    )
    return f"typedef struct {{\n{lines}}} {dialect.name}_{_STRUCTS[column]};\n"


def _move(v: BlockVariable) -> float:
    """Returns how far an input moves about its start value: by 1 if it is a Real and its range permits."""
    ends = [abs(end - v.start) for end in (v.minimum, v.maximum) if end is not None]
    return float(min([1.0, *ends])) if v.type == "Real" else 0.0


def _starts(values: object) -> str:
    return ", ".join(repr(float(value)) for value in flatten(values)) or "0"
