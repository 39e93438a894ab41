"""Check that a block is declared as `fmus.block` asks: a mistake is a sentence with file, line and name."""

import ast
import inspect
import math
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, get_args, get_origin

from fmus.block import Block, NoValues
from fmus.block.scalars import flatten, members
from fmus.block.units import display, unit
from fmus.block.variables import ROLES, BlockVariable
from fmus.errors import ExportError
from fmus.fmi.variable_types import INTEGER_RANGE
from fmus.generate.guard import location

_VARIABILITIES = {
    "parameters": ("fixed", "tunable"),
    "calculated": ("fixed", "tunable"),
    "inputs": ("continuous", "discrete"),
    "outputs": ("continuous", "discrete"),
    "continuous": ("continuous",),
    "state": ("continuous", "discrete"),
}
_ARGUMENTS = {
    "calculate": ("parameters",),
    "requirements": ("parameters", "calculated"),
    "initial_state": ("t", "inputs", "parameters", "calculated"),
    "step": ("t", "h", "state", "inputs", "parameters", "calculated"),
    "output": ("t", "state", "parameters", "calculated"),
    "derivative": ("t", "state", "inputs", "parameters", "calculated"),
    "integrate": ("t", "h", "state", "inputs", "parameters", "calculated"),
    "crossings": ("t", "state", "inputs", "parameters", "calculated"),
}
_RESULTS = {
    "calculate": "calculated",
    "initial_state": "state",
    "step": "state",
    "output": "outputs",
    "derivative": "continuous",
    "integrate": "state",
}
_TYPES = "a float, an int, a bool, an IntEnum member, or a tuple of these"

# An annotation is a class, or its name where the module imports annotations from __future__.
_EXACT = {kind: cls.__name__ for cls in (float, int, bool) for kind in (cls, cls.__name__)}
_SUCH_AS = {"float": "a number such as 1.0", "int": "a whole number such as 1", "bool": "True or False"}


def check_declaration(block: Block) -> None:
    """Raises ExportError for the first mistake in a block's classes, or in the arguments of its functions."""
    owners: dict[str, str] = {}
    classes: dict[str, type] = {}  # by the causality of their variables
    for role, (causality, *_) in ROLES.items():
        cls = classes[causality] = getattr(block, role)
        for declared in fields(cls):
            for reason in _mistakes(declared, role):
                raise _refusal(block, cls, declared.name, reason)
            if other := owners.get(declared.name):
                raise _refusal(block, cls, declared.name, f"expected another name, {other} has it too")
            owners[declared.name] = cls.__name__
    continuous = fields(block.continuous)
    for cls, declared in _state_fields(block.state, block.state):
        for reason in _continuous_mistakes(declared) if declared in continuous else _state_mistakes(declared):
            raise _refusal(block, cls, declared.name, reason)
    for cls, name, reason in _shape_mistakes([*classes.values(), block.state]):
        raise _refusal(block, cls, name, reason)
    classes["local"] = block.state
    for v in (*block.variables, *block.states, *block.state_variables):
        for reason in _value_mistakes(v):
            raise _refusal(block, classes[v.causality], v.name.removeprefix("state."), reason)
    for name in _ARGUMENTS:
        if getattr(block, name) is not None:
            _check_arguments(block, name)


def check_result(block: Block, name: str, result: Any) -> None:
    """Raises ExportError if the result of a function of a block differs from its declaration."""
    cls = getattr(block, _RESULTS[name])
    where = f"block {block.name!r}: {location(getattr(block, name))}{name} returns "
    if not isinstance(result, cls) and not (cls is NoValues and result is None):
        got = "a number" if _is_one_number(result) else type(result).__name__
        raise ExportError(f"{where}{got}: expected {cls.__name__}(...)")
    for path, got, expected in _differences(result, cls(), cls.__name__):
        raise ExportError(f"{where}{path} as {got}: expected {expected}")


def check_requirements(block: Block, requirements: Any) -> None:
    """Raises ExportError if the requirements are no tuple of pairs."""
    for pair in requirements if isinstance(requirements, tuple | list) else (None,):
        if not (isinstance(pair, tuple | list) and len(pair) == 2 and isinstance(pair[1], str)):
            where = f"block {block.name!r}: {location(block.requirements)}requirements"
            raise ExportError(
                f'{where}: expected a tuple of pairs, ((condition, "what is expected"), ...), also for one: '
                'return ((condition, "text"),)'
            )


