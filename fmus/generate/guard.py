"""Guard of a tracing: refuses uses of a symbol, and calls, that would become constants.

Python asks a symbol for a number (`math.tanh(x)`), a truth value (`if x > 0`) or a key (`table[x]`); CasADi
gives NaN or an identity for some of these without an error, and its `%`, `//` and `round` differ from
Python's. A clock, a random number or an assigned global would keep the value that it has during the tracing.
"""

import dis
import linecache
import operator
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np

from fmus import numerics
from fmus.errors import ExportError
from fmus.extras import imports_of
from fmus.numerics.hints import hint

with imports_of("build", "building an FMU"):
    import casadi

_LIBRARIES = {*sys.stdlib_module_names, "casadi", "numpy"} - {"__main__"}
_OURS = (f"{__name__}.", f"{numerics.__name__}.")
_PROJECT, _INSTALLED = {"fmus", "orchestration"}, {"site-packages", "dist-packages"}
# modules whose compiled functions give another value at each call
_DRAWS = {"time", "random", "_random"}
# functions of the same kind, in classes and modules that have other functions, too
_CLOCKS = {"now", "utcnow", "today", "urandom", "getrandom"}
# Two tracings at a time would restore each other's methods.
_LOCK = threading.Lock()

# method of a symbol -> what Python asks it for, and the function of fmus.numerics to use
_REFUSED = {
    "__float__": ("a number is needed", ""),
    "__int__": ("an integer is needed", "trunc"),
    "__index__": ("an integer is needed", "choose"),
    "__bool__": ("a truth value is needed", "where"),
    "__hash__": ("a key is needed", "select"),
    "__str__": ("a text is needed", ""),
    "__format__": ("a text is needed", ""),
    "__iter__": ("a sequence is needed", ""),
    "__getitem__": ("a sequence is needed", ""),
    "__array__": ("a NumPy array is needed", ""),
    "__round__": ("Python's is of a number", "round"),
    "__mod__": ("Python and compiled code differ", "fmod"),
    "__floordiv__": ("Python and compiled code differ", "floor"),
    "__divmod__": ("Python and compiled code differ", "fmod"),
    "__and__": ("a truth value is needed", "logical_and"),
    "__or__": ("a truth value is needed", "logical_or"),
    "__xor__": ("a truth value is needed", "logical_xor"),
    "__invert__": ("a truth value is needed", "logical_not"),
}
_BINARY = ("__mod__", "__floordiv__", "__divmod__", "__and__", "__or__", "__xor__")
_REFUSED |= {f"__r{name[2:]}": _REFUSED[name] for name in _BINARY}
_UNKNOWN = "but the value is not known before the FMU runs"
NO_MEMORY = "an FMU has no memory beside its state"
# An operator between a NumPy number and a symbol calls these functions of NumPy.
_OPERATORS = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "power": operator.pow,
    "less": operator.lt,
    "less_equal": operator.le,
    "greater": operator.gt,
    "greater_equal": operator.ge,
    "equal": operator.eq,
    "not_equal": operator.ne,
}


class _RefusedError(TypeError):
    """A use of a symbol that has no meaning in compiled code; `function` is the one to use instead."""

    def __init__(self, reason: str, function: str = "") -> None:
        super().__init__(reason)
        self.function = function


