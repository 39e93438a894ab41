"""Blocks: one declaration of each variable, from which everything else is derived.

A block is a set of dataclasses (parameters, calculated parameters, inputs, state, outputs) and
pure functions between them. The model description, the checks, the documentation and the FMU are all
derived from a `Block`; so nothing here depends on FMI's XML or C.
"""

import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, fields, make_dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from types import FunctionType
from typing import Any

from fmus.block.guide import NO_GUIDE, Guide
from fmus.block.integration import between_events, rk4_step
from fmus.block.scalars import flatten, unflatten
from fmus.block.variables import (
    ROLES,
    BlockVariable,
    plain,
    restarted,
    scalar_variables,
    state_variables,
    variable,
)
from fmus.errors import nearest, range_text

__all__ = ["Block", "NoValues", "variable"]

# internal step of a block that declares none, in s
_SHORTEST, _LONGEST = 1e-7, 1e6


@dataclass(frozen=True)
class NoValues:
    """Class that stands for variables that a block does not have."""


_STATE_AS_DECLARED: Any = None
_CLASSES = ("Parameters", "Calculated", "Inputs", "State", "Outputs", "Continuous")
_OF_TIME = ("initial_state", "step", "output", "derivative", "integrate", "crossings")
# field of a block -> its name in the module that `Block.of_module` reads
_NAMES = {name.lower(): name for name in (*_CLASSES, *_OF_TIME, "calculate", "requirements", "GUIDE")}
# share of letters in common: a misspelt name, which would leave a part of the block out
_LIKE = 0.85