def _refusal(block: Block, cls: type, name: str, reason: str) -> ExportError:
    return ExportError(f"block {block.name!r}: {_line(cls, name)}{cls.__name__}.{name}: {reason}")


def _line(cls: type, name: str) -> str:
    """Returns FILE:LINE of a declaration, which begins a message; "" where the source is not at hand."""
    for base in cls.__mro__:
        try:
            lines, first = inspect.getsourcelines(base)
            (definition,) = ast.parse(textwrap.dedent("".join(lines))).body
        except (OSError, TypeError, ValueError, SyntaxError):
            continue
        for statement in definition.body if isinstance(definition, ast.ClassDef) else ():
            target = statement.target if isinstance(statement, ast.AnnAssign) else None
            if isinstance(target, ast.Name) and target.id == name.partition("[")[0]:
                return f"{inspect.getsourcefile(base)}:{first + statement.lineno - 1}: "
    return ""


def _mistakes(declared: Field, role: str) -> Iterator[str]:
    """Yields the mistakes in a variable of the interface."""
    if "units" not in declared.metadata or declared.default is MISSING:
        yield f'expected a declaration, {declared.name}: float = variable(0.0, "What it is", unit="m")'
        return
    if not declared.name.isascii():
        yield "expected ASCII letters, digits and underscores"
    variability = declared.metadata["variability"]
    yield from _type_mistakes(declared)
    if not any(isinstance(scalar, float) for scalar in flatten(declared.default)):
        for text in flatten(tuple(declared.metadata["units"].values())):
            if text not in ("1", None):
                start = f"start {declared.default!r} is no float"
                yield f"unit {text!r}: expected none, only a Real has a unit; {start}"
        for nominal in flatten(declared.metadata["ranges"]["nominal"]):
            if nominal is not None:
                yield f"nominal {nominal!r}: expected none, only a Real has a nominal value"
        if variability == "continuous":
            yield "variability 'continuous': expected 'discrete', only a Real is continuous"
    if variability is not None and variability not in _VARIABILITIES[role]:
        yield f"variability {variability!r}: expected {' or '.join(map(repr, _VARIABILITIES[role]))}"
    for group in ("units", "ranges"):
        for name, value in declared.metadata[group].items():
            if not _fits(value, declared.default):
                yield f"{name} {value!r}: expected one value, or a tuple of the shape of {declared.default!r}"


def _state_mistakes(declared: Field) -> Iterator[str]:
    if declared.default is MISSING:
        yield f"expected a value to start from, {declared.name}: float = 0.0"
    elif "units" in declared.metadata:
        yield from _mistakes(declared, "state")
    elif isinstance(declared.default, Field):
        yield f"expected a value to start from, {declared.name}: float = variable(0.0, ...)"
    else:
        yield from _type_mistakes(declared)


def _state_fields(cls: type, state: type) -> Iterator[tuple[type, Field]]:
    """Yields (class, field) for each field of a state, and for the parts of it that `variable` declares."""
    for declared in fields(cls):
        if cls is state or "units" in declared.metadata:
            yield cls, declared
        for part in filter(is_dataclass, _parts(declared.default)):
            yield from _state_fields(type(part), state)


def _continuous_mistakes(declared: Field) -> Iterator[str]:
    yield from _mistakes(declared, "continuous")
    for scalar in flatten(declared.default):
        if not isinstance(scalar, float):
            yield f"start {scalar!r}: expected a float, a continuous state is a Real"
    for nominal in flatten(declared.metadata["ranges"]["nominal"]):
        if nominal is not None and not nominal > 0.0:
            yield f"nominal {nominal!r}: expected more than 0"


def _shape_mistakes(classes: list[type]) -> Iterator[tuple[type, str, str]]:
    """Yields (class, field, reason) for fields that cannot be set by position, at any depth."""
    for cls in classes:
        for declared in fields(cls):
            if declared.kw_only or not declared.init:
                yield cls, declared.name, "expected a field without kw_only and init=False"
            for part in _parts(declared.default):
                if isinstance(part, tuple) and type(part) is not tuple:
                    yield cls, declared.name, f"{part!r}: expected a plain tuple or a frozen dataclass"
                elif is_dataclass(part):
                    yield from _shape_mistakes([type(part)])


def _parts(value: Any) -> Iterator[Any]:
    """Yields a value and, of a tuple, everything in it."""
    yield value
    for element in value if isinstance(value, tuple) else ():
        yield from _parts(element)


