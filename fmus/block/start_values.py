"""A block with other start values, for an FMU that already holds the values of a scenario."""

from collections.abc import Mapping
from dataclasses import field, fields, make_dataclass, replace

from fmus.block import Block, Value, flatten, unflatten
from fmus.errors import ExportError, nearest


def with_start_values(block: Block, values: Mapping[str, Value]) -> Block:
    """The block, its parameters and inputs starting at these values; the others as they are declared.

    values: name of a scalar, such as "gain" or "A[1,2]" -> value in the unit of the variable
    Raises ExportError for a name that is no parameter or input, and for a value that it does not accept.
    """
    settable = {v.name: v for v in block.variables if v.settable}
    for name, value in values.items():
        if name not in settable:
            raise ExportError(
                f"block {block.name!r}: no parameter or input {name!r}; {nearest(name, settable)}"
            )
        if reason := settable[name].refuse(value):
            raise ExportError(f"block {block.name!r}: start value {reason}")
    starts = [v.cast(values.get(name, v.start)) for name, v in settable.items()]
    count = len(block.of_causality("parameter"))
    return replace(
        block,
        parameters=_with_defaults(block.parameters, starts[:count]),
        inputs=_with_defaults(block.inputs, starts[count:]),
    )


def _with_defaults(cls: type, starts: list[Value]) -> type:
    """A class of the same fields with these scalars as defaults, row by row."""
    declared, defaults = fields(cls), []
    for member in declared:
        size = len(flatten(member.default))
        defaults.append(unflatten(member.default, starts[:size]))
        starts = starts[size:]
    members = [
        (member.name, member.type, field(default=default, metadata=member.metadata))
        for member, default in zip(declared, defaults, strict=True)
    ]
    return make_dataclass(cls.__name__, members, bases=(cls,), frozen=True) if members else cls