@dataclass(frozen=True, eq=False)
class Block:
    """A model as data: frozen dataclasses and the pure functions between them.

    `Block.of_module` takes these from a module, by their names. Times t and h are in s. The functions are

    initial_state(t, inputs, parameters, calculated) -> State; by default the state as it is declared
    step(t, h, state, inputs, parameters, calculated) -> State, over h seconds, inputs held
    output(t, state, parameters, calculated) -> Outputs
    calculate(parameters) -> Calculated, the values that follow from parameters alone
    requirements(parameters, calculated) -> ((condition, expectation in words), ...)

    A block with continuous states declares them with `variable` in a class `Continuous`, the base class of
    `State`, and

    derivative(t, state, inputs, parameters, calculated) -> Continuous, the derivatives by time
    integrate(t, h, state, inputs, parameters, calculated) -> State, its continuous states h s later;
        by default the classical fourth-order Runge-Kutta method, inputs held
    crossings(t, state, inputs, parameters, calculated) -> (number, ...), event indicators: each changes its
        sign where the derivative has a corner or a jump

    `step` is then called after `integrate`, for samples at t + h and for copies of inputs in the state; in
    model exchange with h = 0. States that change at samples or events alone go through `sampled` or
    `at_events` of `fmus.numerics`. Between events, `derivative` and `crossings` get a state with up-to-date
    copies of the inputs; the rest of it is as it was at the last event.

    `Parameters` has an `internal_step` [s], the longest step that `step` is called with. A block that
    declares none gets one that starts at `step_size`.

    Parameters
    ----------
    name, description : str
        Name of the FMU, and one line about it.
    parameters, inputs, state, outputs, continuous, calculated : type
        The classes; only `outputs` is required.
    initial_state, step, output, calculate, requirements, derivative, integrate, crossings : function
        The functions; only `output` is required.
    stop_time, step_size : float
        Default experiment of the FMU, in s.
    guide : Guide
        Equations, advice, limits and sources of the documentation.
    version, author, license : str, optional
        Of the model.

    Raises
    ------
    TypeError
        For classes and numbers that cannot be a block. The message has the expected ones.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Outputs:
    ...     y: float = variable(0.0, "Twice the time", unit="s")
    >>> block = Block("Clock", "A clock", outputs=Outputs, output=lambda t, state, p, c: Outputs(2.0 * t))
    >>> [v.name for v in block.variables]
    ['internal_step', 'y']
    """

    name: str
    description: str
    _: KW_ONLY
    parameters: type = NoValues
    inputs: type = NoValues
    state: type = NoValues
    outputs: type
    continuous: type = NoValues
    initial_state: Callable[..., Any] = _STATE_AS_DECLARED
    derivative: Callable[..., Any] | None = None
    integrate: Callable[..., Any] | None = None
    crossings: Callable[..., tuple[Any, ...]] = lambda t, state, inputs, parameters, calculated: ()
    step: Callable[..., Any] = lambda t, h, state, inputs, parameters, calculated: state
    output: Callable[..., Any]
    calculated: type = NoValues
    calculate: Callable[[Any], Any] = lambda parameters: NoValues()
    requirements: Callable[[Any, Any], tuple[tuple[Any, str], ...]] = lambda parameters, calculated: ()
    stop_time: float = 1.0
    step_size: float = 0.01
    guide: Guide = NO_GUIDE
    version: str | None = None
    author: str | None = None
    license: str | None = None

    def __post_init__(self) -> None:
        for name in ("stop_time", "step_size"):
            object.__setattr__(self, name, plain(getattr(self, name)))
        for mistake in self._mistakes():
            raise TypeError(f"block {self.name!r}: {mistake}")
        if self.state is NoValues:
            object.__setattr__(self, "state", self.continuous)
        for role in ("parameters", "calculated", "inputs", "continuous", "state", "outputs"):
            if not is_frozen(getattr(self, role)):
                raise TypeError(f"block {self.name!r}: {role}: expected a class with @dataclass(frozen=True)")
        if self.continuous is not NoValues and not fields(self.continuous):
            raise TypeError(
                f"block {self.name!r}: continuous: expected a state at least, or no class Continuous"
            )
        if "internal_step" not in {declared.name for declared in fields(self.parameters)}:
            if not _SHORTEST <= self.step_size <= _LONGEST:
                expected = f"expected {range_text(_SHORTEST, _LONGEST, 's')}, the range of the internal step"
                raise TypeError(f"block {self.name!r}: step_size {self.step_size!r}: {expected}")
            start = float(self.step_size)
            object.__setattr__(self, "parameters", _with_internal_step(self.parameters, start))
        if self.initial_state is _STATE_AS_DECLARED:
            object.__setattr__(self, "initial_state", lambda *_: self.state())

    @classmethod
    def of_module(cls, module: str, name: str, description: str, **given: Any) -> "Block":
        """Returns the block of a module, for a line at its end: `BLOCK = Block.of_module(__name__, ...)`.

        The parts are the module's Parameters, Calculated, Inputs, Continuous, State, Outputs, initial_state,
        step, output, calculate, requirements, derivative, integrate, crossings and GUIDE. Only Outputs and
        output are required.

        Parameters
        ----------
        module : str
            `__name__` of the module.
        name, description : str
            Name of the FMU, and one line about it.
        **given
            Other fields, such as stop_time=60.0, and parts that are imported or have another name.

        Returns
        -------
        Block

        Raises
        ------
        TypeError
            If a part is missing or imported, and for a name that is nearly the name of a part.
        """
        for mistake in _mistaken_names(module, given):
            raise TypeError(f"block {name!r}: {mistake}")
        members = vars(sys.modules[module])
        parts = {part: members[own] for part, own in _NAMES.items() if own in members}
        return cls(name, description, **(parts | given))

    def with_starts(
        self, module: str, name: str, description: str, starts: Mapping[str, tuple[Any, str]], **given: Any
    ) -> "Block":
        """Returns a block with the functions of this one and other start values of its parameters.

        Parameters
        ----------
        module : str
            `__name__` of the module that defines the new block.
        name, description : str
            Name of its FMU, and one line about it.
        starts : mapping
            Parameter -> (start value, source of the number).
        **given
            Other fields of the new block, such as guide=...

        Returns
        -------
        Block

        Raises
        ------
        TypeError
            For a parameter that this block lacks.
        """
        declared = {parameter.name: parameter for parameter in fields(self.parameters)}
        if unknown := [own for own in starts if own not in declared]:
            raise TypeError(f"block {name!r}: no parameter {unknown[0]!r}; {nearest(unknown[0], declared)}")
        values = {own: start for own, (start, _) in starts.items()}
        parameters = restarted(self.parameters, values, {own: source for own, (_, source) in starts.items()})
        parameters.__module__ = module
        return replace(self, name=name, description=description, parameters=parameters, **given)

    def _mistakes(self) -> Iterator[str]:
        """Yields the mistakes in the texts and numbers, and in the parts of continuous states."""
        for name in ("name", "description", "version", "author", "license"):
            text = getattr(self, name)
            if not isinstance(text, str) and (text is not None or name in ("name", "description")):
                yield f"{name} {text!r}: expected a text"
        for name in ("stop_time", "step_size"):
            number = getattr(self, name)
            if not isinstance(number, float | int) or isinstance(number, bool):
                yield f"{name} {number!r}: expected a number of seconds"
            elif not 0.0 < number < math.inf:
                yield f"{name} {number!r}: expected a finite number of seconds above 0"
        if (self.continuous is NoValues) != (self.derivative is None):
            yield "expected both a class Continuous and a function derivative, or neither"
        if self.integrate and not self.derivative:
            yield "expected a function derivative beside integrate"
        if self.continuous is not NoValues and self.state not in (NoValues, self.continuous):
            # The last base class comes first among the fields: continuous states stand before all others.
            bases = getattr(self.state, "__bases__", ())
            if bases[-1:] != (self.continuous,):
                yield "expected class State(Continuous): the continuous states are a part of the state"

    @cached_property
    def variables(self) -> tuple[BlockVariable, ...]:
        """Scalar variables of the interface; the place of each is its value reference."""
        scalars: list[BlockVariable] = []
        for role in ROLES:
            for declared in fields(getattr(self, role)):
                scalars.extend(scalar_variables(declared, role, len(scalars)))
        return tuple(scalars)

    @cached_property
    def states(self) -> tuple[BlockVariable, ...]:
        """Continuous states and then their derivatives, with the value references after `variables`."""
        states: list[BlockVariable] = []
        first = len(self.variables)
        for declared in fields(self.continuous):
            states.extend(scalar_variables(declared, "continuous", first + len(states), "state."))
        rates = [v.derivative(v.value_reference + len(states)) for v in states]
        return (*states, *rates)

    @cached_property
    def state_variables(self) -> tuple[BlockVariable, ...]:
        """Scalars of the whole state with their ranges; the place of each is its place in the state."""
        return tuple(state_variables(self.state()))

    @cached_property
    def advance(self) -> Callable[..., Any]:
        """Function of a whole step, with the arguments of `step`: `integrate`, then `step`."""
        if self.derivative is None:
            return self.step
        integrate = self.integrate or self._rk4

        def advance(t: float, h: float, state: Any, *others: Any) -> Any:
            return self.step(t, h, integrate(t, h, state, *others), *others)

        return advance

    def held(self, t: float, state: Any, *others: Any) -> Any:
        """Returns the state between events: with up-to-date copies of inputs, the rest as it was.

        Parameters
        ----------
        t : float
            Time [s].
        state : State
            The state, with continuous states of time t.
        *others
            Inputs, parameters and calculated parameters, as `step` takes them.

        Returns
        -------
        State
        """
        with between_events():
            stepped = self.step(t, 0.0, state, *others)
        count = len(flatten(self.continuous))
        return unflatten(state, [*flatten(state)[:count], *flatten(stepped)[count:]])

    def _rk4(self, t: float, h: float, state: Any, *others: Any) -> Any:
        """Integrates the continuous states over h seconds; the rest of the state is held."""
        derivative, count = self.derivative, len(flatten(self.continuous))
        if derivative is None:
            return state
        scalars = flatten(state)

        def rates(time: float, x: tuple) -> tuple:
            reached = unflatten(state, [*x, *scalars[count:]])
            return tuple(flatten(derivative(time, self.held(time, reached, *others), *others)))

        return unflatten(state, [*rk4_step(rates, t, tuple(scalars[:count]), h), *scalars[count:]])

    def of_causality(self, causality: str) -> tuple[BlockVariable, ...]:
        """Returns the scalar variables of one causality, in the order of `variables`.

        Parameters
        ----------
        causality : {"parameter", "calculatedParameter", "input", "output"}
            Causality in FMI.

        Returns
        -------
        tuple of BlockVariable
        """
        return tuple(v for v in self.variables if v.causality == causality)


