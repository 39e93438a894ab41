"""A policy: a class with `reset()` and `step(time, inputs) -> outputs` that runs as a block does.

class Policy:
    period = 0.04                                      sampling period [s]
    inputs = ("depth_reference", "measured_depth")     these by default
    outputs = ("control_force",)                       this by default
    gain = 16.5                                        a parameter: numbers of the class, and tuples of them

    def reset(self): ...                               at the start of each run, on a new object
    def step(self, time, inputs): ...                  at start + k period; returns all outputs by name

`step` gets the inputs of the communication point at its time, or the one before it. Its results are the
outputs from the end of that communication step on. The outputs at the start come from a step of another
object, which is then dropped. Each run imports the module again.
"""

import copy
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, fields, is_dataclass
from math import isfinite
from numbers import Real
from pathlib import Path
from time import perf_counter
from typing import Any

from fmus.block import Block, NoValues, variable
from fmus.block.instance import BlockError, BlockInstance, step_tolerance
from fmus.block.own_modules import OwnModules
from fmus.block.scalars import unflatten
from fmus.block.variables import BlockVariable, scalar_variables
from fmus.errors import ExportError, nearest

INPUTS = {
    "depth_reference": "m",
    "depth_reference_rate": "m/s",
    "depth_reference_acceleration": "m/s2",
    "measured_depth": "m",
    "measured_depth_rate": "m/s",
    "roll": "rad",
    "pitch": "rad",
}
"""Inputs of the depth control interface -> unit."""
OUTPUTS = {"control_force": "N", "voltage[1]": "V", "voltage[2]": "V"}
"""Its outputs -> unit: the force, or both voltages."""

_DEFAULTS = {"inputs": ("depth_reference", "measured_depth"), "outputs": ("control_force",)}
_NAME = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?", re.ASCII)
# period [s]
_SHORTEST = 1e-6


class PolicyBlock(Block):
    """A block with the variables of a policy, without functions that could be traced.

    cls: the class
    modules: the modules that its methods find
    parameter_fields: the declared fields of its parameters
    """

    cls: type
    modules: OwnModules
    parameter_fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        """Leaves out the checks of a declaration: a policy has no functions to check."""

    def new(self, values: list[Any]) -> Any:
        """Returns a new object of the class with these values of the parameters.

        `__init__` of a dataclass gets them as arguments; any other finds them as attributes.
        """
        declared = self.parameter_fields
        template = tuple(field.default for field in declared)
        given = dict(zip([field.name for field in declared], unflatten(template, values), strict=True))
        own = {field.name for field in fields(self.cls) if field.init} if is_dataclass(self.cls) else set()
        make: Any = self.cls.__new__
        policy = make(self.cls)
        for name in given.keys() - own:
            # a frozen dataclass refuses `setattr`
            object.__setattr__(policy, name, given[name])
        policy.__init__(**{name: value for name, value in given.items() if name in own})
        return policy


def policy_block(cls: Any, modules: OwnModules | None = None) -> PolicyBlock:
    """Returns the variables of a policy class; ExportError for a class that is no policy.

    modules: the modules that its methods find; by default the modules of this process
    """
    name = getattr(cls, "__name__", repr(cls))
    if not isinstance(cls, type):
        raise ExportError(f"{name} is {cls!r}: expected a class")
    if not cls.__dictoffset__:
        raise ExportError(f"{name} has __slots__: expected none, as parameters are attributes of its objects")
    for method in ("reset(self)", "step(self, time, inputs)"):
        if not callable(getattr(cls, method.partition("(")[0], None)):
            raise ExportError(f"{name}: expected a method {method}")
    declared = tuple(_parameters(cls))
    scalars: list[BlockVariable] = []
    for field in declared:
        scalars.extend(scalar_variables(field, "parameters", len(scalars)))
    for role, known in (("inputs", INPUTS), ("outputs", OUTPUTS)):
        for own, unit in _named(cls, role, known).items():
            field = _field(own, variable(0.0, own.replace("_", " "), unit=unit))
            scalars.extend(scalar_variables(field, role, len(scalars)))
    names = [scalar.name for scalar in scalars]
    if twice := next((one for one in names if names.count(one) > 1), ""):
        raise ExportError(f"{name}: {twice!r} twice among parameters, inputs and outputs: expected one")
    block = PolicyBlock(
        name,
        " ".join((cls.__doc__ or "").split("\n\n")[0].split()) or f"Policy {name}",
        outputs=NoValues,
        output=lambda *_: NoValues(),
        step_size=next(scalar.start for scalar in scalars if scalar.name == "period"),
    )
    own = {"cls": cls, "modules": modules or OwnModules(), "parameter_fields": declared}
    vars(block).update(own, variables=tuple(scalars))
    return block