def call(block: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Returns the result of a block's function for symbols; ExportError names the line that prevents it."""
    try:
        with _guarded(_package(getattr(function, "__module__", ""))):
            return function(*arguments)
    except Exception as error:
        raise ExportError(f"block {block!r} cannot be traced: {_reason(error)}") from error


def location(function: Callable[..., Any]) -> str:
    """Returns the file and line of a function, as the beginning of a message."""
    code = getattr(function, "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}: " if code else ""


@contextmanager
def divisions() -> Iterator[list[tuple[str, casadi.SX]]]:
    """Yields a list that gets the line, "FILE:LINE: text", and the divisor of each division by a symbol."""
    found: list[tuple[str, casadi.SX]] = []
    originals = {name: getattr(casadi.SX, name) for name in ("__truediv__", "__rtruediv__")}

    def recording(name: str) -> Callable[..., Any]:
        def method(symbol: casadi.SX, other: Any) -> Any:
            frame = sys._getframe(1)
            while frame.f_back and not _is_users(frame):
                frame = frame.f_back
            file, line = frame.f_code.co_filename, frame.f_lineno
            divisor = other if name == "__truediv__" else symbol
            found.append((f"{file}:{line}: {linecache.getline(file, line).strip()}", casadi.SX(divisor)))
            return originals[name](symbol, other)

        return method

    try:
        for name in originals:
            setattr(casadi.SX, name, recording(name))
        yield found
    finally:
        for name, original in originals.items():
            setattr(casadi.SX, name, original)


@contextmanager
def _guarded(package: str) -> Iterator[None]:
    with _LOCK:
        profile, originals = sys.getprofile(), {name: vars(casadi.SX).get(name) for name in _methods()}
        try:
            for name, method in _methods().items():
                setattr(casadi.SX, name, method)
            sys.setprofile(partial(_refuse_impure, package))
            yield
        finally:
            sys.setprofile(profile)
            for name, original in originals.items():
                delattr(casadi.SX, name) if original is None else setattr(casadi.SX, name, original)


@cache
def _methods() -> dict[str, Callable[..., Any]]:
    """Returns the methods that a symbol has while a block is traced, by name."""
    methods = {name: _refusal(getattr(casadi.SX, name, None), *_REFUSED[name]) for name in _REFUSED}
    return methods | {"__array_ufunc__": _array_ufunc, "__array_function__": _array_function}


def _array_ufunc(symbol: casadi.SX, ufunc: Any, method: str, *others: Any, **options: Any) -> Any:
    is_operator = ufunc.__name__ in _OPERATORS and any(isinstance(other, np.generic) for other in others)
    if is_operator and not any(isinstance(other, np.ndarray) for other in others):
        return _OPERATORS[ufunc.__name__](*(x.item() if isinstance(x, np.generic) else x for x in others))
    return _array_function(symbol)


def _array_function(symbol: casadi.SX, *others: Any) -> Any:
    raise _RefusedError(f"NumPy's functions are of numbers, {_UNKNOWN}")


def _refusal(original: Callable[..., Any] | None, reason: str, function: str) -> Callable[..., Any]:
    def method(symbol: casadi.SX, *others: Any) -> Any:
        if original and all(casadi.SX(number).is_constant() for number in (symbol, *others)):
            return original(symbol, *others)
        raise _RefusedError(f"{reason}, {_UNKNOWN}", function)

    return method


def _refuse_impure(package: str, frame: FrameType, event: str, called: Any) -> None:
    """Refuses impure calls of the block's code and of modules beside it: the profile function of a tracing.

    Calls of other code pass: Python runs handlers of signals and of the garbage collector in between.
    """
    if event == "call" and (name := _assigned_global(frame.f_code)) and _is_of_block(frame, package):
        raise _RefusedError(f"the global {name} is assigned, but {NO_MEMORY}")
    if event == "c_call" and _is_draw(called) and _is_of_block(frame, package):
        raise _RefusedError(f"{called.__name__} gives another value at each call; use the time and the state")


def _is_draw(called: Any) -> bool:
    module = called.__module__ or type(getattr(called, "__self__", None)).__module__
    return module in _DRAWS or called.__name__ in _CLOCKS


def _is_of_block(frame: FrameType | None, package: str) -> bool:
    """Whether code of the block calls, perhaps through libraries.

    Code of the block is in its package, or it is not installed, as a module beside the block.
    """
    own = None
    while frame and _module(frame) != __name__:
        # An import happens once, not at each call.
        if _module(frame).startswith("importlib"):
            return False
        own = own or (None if _is_library(frame) else frame)
        frame = frame.f_back
    return own is not None and (_package(_module(own)) == package or _is_beside(own))


def _is_beside(frame: FrameType) -> bool:
    """Whether the code of a frame is neither installed nor ours."""
    file = frame.f_code.co_filename
    return not (_package(_module(frame)) in _PROJECT or _INSTALLED & {*Path(file).parts} or file[:1] == "<")


@cache
def _assigned_global(code: CodeType) -> str:
    return next((step.argval for step in dis.get_instructions(code) if step.opname == "STORE_GLOBAL"), "")


def _is_library(frame: FrameType) -> bool:
    return _package(_module(frame)) in _LIBRARIES or f"{_module(frame)}.".startswith(_OURS)


def _module(frame: FrameType) -> str:
    return frame.f_globals.get("__name__", "")


def _package(module: str) -> str:
    return module.partition(".")[0]


def _reason(error: Exception) -> str:
    """Returns the user's file, line and expression that led to an error, and the code to write instead."""
    # NumPy raises another error, with the refusal as its cause.
    cause = error.__cause__ if isinstance(error.__cause__, _RefusedError) else error
    own = own_line(error)
    if not own:
        return f"{cause}"
    file, line, expression = own
    if not isinstance(cause, _RefusedError):
        use = hint(expression, "", "") if type(cause) is TypeError else ""
        return f"{file}:{line}: {expression}: {type(cause).__name__}: {cause}" + (f"; {use}" if use else "")
    use = hint(expression, linecache.getline(file, line).strip(), cause.function)
    use = use or ("use tuples and fmus.numerics" if "NumPy" in str(cause) else "")
    where = f"{file}:{line}: {expression}" if expression else f"{file}:{line}"
    return f"{where}: {cause}" + (f"; {use}" if use else "")


def own_line(error: BaseException) -> tuple[str, int, str] | None:
    """Returns the user's file, line and expression that led to an error, or None."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    summaries = traceback.extract_tb(error.__traceback__)
    users = [(frame, s) for frame, s in zip(frames, summaries, strict=True) if _is_users(frame)]
    beside = [s for frame, s in users if _is_beside(frame)]
    # a block may be installed itself
    own = beside or [s for _, s in users]
    if not own:
        return None
    file, line, column = own[-1].filename, own[-1].lineno or 0, own[-1].colno or 0
    end = own[-1].end_colno if line == own[-1].end_lineno else None
    return file, line, linecache.getline(file, line).encode()[column:end].decode().strip()


def _is_users(frame: FrameType) -> bool:
    # the generated methods of a dataclass have the file "<string>"
    return not _is_library(frame) and not frame.f_code.co_filename.startswith("<")
