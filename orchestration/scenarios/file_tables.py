"""Types for the tables of TOML files: what they check, and the one line that a mistake gives.

Tables whose keys are the arguments of a function or a dataclass are derived from it, so that nothing is
declared twice.
"""

import inspect
import math
import re
import reprlib
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, cast

import numpy.typing as npt
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    create_model,
    model_validator,
)
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError
from pydantic_core.core_schema import no_info_plain_validator_function

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.scenarios.toml_file import KeyPath

_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "list_type": "a list",
    "sequence_str": "a list",
    "is_instance_of": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "finite_number": "a finite number",
    "too_short": "{min_length} or more items",
    "too_long": "at most {max_length} items",
    "kind": "a table",
    "greater_than": "more than {gt}",
    "greater_than_equal": "{ge} or more",
}
_CHOICES = ("enum", "literal_error")
_FILE_TYPES = {npt.ArrayLike: list[float]}  # types of Python that a TOML file writes in another way
_UNKNOWN_KEY, _KIND, _SCALAR = "unknown_key", "kind", "scalar"

T = TypeVar("T")


class Table(BaseModel):
    """A table that has no other keys than those declared; numbers are finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _has_known_keys(cls, data: object) -> object:
        closed = cls.model_config.get("extra") == "forbid"
        for key in data if closed and isinstance(data, dict) else ():
            if key not in cls.model_fields:
                hint = nearest(key, cls.model_fields)
                raise PydanticCustomError(
                    _UNKNOWN_KEY, "unknown key {key}; {hint}", {"key": repr(key), "name": key, "hint": hint}
                )
        return data

    def given(self) -> dict[str, Any]:
        """Returns key -> value of the keys that the file gives."""
        return {
            name: getattr(self, name) for name in type(self).model_fields if name in self.model_fields_set
        }


def _scalar(value: object) -> object:
    if not isinstance(value, (bool, int, float, str)):
        raise PydanticCustomError(_SCALAR, "a number, a text, true or false")
    return value


Value = Annotated[Any, BeforeValidator(_scalar), WithJsonSchema({"type": ["number", "string", "boolean"]})]
"""A value of a variable; its type is checked against the FMU."""


MakeTable = Callable[[], type[Table]]


def table_of(
    key: str,
    kind: str,
    *builders: Callable[..., object],
    without: Iterable[str] = (),
    types: Mapping[str, Any] | None = None,
    also: Mapping[str, Any] | None = None,
) -> MakeTable:
    """Makes the type of the tables with key = "kind", whose other keys are the arguments of some functions.

    without: arguments that no file gives; types: of arguments that a file gives in another type
    also: keys that are no arguments -> (type, default)
    """

    def make() -> type[Table]:
        fields: dict[str, Any] = {key: (Literal[kind], ...), **(also or {})}
        for builder in builders:
            _, meanings = _text_and_meanings(builder)
            for argument in inspect.signature(builder).parameters.values():
                if argument.name not in without:
                    hint = _FILE_TYPES.get(argument.annotation, argument.annotation)
                    hint = (types or {}).get(argument.name, hint)
                    fields[argument.name] = hint, _field(argument.default, meanings.get(argument.name))
        text, _ = _text_and_meanings(builders[-1])
        return create_model(f"{kind} table", __base__=Table, __doc__=text, **fields)

    return cache(make)


def _text_and_meanings(builder: Callable[..., object]) -> tuple[str, dict[str, str]]:
    """Returns a docstring above its sections, and argument -> meaning from its section Parameters."""
    text, *sections = re.split(r"\n\n(?=\w+\n-+\n)", inspect.getdoc(builder) or "")
    listed = next((one for one in sections if one.startswith("Parameters\n")), "")
    items = re.findall(r"^(\w[\w, ]*) : .*\n((?: {4}.*(?:\n|$))+)", listed, re.M)
    meanings = {name: " ".join(lines.split()) for names, lines in items for name in names.split(", ")}
    return text.removeprefix("Returns "), meanings


def _field(default: Any, meaning: str | None) -> Any:
    if default is None or (isinstance(default, float) and not math.isfinite(default)):
        # JSON has neither INF nor NaN: the schema states no default
        return Field(default_factory=lambda: default, description=meaning)
    return Field(... if default is inspect.Parameter.empty else default, description=meaning)


class OneOf:
    """Marks a type as a table whose `key` names its kind; if droppable, `false` stands for none.

    tables: kind -> what makes its type, when a file has such a table
    keyless: tables without that key, by one that they have instead
    """

    def __init__(
        self,
        key: str,
        tables: Mapping[str, MakeTable],
        droppable: bool = False,
        keyless: Mapping[str, type[Table]] | None = None,
    ) -> None:
        self._key, self._droppable = key, droppable
        self._tables, self._keyless = tables, keyless or {}

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        tables = [*(make() for make in self._tables.values()), *self._keyless.values()]
        members = [*tables, *([Literal[False]] if self._droppable else [])]
        # Any: a type checker cannot evaluate a Union of members that are known at run time
        one_of: Any = Union
        return {"oneOf": handler(TypeAdapter(one_of[tuple(members)]).core_schema)["anyOf"]}

    def _validated(self, value: Any) -> Table | Literal[False]:
        if value is False and self._droppable:
            return False
        if isinstance(value, dict):
            kind = value.get(self._key)
            if isinstance(kind, str) and kind in self._tables:
                return self._tables[kind]().model_validate(value)
            for key, table in self._keyless.items() if kind is None else ():
                if key in value:
                    return table.model_validate(value)
        context = {"known": ",".join(self._tables), "keys": ",".join([self._key, *self._keyless])}
        raise PydanticCustomError(_KIND, _KIND, context)


At = Callable[[KeyPath], str]
"""Keys of a file -> its path and the line."""


def checked(model: TypeAdapter[T], data: object, where: At | str) -> T:
    """Returns the data as that type; ScenarioError names the key, its value and the expected one."""
    try:
        return model.validate_python(data)
    except ValidationError as error:
        raise _mistake(error.errors()[0], data, where) from None


def check_part(
    model: TypeAdapter[T], data: object, where: At, absent: Collection[KeyPath], top: Collection[str]
) -> None:
    """Checks data that need not have the keys at the paths `absent`; top: keys that belong to no table."""
    try:
        model.validate_python(data)
    except ValidationError as error:
        for details in error.errors():
            if details["type"] != "missing" or details["loc"] not in absent:
                raise _mistake(details, data, where, top) from None


def _mistake(error: ErrorDetails, data: object, where: At | str, top: Collection[str] = ()) -> ScenarioError:
    keys = _keys(error, data)
    if error["type"] == _UNKNOWN_KEY:
        keys = (*keys, error.get("ctx", {})["name"])
    misplaced = [key for key in keys[1:][-1:] if key in top]
    hint = "".join(f"; {key} of the file stands above the first [table]" for key in misplaced)
    return ScenarioError(f"{where if isinstance(where, str) else where(keys)}: {_line(error, data)}{hint}")


def _line(error: ErrorDetails, data: object) -> str:
    keys = _keys(error, data)
    path = _written(keys)
    value, context, kind = error["input"], error.get("ctx", {}), error["type"]
    before, subject = (f"{path}: ", f"{path} = ") if path else ("", "")
    table = keys[:-1] if kind == "missing" else keys
    if kind in (_SCALAR, _KIND, "missing") and _has_unquoted_name(table, value, kind == _SCALAR):
        name = f"{table[-1]}.{next(iter(value))}"
        return f'{_written(table[:-1])}: {name} has a dot: quote it, "{name}"'
    if kind == "missing":
        return f"{path} is missing"
    if kind == _UNKNOWN_KEY:
        return f"{before}{error['msg']}"
    if kind == _KIND and isinstance(value, dict):
        return f"{before}{_unknown_kind(value, context['keys'].split(','), context['known'].split(','))}"
    if kind in _CHOICES:
        known = re.findall(r"'([^']*)'", context["expected"])
        return f"{subject}{value!r}; {nearest(str(value), known)}"
    expected = _EXPECTED.get(kind, error["msg"].removeprefix("Input should be ")).format(**context)
    hint = "; a Boolean input takes 0 and 1" if kind == "float_type" and isinstance(value, bool) else ""
    return f"{subject}{reprlib.repr(value)}: expected {expected}{hint}"


def _has_unquoted_name(table: KeyPath, value: Any, scalar_expected: bool) -> bool:
    """Whether a table may come of a key component.variable, which TOML reads as a table in a table."""
    if not (isinstance(value, dict) and value and table and isinstance(table[-1], str)):
        return False
    return scalar_expected or all(isinstance(item, dict) for item in value.values())


def _unknown_kind(value: Mapping[str, object], keys: list[str], known: list[str]) -> str:
    key, *others = keys
    if key not in value and others:
        return f"expected one of the keys {', '.join(keys)}; {nearest(next(iter(value), ''), keys)}"
    if key not in value:
        return f"{key} is missing; expected one of {', '.join(known)}"
    return f"unknown {key} {value[key]!r}; {nearest(str(value[key]), known)}"


def _keys(error: ErrorDetails, data: Any) -> KeyPath:
    """Returns the keys that lead to an error in a file, without the kinds of unions."""
    keys: KeyPath = ()
    missing = error["type"] == "missing"
    for part in error["loc"][:-1] if missing else error["loc"]:
        is_item = isinstance(data, list) and isinstance(part, int)
        if is_item or (isinstance(data, Mapping) and part in data):
            keys, data = (*keys, part), cast(Any, data)[part]
    return (*keys, error["loc"][-1]) if missing else keys


def _written(keys: KeyPath) -> str:
    """Keys as TOML writes them."""
    names = (key if re.fullmatch(r"[\w-]+", str(key), re.ASCII) else f'"{key}"' for key in keys)
    parts = (f"[{k}]" if isinstance(k, int) else f".{name}" for k, name in zip(keys, names, strict=True))
    return "".join(parts).removeprefix(".")