def _parameters(cls: type) -> Iterator[Field]:
    """Yields the parameters of a class, declared by `variable` or numbers, base classes first."""
    bases = [vars(base) for base in reversed(cls.__mro__)]
    members = {name: _plain(value) for base in bases for name, value in base.items()}
    types = {name: declared for base in bases for name, declared in base.get("__annotations__", {}).items()}
    own = {field.name: field for field in fields(cls)} if is_dataclass(cls) else {}
    period: Any = members.get("period")
    if type(period) not in (int, float) or not isfinite(period) or period < _SHORTEST:
        raise ExportError(
            f"{cls.__name__}.period = {period!r}: expected the sampling period, at least {_SHORTEST} s, "
            "such as period = 0.04"
        )
    for name, value in members.items():
        if isinstance(value, Field):
            raise ExportError(f"{cls.__name__}.{name}: expected @dataclass above the class that declares it")
        if name.startswith("_") or name in _DEFAULTS or not _is_number(value):
            continue
        is_real = name == "period" or (types.get(name) in (float, "float") and isinstance(value, int))
        unit, least = ("s", _SHORTEST) if name == "period" else (None, None)
        is_declared = name in own and "texts" in own[name].metadata
        told = own[name] if is_declared else variable(value, name.replace("_", " "), unit=unit, min=least)
        yield _field(name, told, float(value) if is_real else value, variability="fixed")


def _field(name: str, declared: Any, start: Any = None, **metadata: Any) -> Field:
    """Returns a copy of a declared field with that name, and with other start value and metadata if given."""
    field = copy.copy(declared)
    field.name = name
    field.default = declared.default if start is None else start
    field.metadata = {**declared.metadata, **metadata}
    return field


