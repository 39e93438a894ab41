"""This processor in place of a GPU: the same program, as C++, and arrays as strict as those of CuPy."""

import ctypes
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from fmus.native.toolchain import zig
from orchestration.places.gpu import KERNELS, CompiledDevice, Kernel

# what CuPy has of NumPy, as far as runs and metrics need it
_FUNCTIONS = {
    np.abs, np.any, np.argmax, np.argmin, np.asarray, np.atleast_2d, np.broadcast_to, np.copyto, np.diff,
    np.fft.irfft, np.fft.rfft, np.max, np.mean, np.min, np.shape, np.std, np.sum, np.take,
    np.take_along_axis, np.trapezoid, np.where, np.zeros_like,
}  # fmt: skip
_OPTIONS = ("-std=c++14", "-shared", "-O1", "-ffp-contract=off", "-fno-math-errno", "-nostdlib++")
_COMPILED: dict[str, ctypes.CDLL] = {}


class StrictArray(NDArrayOperatorsMixin):
    """An array that takes no part in what an array of NumPy has a part in, and becomes one by `get` alone."""

    def __init__(self, values: Any) -> None:
        self._values = np.asarray(values)

    def get(self) -> np.ndarray:
        return self._values.copy()

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise TypeError("implicit conversion to an array of NumPy")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = (), **settings: Any) -> Any:
        written = {"out": tuple(map(_plain, out))} if out else {}
        result = getattr(ufunc, method)(*map(_plain, inputs), **written, **settings)
        return out[0] if out else StrictArray(result)

    def __array_function__(self, function: Any, types: Any, arguments: Any, settings: Any) -> Any:
        if function not in _FUNCTIONS:
            raise TypeError(f"{function.__name__} is none of the functions that are known to be in CuPy")
        if function is np.asarray:  # the one way from the host
            return StrictArray(np.array(*arguments, **settings))
        if function is np.shape:
            return self.shape
        plain = {name: _plain(value) for name, value in settings.items()}
        return StrictArray(function(*map(_plain, arguments), **plain))

    def __getattr__(self, name: str) -> Any:
        """What both kinds have: attributes, and methods that return arrays."""
        if name not in ("shape", "ndim", "dtype", "size", "T", "tolist", *_METHODS):
            raise AttributeError(name)
        value = getattr(self._values, name)
        if name in _METHODS:
            return lambda *arguments, **settings: StrictArray(value(*arguments, **settings))
        return StrictArray(value) if name == "T" else value

    def __dlpack__(self, **settings: Any) -> Any:
        return self._values.__dlpack__(**settings)

    def __dlpack_device__(self) -> Any:
        return self._values.__dlpack_device__()

    def __len__(self) -> int:
        return len(self._values)

    def __bool__(self) -> bool:
        return bool(self._values)

    def __getitem__(self, key: Any) -> "StrictArray":
        return StrictArray(self._values[_key(key)])

    def __setitem__(self, key: Any, value: Any) -> None:
        self._values[_key(key)] = _plain(value)


_METHODS = {
    "all",
    "any",
    "clip",
    "copy",
    "flatten",
    "max",
    "mean",
    "min",
    "ravel",
    "reshape",
    "std",
    "sum",
    "transpose",
}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError("an array of NumPy beside one of the device")
    return value._values if isinstance(value, StrictArray) else value


def _key(key: Any) -> Any:
    return tuple(map(_plain, key)) if isinstance(key, tuple) else _plain(key)


class _Arrays:
    """The module of strict arrays."""

    def __getattr__(self, name: str) -> Any:
        if name not in ("empty", "full", "zeros"):
            raise AttributeError(name)
        return lambda *arguments, **settings: StrictArray(getattr(np, name)(*arguments, **settings))

    def array(self, rows: Any) -> StrictArray:
        return StrictArray(np.array([*map(_plain, rows)]))

    def asarray(self, values: Any) -> StrictArray:
        return values if isinstance(values, StrictArray) else StrictArray(np.array(values))

    def from_dlpack(self, values: Any) -> StrictArray:
        return StrictArray(np.from_dlpack(values))


class HostDevice(CompiledDevice):
    """This processor as a device."""

    name = "the host"
    arrays: Any = _Arrays()

    def kernels(self, program: str) -> Mapping[str, Kernel]:
        if program not in _COMPILED:
            # a library that is loaded stays in Windows
            with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                Path(folder, "program.cpp").write_text(program)
                zig(["cc", *_OPTIONS, "program.cpp", "-o", "program.so"], Path(folder))
                _COMPILED[program] = ctypes.CDLL(str(Path(folder, "program.so")))
        library = _COMPILED[program]
        return {name: partial(_call, getattr(library, f"ensemble_{name}_all")) for name in KERNELS}

    def address(self, array: StrictArray) -> int:
        return array._values.ctypes.data

    def free_bytes(self) -> int:
        return 2**34


def _call(function: Any, *arguments: int) -> None:
    function(*map(ctypes.c_int64, arguments))
