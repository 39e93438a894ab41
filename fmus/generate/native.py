"""Traced block -> C sources and compiled libraries, which need nothing on the host.

`fmi2.c`, in an FMU of FMI 3.0 `fmi3.c`, is the only file to compile. It includes others of the hand-written
layer, and of the block the tables in `model.h` and the equations in `model_code.h`; but `model_lanes.h` has
the equations for groups of instances, which an ensemble compiles.
"""

import ctypes
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from typing import Any

from fmus.block.scalars import flatten
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.fmi.binding import OK, BoundInstance, Library, status_name
from fmus.fmi.callbacks import Callbacks
from fmus.fmi.fmi3 import Fmi3Library
from fmus.fmi.variable_types import INTEGER_RANGE, TRANSFER_TYPE
from fmus.generate.c_code import c_code
from fmus.generate.derivatives import Sensitivities
from fmus.generate.describe import fmi3_variables, other_variables
from fmus.generate.trace import Traced
from fmus.native.toolchain import compiling
from fmus.platforms import check_platforms, host_platform, library_name

COMPILED = {2: ("fmi2.c",), 3: ("fmi3.c",)}
# bits of the set of items, a uint32_t of variables.h
_WORD = 32
_SETTABLE = {"fixed": "BEFORE_STEPPING", "continuous": "ALWAYS"} | dict.fromkeys(
    ("tunable", "discrete"), "AT_POINTS"
)
_FIRST = """
/* By value reference, from 1: index of its first scalar in these tables; last, the number of scalars. */
static const fmi3ValueReference FIRST[] = {{0, {}, sizeof ACCESS / sizeof *ACCESS}};
"""


@contextmanager
def compiled_libraries(
    name: str, members: dict[str, bytes], platforms: Sequence[str], fmi: int = 2
) -> Iterator[Callable[[], dict[str, bytes]]]:
    """Starts compiling libraries beside this process; yields a function that waits for them.

    The function returns path inside the FMU -> library, made from the FMU's sources.
    platforms: by default this one
    Raises ExportError for an unknown platform.
    """
    sources = {Path(path).name: members[path].decode() for path in members if path.startswith("sources/")}
    with ExitStack() as stack:
        ends = {
            library_name(name, platform, fmi): stack.enter_context(
                compiling(name, sources, COMPILED[fmi], platform)
            )
            for platform in check_platforms(platforms) or (host_platform(),)
        }
        yield lambda: {path: end() for path, end in ends.items()}


def c_sources(
    traced: Traced,
    modes: Sensitivities,
    guid: str,
    reals_only: bool = False,
    fmi: int = 2,
    scalars: bool = False,
) -> dict[str, str]:
    """Returns file name -> text of the FMU's folder `sources`: all but FMI's own headers (2.3).

    reals_only: whether every variable is a Real; items, truth values and Integers are then whole numbers
    scalars: whether the elements of arrays are variables of FMI 3.0
    """
    layer = resources.files("fmus") / "native"
    texts = dict(_included(layer, COMPILED[fmi][0]))
    places = [str(members[0].value_reference) for *_, members in fmi3_variables(traced, scalars)]
    first = _FIRST.format(", ".join(places)) if fmi == 3 else ""
    template = Template((layer / "model.h.in").read_text("utf-8"))
    model = template.substitute(_tables(traced, reals_only, fmi), guid=guid, first=first)
    return texts | {"model.h": model} | c_code(traced, modes.functions(fmi))


def _included(layer: Traversable, name: str) -> Iterator[tuple[str, str]]:
    """Yields names and texts of a hand-written file and of those that it includes; some more than once."""
    file = layer / name
    if file.is_file():
        text = file.read_text("utf-8")
        yield name, text
        for included in re.findall(r'^#include "(.+)"', text, re.MULTILINE):
            yield from _included(layer, included)


def _tables(traced: Traced, reals_only: bool, fmi: int) -> dict[str, object]:
    """Returns the values for the placeholders of `model.h.in`."""
    block = traced.block
    others = other_variables(traced) if fmi == 3 else ()
    described = (*block.variables, *block.states, *others)
    not_real = [index for index, v in enumerate(block.of_causality("output")) if v.type != "Real"]
    return {
        "name": block.name,
        "description": " ".join(block.description.split()).replace("*/", "* /"),
        "parameters": len(block.of_causality("parameter")),
        "calculated": len(block.of_causality("calculatedParameter")),
        "inputs": len(block.of_causality("input")),
        "outputs": len(block.of_causality("output")),
        "states": traced.step.numel_out(0),
        "n_whole": len(not_real),
        # C99 has no empty arrays
        "whole": ", ".join(map(str, (*not_real, 0))),
        "requirements": len(traced.required),
        "internal_step": next(v.value_reference for v in block.variables if v.name == "internal_step"),
        "continuous": len(block.states) // 2,
        "indicators": traced.indicators,
        "step_size": repr(float(block.step_size)),
        "fmi": fmi,
        "others": len(others),
        "has_derivative": int(block.derivative is not None),
        "nominals": ", ".join(repr(float(v.nominal or 1.0)) for v in block.states) or "0",
        "variables": ",\n".join(
            [*(_row(v, reals_only) for v in described), *(_row(v, True) for v in block.state_variables)]
        ),
        "access": ", ".join(_access(v, reals_only, fmi) for v in described),
        "required": ",\n".join(f"    {_string(text)}" for text in (*traced.required, "")),
    }