def _mistaken_names(module: str, given: Collection[str]) -> Iterator[str]:
    """Yields the mistakes in the names of a module that has the parts of a block, except the given ones."""
    members = vars(sys.modules[module])
    sought = {own: part for part, own in _NAMES.items() if part not in given}
    missing = [own for own in sought if own not in members]
    for own, member in members.items():
        if own.startswith("_") or not isinstance(member, type | FunctionType):
            continue
        if member.__module__ == module:
            yield from (f"{own} in {module}: expected {n}" for n in get_close_matches(own, missing, 1, _LIKE))
        elif own in sought:
            # A linter would remove an import that nothing seems to use: it has to be named.
            yield f"{own} is imported into {module}: expected {sought[own]}={own}"
    yield from (f"expected {own} in {module}, above it" for own in ("Outputs", "output") if own in missing)


def is_frozen(cls: Any) -> bool:
    """Whether it is a class with @dataclass(frozen=True).

    Parameters
    ----------
    cls : object
        Anything.

    Returns
    -------
    bool
    """
    # a class inherits the parameters of a base class that is a dataclass
    is_own = isinstance(cls, type) and "__dataclass_params__" in vars(cls)
    return is_own and cls.__dataclass_params__.frozen


def _with_internal_step(parameters: type, start: float) -> type:
    """Returns the class with the parameter `internal_step`, which the block's functions need not use."""
    internal_step = variable(
        start, "Longest internal step", unit="s", min=_SHORTEST, max=_LONGEST, variability="fixed"
    )
    return make_dataclass(
        parameters.__name__, [("internal_step", float, internal_step)], bases=(parameters,), frozen=True
    )
