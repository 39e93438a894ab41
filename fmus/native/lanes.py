"""The C code of a native FMU for a group of instances that step together: vectors in place of numbers.

An FMU of this exporter carries its equations as C, one operation a statement. Here each statement becomes
the same operation on vectors, one lane for each instance; a choice takes each lane from its own alternative,
and a branch is carried out if one lane at least needs it. So every lane has the bits of its own instance:
nothing is reordered, and elementary functions are those of the C library, lane by lane; `sin` and `cos` of
all lanes at once have its bits (lane_sine.h).
"""

import re
import zipfile
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from fmus.errors import ExportError
from fmus.native.statement_order import as_late_as_possible

SOURCE = "lanes.c"
LANES = 8
"""Instances of a group: a vector of as many doubles is one register of some processors, two of others."""
_OWN_HEADERS = ("lane_functions.h", "lane_sine.h")
_HEADERS = ("variables.h", "model.h")  # of the FMU, that the source includes
_CODE = "model_code.h"
_FUNCTIONS = tuple(
    f"model_{name}"
    for name in ("calculate", "requirements", "initial_state", "step_constants", "step", "output")
)
_QUICK = {
    "fabs",
    "sqrt",
    "floor",
    "ceil",
    "copysign",
    "smaller",
    "larger",
}  # of the processor, or a few of its own

_TERM = r"(\(-[^()]+\)|[\w.\[\]]+(?:(?<=e)[-+]\d+)?)"
_FORMS = {
    name: re.compile(form.replace("T", _TERM))
    for name, form in {
        "arithmetic": r"T ([-+*/]) T",
        "comparison": r"T (<|<=|==|!=) T",
        "logic": r"T (&&|\|\|) T",
        "not": r"!T",
        "negative": r"-T",
        "choice": r"\(T \? T : T\) \+ 0\.0",
        "sign": r"T < 0 \? -1 : T > 0 \? 1 : T",
        "remembered": r"remembered\((\w+), T, k \+ \d+\)",
        "call": r"([a-z]\w*)\(T(?:, T)?\)",
        "term": r"T",
    }.items()
}
_HEAD = re.compile(r"static (?:INLINED )?void (\w+)\((.+)\) \{")
_ASSIGNMENT = re.compile(r"(\w+(?:\[\d+\])?) = (.+);")
_BRANCH = re.compile(rf"if \((!?){_TERM}\) \{{")
_CONSTANTS = re.compile(r"enum \{ N_STEP_CONSTANTS = \d+ \};")


def lane_sources(fmu: Path) -> dict[str, str]:
    """File name -> text of the C sources of a library that steps groups of instances; SOURCE is compiled.

    Raises ExportError for an FMU that has no sources of this exporter, or those of another version of it.
    """
    with zipfile.ZipFile(fmu) as archive:
        missing = {f"sources/{name}" for name in (*_HEADERS, _CODE)} - {*archive.namelist()}
        if missing:
            raise ExportError(f"{fmu} has no {', '.join(sorted(missing))}: expected a native FMU of l1-depth")
        texts = {name: archive.read(f"sources/{name}").decode() for name in (*_HEADERS, _CODE)}
    try:
        code = lane_code(texts.pop(_CODE))
    except ExportError as error:
        raise ExportError(f"{fmu}: sources/{_CODE}: {error}; build the FMU again") from None
    templates = resources.files("fmus.native") / "vectors"
    own = {name: (templates / name).read_text("utf-8") for name in (SOURCE, *_OWN_HEADERS)}
    return texts | own | {"model_lanes.h": code}


def lane_code(code: str) -> str:
    """`model_code.h` of an FMU with vectors in place of numbers; ExportError for an unknown statement."""
    constants, lanes = _CONSTANTS.search(code), _LaneCode()
    bodies = dict(_functions(code))
    if constants is None or not bodies.keys() >= {*_FUNCTIONS}:
        raise ExportError(f"expected N_STEP_CONSTANTS and {', '.join(_FUNCTIONS)}")
    functions = [lanes.function(name, *bodies[name]) for name in _FUNCTIONS]
    return "\n".join([constants[0], f"enum {{ N_MEMORY = {lanes.memory} }};\n", *functions])


def _functions(code: str) -> Iterator[tuple[str, tuple[str, list[str]]]]:
    """Name, arguments and statements of every function; a declaration of variables is left out."""
    lines = iter(code.splitlines())
    for line in lines:
        if head := _HEAD.fullmatch(line):
            body, is_declaration = [], False
            for inside in lines:
                if inside == "}":
                    break
                is_declaration = is_declaration or inside.startswith("    double ")
                if not is_declaration:
                    body.append(inside.strip())
                is_declaration = is_declaration and not inside.endswith(";")
            yield head[1], (head[2], [line for line in body if line])