def _plain(value: Any) -> Any:
    """Returns a number of NumPy as one of Python, any other value as it is."""
    return getattr(value, "item", lambda: value)() if isinstance(value, Real) else value


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number or a truth value of Python, or a tuple of those, not empty."""
    if isinstance(value, tuple):
        return bool(value) and all(map(_is_number, value))
    return isinstance(value, int | float) and isfinite(value)


def _named(cls: type, role: str, known: Mapping[str, str]) -> dict[str, str | None]:
    """Returns name -> unit of the inputs or outputs that a class names."""
    given = getattr(cls, role, _DEFAULTS[role])
    where = f"{cls.__name__}.{role}"
    if isinstance(given, str) or not isinstance(given, tuple | list | Mapping):
        raise ExportError(f"{where} = {given!r}: expected a tuple of names, ({given!r},)")
    if not given and role == "outputs":
        raise ExportError(f"{where}: expected one output at least, such as 'control_force'")
    for name in given:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ExportError(
                f"{where}: {name!r}: expected a name of letters, digits and _, as name or name[1]"
            )
        if name not in known and not isinstance(given, Mapping):
            raise ExportError(
                f"{where}: {name!r} is not a name that a tuple takes; {nearest(name, known)}; "
                "a dictionary {name: unit} may have others"
            )
    return {name: given[name] if isinstance(given, Mapping) else known[name] for name in given}


class _Values(dict[str, float]):
    """The inputs of a step by name; KeyError offers the nearest name."""

    def __missing__(self, name: str) -> float:
        raise KeyError(f"no input {name!r}; {nearest(str(name), self)}; `inputs` of the class names them")


class PolicyInstance(BlockInstance):
    """One instance of a policy: an object of its class, made anew at the start of each run."""

    block: PolicyBlock

    def __init__(self, block: PolicyBlock, fingerprint: str = "") -> None:
        super().__init__(block, fingerprint)
        self._policy: Any = None
        # for snapshots: a copy of the object, time and inputs of the samples since, time to the next copy [s]
        self._noted: tuple[Any, list[tuple[float, list[Any]]], float] | None = None
        with block.modules.present():
            self._file = Path(str(sys.modules[block.cls.__module__].__file__))
        self._begin, self._samples = 0.0, 0
        ends = self._parameters_end, self._inputs_end
        self._names = [v.name for v in block.variables[ends[0] : ends[1]]]
        self._outputs = block.variables[ends[1] :]
        self._period = [v.name for v in block.variables].index("period")

    def _refresh(self) -> None:
        """Calculates the outputs at the start, which follow the inputs, by an object that is then dropped."""
        if self._outputs_are_stale and not self._stepping:
            self._sample(self._begun(), self.time)
            self._outputs_are_stale = False

    def exit_initialization_mode(self) -> None:
        self._refresh()
        self._policy, self._begin, self._samples, self._noted = self._begun(), self.time, 0, None
        self._stepping = True

    def do_step(self, t: float, h: float) -> None:
        """Advances from t to t + h [s]; calls `step` for each sample from t on and before t + h."""
        self._check_step(t, h)
        end, period = t + h - step_tolerance(t, h), self._values[self._period]
        while (time := self._begin + self._samples * period) < end:
            # a step that fails may have changed the object: then the copy counts no more
            noted, self._noted = self._noted, None
            inputs, start = self._values[self._parameters_end : self._inputs_end], perf_counter()
            self._sample(self._policy, time)
            self._samples += 1
            if noted and (left := noted[2] - (perf_counter() - start)) > 0.0:
                noted[1].append((time, inputs))
                self._noted = *noted[:2], left
        self.time = t + h

    def _begun(self) -> Any:
        """Returns a new object at the start of a run."""
        policy = self._call("__init__", self.block.new, self._values[: self._parameters_end])
        self._call("reset", policy.reset)
        return policy

    def _sample(self, policy: Any, time: float) -> None:
        """Sets the outputs to the results of a step."""
        inputs = _Values(zip(self._names, self._values[self._parameters_end :], strict=False))
        result = self._call("step", policy.step, time, inputs)
        self._values[self._inputs_end :] = self._numbers(result, time)

    def _call(self, method: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Calls a method and returns its result; BlockError names the line of the user's file that raises."""
        try:
            with self.block.modules.present():
                return function(*arguments)
        except (Exception, SystemExit) as error:
            where = line_below(error, self._file.parent) or self._place(method)
            at = f" at t = {arguments[0]:.9g} s" if method == "step" else ""
            raise BlockError(f"{where}{at}: {type(error).__name__}: {error}") from error

    def _place(self, method: str) -> str:
        return f"{self._file.name}: {self.block.name}.{method}"

    def _numbers(self, result: Any, time: float) -> list[float]:
        """Returns the values of the outputs from the result of `step`."""
        names, where = [v.name for v in self._outputs], f"{self._place('step')} at t = {time:.9g} s: returned"
        if not isinstance(result, Mapping):
            example = ", ".join(f"{name!r}: number" for name in names)
            raise BlockError(f"{where} {result!r}: expected {{{example}}}")
        if unknown := [name for name in result if name not in names]:
            hint = f"{nearest(str(unknown[0]), names)}; `outputs` of the class names them"
            raise BlockError(f"{where} {unknown[0]!r}, which is no output; {hint}")
        if missing := [name for name in names if name not in result]:
            raise BlockError(f"{where} no {', '.join(map(repr, missing))}: expected all outputs in each step")
        for v in self._outputs:
            value = result[v.name]
            is_number = isinstance(value, Real) or getattr(value, "ndim", None) == 0
            if not is_number or not isfinite(value):
                raise BlockError(f"{where} {v.name} = {value!r}: expected {v.expected}")
        return [float(result[name]) for name in names]

    def snapshot(self) -> Any:
        """Returns a copy of the object and the samples since, with the rest of the instance."""
        # The next copy is made once the samples have taken as long as the last copy: an object that grows is
        # not copied at each communication point.
        if self._noted is None:
            start = perf_counter()
            self._noted = self._copied(self._policy), [], perf_counter() - start
        noted = self._noted, len(self._noted[1])
        return noted, self._begin, self._samples, self.time, self._stepping, list(self._values)

    def restore(self, snapshot: Any) -> None:
        """Restores a snapshot: repeats the samples since its copy."""
        noted, self._begin, self._samples, self.time, self._stepping, values = snapshot
        (copied, samples, left), count = noted
        self._policy, self._noted = self._copied(copied), (copied, samples[:count], left)
        for time, inputs in samples[:count]:
            self._values[self._parameters_end : self._inputs_end] = inputs
            self._sample(self._policy, time)
        self._values = list(values)

    def _copied(self, policy: Any) -> Any:
        with self.block.modules.present():
            return copy.deepcopy(policy)


def line_below(error: BaseException, folder: Path) -> str:
    """Returns FILE:LINE of the deepest line of an error below a folder, or "".

    FILE is relative to the folder. Lines of the copy of `fmus` in an FMU do not count.
    """
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.is_relative_to(folder) and path.relative_to(folder).parts[0] not in ("fmus", "pythonfmu"):
            return f"{path.relative_to(folder).as_posix()}:{frame.lineno}"
    return ""