def _row(v: BlockVariable, reals_only: bool) -> str:
    is_converted = reals_only and v.type != "Real"
    items = [0, 1] if is_converted and v.type == "Boolean" else _items(v)
    values = (float(v.start), *_range(v), hex(sum(1 << item for item in items)), int(is_converted))
    cells = (_string(v.name), *values, _string(v.expected))
    return f"    {{{', '.join(map(str, cells))}}}"


def _access(v: BlockVariable, reals_only: bool, fmi: int) -> str:
    settable = _SETTABLE[v.variability] if v.settable else "NEVER"
    kind = v.type if fmi == 3 else TRANSFER_TYPE[v.type]
    is_continuous = int(v.variability == "continuous")
    return f"{{{'REAL' if reals_only else kind.upper()}, {settable}, {is_continuous}}}"


def _range(v: BlockVariable) -> tuple[float, float]:
    """Returns the range that the C layer accepts: the declared limits, else the range of the type."""
    if items := [0, 1] if v.type == "Boolean" else _items(v):
        return float(min(items)), float(max(items))
    is_wide = v.type == "Real" or v.causality == "local"
    low, high = (-sys.float_info.max, sys.float_info.max) if is_wide else INTEGER_RANGE
    return float(low if v.minimum is None else v.minimum), float(high if v.maximum is None else v.maximum)


def _items(v: BlockVariable) -> list[int]:
    """Returns the numbers of an enumeration's items, none of another type."""
    numbers = [int(item) for item in v.enumeration or ()]
    if not all(0 <= number < _WORD for number in numbers):
        raise ExportError(f"{v.name}: items {numbers}: expected numbers from 0 to {_WORD - 1}")
    return numbers


def _string(text: str) -> str:
    """Returns a C string literal of the UTF-8 bytes: everything but plain printable ASCII as octal."""
    # ?? would begin a trigraph
    plain = set(range(32, 127)) - set(b'"\\?')
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'


# the first words of `Data` in fmus/native/instance.h: mode, stale parameters, stale outputs, rates of inputs
_UNKNOWN_PARAMETERS, _AT_START, _IN_STEPS = (2, 1, 1, 0), (2, 0, 1, 0), (4, 0, 0, 0)


class ShippedLibrary(BoundInstance):
    """An instance of the library whose saved state is written in memory, as fmus/native/snapshot.h has it.

    fmi: the version of the standard
    """

    def __init__(self, traced: Traced, guid: str, content: bytes, fmi: int = 2) -> None:
        block = traced.block
        # Windows does not remove a library that is loaded, and adds .dll to a name without a dot
        folder = tempfile.TemporaryDirectory(prefix="l1-depth-build-", ignore_cleanup_errors=True)
        with ExitStack() as made:
            path = Path(made.enter_context(folder)) / "fmu.library"
            path.write_bytes(content)
            super().__init__(Fmi3Library(path) if fmi == 3 else Library(path), Callbacks())
            self.instantiate(block.name, guid, path, logging_on=False)
            self._saved, self._states = self.get_fmu_state(), traced.step.numel_out(0)
            self._folder = made.pop_all()
        self._calculated, self._variables = len(flatten(block.calculated)), 1 + len(block.variables)
        words = self._saved + (len(guid) // 8 + 1) * 8
        self._words = (ctypes.c_int64 * 4).from_address(words)
        # time, variables, rates of inputs and state; the last two have one number more than there are
        count = self._variables + len(flatten(block.inputs)) + self._states + 2
        self._numbers = (ctypes.c_double * count).from_address(words + ctypes.sizeof(self._words))

    def check_status(self, function: str, status: int) -> None:
        if status != OK:
            raise ExportError(f"the new library: {function} returns {status_name(status)}: expected ok")

    def close(self) -> None:
        """Frees the instance and unloads the library."""
        self.free_fmu_state(self._saved)
        self.free_instance()
        self.library.unload()
        self.callbacks.close()
        self._folder.close()

    def free_instance(self) -> None:
        self.library.fmi2FreeInstance(self.handle)

    def calculated(self, p: Any) -> list[float] | None:
        """Returns the calculated parameters, at some inputs; None if the FMU refuses the parameters."""
        first = 1 + len(flatten(p))
        self._numbers[1:first] = flatten(p)
        numbers = self._numbers_after(_UNKNOWN_PARAMETERS, "fmi2ExitInitializationMode")
        return numbers and numbers[first : first + self._calculated]

    def reached(self, t: float, *arguments: Any) -> tuple[float, list[float], list[float]] | None:
        """Returns time [s], state and outputs after the initialization or a step; None if the FMU refuses it.

        arguments: of the block's `initial_state` after t, or of its `step`
        """
        *step, u, p, c = arguments
        known = [t, *flatten(p), *flatten(c), *flatten(u)]
        self._numbers[: len(known)] = known
        call: tuple[Any, ...] = _AT_START, "fmi2ExitInitializationMode"
        if step:
            self._numbers[-self._states - 1 :] = [*flatten(step[1]), 0.0]
            call = _IN_STEPS, "fmi2DoStep", t, step[0], 1
        if (numbers := self._numbers_after(*call)) is None:
            return None
        return numbers[0], numbers[-self._states - 1 : -1], numbers[len(known) : self._variables]

    def _numbers_after(self, words: tuple[int, ...], function: str, *times: float) -> list[float] | None:
        self._words[:] = words
        self.set_fmu_state(self._saved)
        if self.status(function, *times) != OK:
            return None
        self.get_fmu_state(self._saved)
        return self._numbers[:]