class _LaneCode:
    """Functions on their way to vectors; a number becomes a vector of doubles, a condition a mask.

    memory: how many vectors the calls of all functions until now remember
    """

    def __init__(self) -> None:
        self.memory = 0
        self._stored: set[str] = set()  # step constants that are masks
        self._masks: set[str] = set()
        self._numbers: set[str] = set()
        self._conditions: list[str] = []

    def function(self, name: str, arguments: str, body: list[str]) -> str:
        self._masks, self._numbers = set(), set()
        if name == "model_step":  # which changes k in the FMU alone: calls here remember in `memory`
            arguments = arguments.replace(", double *k", ", const double *k")
        arguments = arguments.replace("const double *", "const Lanes *restrict ")
        arguments = arguments.replace("double *", "Lanes *restrict ")
        lines = [self._line(line) for line in as_late_as_possible(body)]
        kinds = {"Lanes": self._numbers, "Mask": self._masks}
        declared = [f"{kind} {v} = ANY({kind});" for kind, names in kinds.items() for v in sorted(names)]
        code = "\n".join(f"    {line}" for line in (*declared, *lines))
        return f"static void {name}({arguments}, Lanes *restrict memory) {{\n{code}\n}}\n"

    def _line(self, line: str) -> str:
        if branch := _BRANCH.fullmatch(line):
            condition = self._mask(branch[2])
            self._conditions.append(f"~{condition}" if branch[1] else condition)
            return f"if (any({self._conditions[-1]})) {{"
        if line == "} else {":
            return f"}} if (any(~({self._conditions[-1]}))) {{"
        if line == "}":
            self._conditions.pop()
            return line
        if assignment := _ASSIGNMENT.fullmatch(line):
            target, (is_mask, value) = assignment[1], self._value(assignment[2])
            if "[" not in target:
                (self._masks if is_mask else self._numbers).add(target)
            elif is_mask and target.startswith("k["):
                self._stored.add(target)
                value = f"(Lanes)({value})"
            elif is_mask:
                value = f"number({value})"
            return f"{target} = {value};"
        raise ExportError(f"{line!r}: expected a statement of this version of l1-depth")

    def _value(self, expression: str) -> tuple[bool, str]:
        """Whether the expression is a condition, and the same for vectors."""
        for form, pattern in _FORMS.items():
            if match := pattern.fullmatch(expression):
                return getattr(self, f"_{form}")(*match.groups())
        raise ExportError(f"{expression!r}: expected an expression of this version of l1-depth")

    def _arithmetic(self, first: str, operator: str, second: str) -> tuple[bool, str]:
        return False, f"{self._number(first)} {operator} {self._number(second)}"

    def _comparison(self, first: str, operator: str, second: str) -> tuple[bool, str]:
        return True, f"(Mask)({self._number(first)} {operator} {self._number(second)})"

    def _logic(self, first: str, operator: str, second: str) -> tuple[bool, str]:
        return True, f"{self._mask(first)} {operator[0]} {self._mask(second)}"

    def _not(self, term: str) -> tuple[bool, str]:
        return True, f"~{self._mask(term)}"

    def _negative(self, term: str) -> tuple[bool, str]:
        return False, f"-{self._number(term)}"

    def _choice(self, condition: str, first: str, second: str) -> tuple[bool, str]:
        terms = self._mask(condition), self._number(first), self._number(second)
        return False, f"choice({', '.join(terms)}) + all(0.0)"

    def _sign(self, term: str, *_: str) -> tuple[bool, str]:
        return False, f"sign({self._number(term)})"

    def _remembered(self, function: str, term: str) -> tuple[bool, str]:
        return self._call(function, term, None)

    def _call(self, function: str, first: str, second: str | None) -> tuple[bool, str]:
        arguments = [self._number(term) for term in (first, second) if term]
        if function not in _QUICK:
            arguments.append(f"memory + {self.memory}")
            self.memory += len(arguments)  # what it was called with last, and the result
        return False, f"lanes_{function}({', '.join(arguments)})"

    def _term(self, term: str) -> tuple[bool, str]:
        return term in self._masks, term if self._is_vector(term) else self._number(term)

    def _is_vector(self, term: str) -> bool:
        return "[" in term or term in self._masks or term in self._numbers

    def _number(self, term: str) -> str:
        if term in self._masks or term in self._stored:
            return f"number({self._mask(term)})"
        return term if self._is_vector(term) else f"all({term})"

    def _mask(self, term: str) -> str:
        if term in self._stored:
            return f"((Mask){term})"
        return term if term in self._masks else f"is_true({self._number(term)})"