def _type_mistakes(declared: Field) -> Iterator[str]:
    scalars = flatten(declared.default)
    for scalar in scalars:
        if not isinstance(scalar, float | int):
            yield f"start {scalar!r} is of the type {type(scalar).__name__}: expected {_TYPES}"
    if not (expected := _EXACT.get(_element_type(declared.type))):
        return
    for scalar in scalars:
        got = type(scalar).__name__
        if got != expected and not (expected == "float" and isinstance(scalar, float)):
            article = "an" if got[0] in "aeiouAEIOU" else "a"
            instead = f"the type is {expected}: write {_SUCH_AS[expected]}"
            yield f"start {scalar!r} is {article} {got}, but {instead}"
    if isinstance(declared.default, tuple) and declared.type in _EXACT:
        instead = f"the type is {expected}: expected tuple[{expected}, ...]"
        yield f"start {declared.default!r} is a tuple, but {instead}"


def _element_type(annotation: Any) -> Any:
    """Returns X of tuple[X, ...]; of any other annotation, itself."""
    while get_origin(annotation) is tuple and get_args(annotation)[1:] == (...,):
        annotation = get_args(annotation)[0]
    return annotation


def _fits(value: Any, start: Any) -> bool:
    """Whether a value for the elements of a vector or matrix has the shape of its start values."""
    if not isinstance(value, tuple):
        return True
    is_long_enough = isinstance(start, tuple) and len(value) == len(start)
    return is_long_enough and all(map(_fits, value, start))


def _value_mistakes(v: BlockVariable) -> Iterator[str]:
    numbers = {"min": v.minimum, "max": v.maximum, "nominal": v.nominal, "start": v.start}
    low, high = INTEGER_RANGE
    for name, number in numbers.items():
        if v.type == "Integer" and number is not None and not low <= number <= high:
            yield f"{name} {number!r}: expected {low}..{high}, as in FMI; a float such as 1.0 is wider"
        elif number is not None and not math.isfinite(number):
            yield f"{name} {number!r}: expected a finite number"
    if v.minimum is not None and v.maximum is not None and v.minimum > v.maximum:
        yield f"min {v.minimum!r} is above max {v.maximum!r}"
    if (v.settable or v.causality == "local") and (refused := v.refuse(v.start)):
        yield f"start {refused.partition(' = ')[2]}"
    try:
        if v.unit is not None:
            unit(v.unit)
            if v.display_unit is not None:
                display(v.unit, v.display_unit)
    except ExportError as error:
        yield str(error)


def _check_arguments(block: Block, name: str) -> None:
    function, arguments = getattr(block, name), _ARGUMENTS[name]
    try:
        signature = inspect.signature(function)
    # a compiled function need not have a signature
    except ValueError:
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        raise ExportError(
            f"block {block.name!r}: {location(function)}{name}{signature}: "
            f"expected {len(arguments)} arguments, {name}({', '.join(arguments)})"
        ) from None


def _differences(result: Any, template: Any, path: str) -> Iterator[tuple[str, str, str]]:
    """Yields (path, got, expected) where the shape of a result differs from its declaration."""
    if isinstance(template, tuple):
        if not isinstance(result, tuple):
            yield path, f"a {type(result).__name__}", f"a tuple of {len(template)}"
        elif len(result) != len(template):
            yield path, f"a tuple of {len(result)}", f"a tuple of {len(template)}"
        else:
            for i, (one, other) in enumerate(zip(result, template, strict=True)):
                yield from _differences(one, other, f"{path}[{i + 1}]")
    elif is_dataclass(template):
        if not isinstance(result, type(template)):
            yield path, f"a {type(result).__name__}", f"a {type(template).__name__}"
        else:
            for member in fields(template):
                name = member.name
                yield from _differences(getattr(result, name), getattr(template, name), f"{path}.{name}")
    elif not _is_one_number(result):
        yield path, f"a {type(result).__name__}", "one number"


def _is_one_number(value: Any) -> bool:
    """Whether it is a number, of NumPy or Python, or the symbol of one."""
    if isinstance(value, float | int):
        return True
    count = getattr(value, "numel", None)
    return count() == 1 if count else getattr(value, "ndim", None) == 0


def scalar_names(value: Any, name: str = "") -> Iterator[str]:
    """Yields the names of the scalars of a dataclass, in the order of `flatten`."""
    if (parts := members(value)) is None:
        yield name.lstrip(".")
    for path, part in parts or ():
        yield from scalar_names(part, name + path)
