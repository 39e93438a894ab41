"""Ensembles on a GPU: each thread runs a whole system, with the C layer and the equations of its FMUs.

The sources in the FMUs are compiled as C++, with one namespace for each component. `CompiledDevice`
holds the parts that depend on the device, so that the same program runs on a processor in tests.
"""

import os
import re
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fmus import store
from fmus.extras import require
from fmus.fmi.description import describe
from orchestration.errors import EnsembleError
from orchestration.many.ensemble_loop import EnsembleLoop
from orchestration.many.lane_library import FIRST_VALUE, data_words
from orchestration.many.local_runs import LocalRuns
from orchestration.system.prepared_run import PreparedRun

Array = Any
"""An array of a device, with the interface of NumPy's."""
Kernel = Callable[[int, int, int, int], object]
"""Runs a function of device_loop.h for so many threads: address, threads, and its two last arguments."""
GPU = "gpu"
KERNELS = ("sizes", "exchange", "run", "initialise", "change")
_THREADS = 128  # of a block: a system needs most of a thread's registers
# no fused operations: a product and a sum are rounded as in the FMU
OPTIONS = ("--std=c++14", "--fmad=false", "--device-as-default-execution-space", "--diag-suppress=177")


class CompiledDevice(ABC):
    """A GPU, or in tests this processor: it runs programs of C++; see `Device`."""

    name: str
    loop: type[EnsembleLoop]  # set below: `DeviceLoop`
    arrays: Any

    def program(self, components: Mapping[str, Path]) -> "DeviceProgram":
        return DeviceProgram(self, components)

    @abstractmethod
    def kernels(self, program: str) -> Mapping[str, Kernel]:
        """Compiles a program; returns its kernels by their names."""

    @abstractmethod
    def address(self, array: Array) -> int:
        """Returns where the values of an array begin."""

    @abstractmethod
    def free_bytes(self) -> int:
        """Returns how many bytes arrays may take."""


class Gpu(CompiledDevice):
    """The GPU of this machine. EnsembleError without a GPU, MissingExtraError without CuPy."""

    name = "the GPU"

    def __init__(self) -> None:
        os.environ.setdefault("CUPY_CACHE_DIR", str(store.folder(GPU)))
        cupy: Any = require("cupy", "gpu", "runs on a GPU")
        try:
            cupy.cuda.runtime.getDeviceCount()
        except cupy.cuda.runtime.CUDARuntimeError as error:
            raise EnsembleError(f"no GPU: {error}; the processor makes the same runs") from None
        self.arrays = cupy

    def kernels(self, program: str) -> Mapping[str, Kernel]:
        module = self.arrays.RawModule(code=program, options=OPTIONS)
        try:
            return {name: self._kernel(module.get_function(f"ensemble_{name}_all")) for name in KERNELS}
        except self.arrays.cuda.compiler.CompileException as error:
            first = str(error).strip().partition("\n")[0]
            raise EnsembleError(f"FMUs do not compile for the GPU: {first}; build them again") from error

    def _kernel(self, function: Any) -> Kernel:
        def run(address: int, threads: int, first: int, last: int) -> None:
            function((-(-threads // _THREADS),), (_THREADS,), (address, threads, first, last))

        return run

    def address(self, array: Array) -> int:
        return array.data.ptr

    def free_bytes(self) -> int:
        self.arrays.get_default_memory_pool().free_all_blocks()
        return self.arrays.cuda.runtime.memGetInfo()[0]


@lru_cache(1)
def gpu() -> Gpu:
    """Returns the GPU of this machine, which is opened once; raises what `Gpu` raises."""
    return Gpu()


def runs(where: str, workers: int | None, note: Callable[[str], object]) -> LocalRuns:
    """Returns the GPU of this machine as a place of runs, in one process; raises what `gpu` raises."""
    if where != GPU or workers:
        raise EnsembleError(f"{where}{f' with {workers} workers' * bool(workers)}: expected {GPU} alone")
    return LocalRuns(1, note=note, device=gpu())


class DeviceComponent(NamedTuple):
    """A component in the memory of a system.

    first: its place; words: of eight bytes, of it and of its `Data`
    internal_step: value reference of the parameter
    wholes: how many Reals take whole numbers alone; guid: of its FMU
    """

    guid: bytes
    first: int
    words: int
    data_words: int
    internal_step: int
    wholes: int

    def values(self, state: bytes) -> np.ndarray:
        """Returns `Data` of instance.h from a serialised FMU state."""
        return data_words(state, self.guid, self.data_words + 1)[: self.data_words]


class DeviceProgram:
    """The program of a system, compiled for a device, with the functions of `loop_library`."""

    def __init__(self, device: CompiledDevice, components: Mapping[str, Path]) -> None:
        self.device = device
        self._kernels = device.kernels(program(list(components.values())))
        sizes = device.arrays.zeros((len(components), 4), dtype=np.int64)
        self._kernels["sizes"](device.address(sizes), 1, 0, 0)
        self.components, self.words = dict[str, DeviceComponent](), 0
        for (name, path), row in zip(components.items(), sizes.get().tolist(), strict=True):
            self.components[name] = DeviceComponent(describe(path).guid.encode(), self.words, *row)
            self.words += self.components[name].words

    def ensemble_exchange(self, batch: "_Batch", point: int) -> None:
        self._kernels["exchange"](batch.address, batch.threads, point, 0)

    def ensemble_run(self, batch: "_Batch", first: int, last: int) -> None:
        self._kernels["run"](batch.address, batch.threads, first, last)

    def initialise(self, batch: "_Batch", component: int) -> None:
        self._kernels["initialise"](batch.address, batch.threads, component, 0)

    def change(self, batch: "_Batch", component: int) -> None:
        self._kernels["change"](batch.address, batch.threads, component, 0)


class _Batch(NamedTuple):
    """The structure `Batch` of device_loop.h in the memory of the device, and how many instances it has."""

    address: int
    threads: int


class DeviceLoop(EnsembleLoop):
    """All instances as one group on a device, whose arrays hold the values; see `EnsembleLoop`."""

    def _allocate(self, values: Mapping[str, np.ndarray]) -> None:
        device, (points, columns), count = self._functions.device, self.prepared.shape, self._count
        self._device, arrays = device, device.arrays
        system = np.zeros(self._functions.words)
        for name, component in self.libraries.items():
            system[component.first : component.first + component.data_words] = values[name]
        self._systems = arrays.empty((count, len(system)))
        self._systems[:] = arrays.asarray(system)
        self._varied = {name: arrays.asarray(signals) for name, signals in self._varied.items()}
        self.rows = arrays.empty((1, columns, points, count))
        self.recorded = arrays.full((1, count), points, dtype=np.int64)
        self.failure = arrays.zeros((1, count), dtype=np.int64)
        self._groups = [self._group(0)]

    @staticmethod
    def words(prepared: PreparedRun, libraries: Mapping[str, Any], count: int, varied: int) -> int:
        points, columns = prepared.shape
        return count * (points * (columns + varied) + sum(library.words for library in libraries.values()))

    def _group(self, group: int) -> tuple[Any, list[Any]]:
        arrays, members = self._device.arrays, self._members(group) | {"count": self._count}
        held = [m if isinstance(m, int) else arrays.asarray(m) for m in members.values()]
        words = [m if isinstance(m, int) else self._device.address(m) for m in held]
        structure = arrays.asarray(np.array(words, np.int64))
        return _Batch(self._device.address(structure), self._count), [structure, *held]

    def _components(self, group: int) -> dict[str, Any]:
        return {"no_steps": 0, "systems": self._systems}

    def _addresses_of(self, arrays: Sequence[Array]) -> np.ndarray:
        return np.array([self._device.address(array) for array in arrays], np.int64)

    def _addresses(self, group: int, names: Sequence[str]) -> np.ndarray:
        """Returns the places of variables in the memory of a system, in words."""
        ports = [self.prepared.system.ports[name] for name in names]
        return np.array([self._word(p.component, int(p.variable.valueReference)) for p in ports], np.int64)

    def _word(self, component: str, reference: int) -> int:
        return self.libraries[component].first + FIRST_VALUE + reference

    def of_reference(self, component: str, reference: int) -> Array:
        return self._systems[None, :, self._word(component, reference)]

    def put(self, port: Any, values: Array) -> None:
        self.values(port)[:] = self._device.arrays.asarray(values)

    def signals(self, count: int) -> Array:
        signals = self.rows[0, :, :count].transpose(0, 2, 1)
        return signals if count == self.prepared.shape[0] else signals.copy()  # later steps write there

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        return self.recorded[0].get(), self.failure[0].get()

    def _initialise(self, component: str) -> None:
        self._functions.initialise(self._groups[0][0], list(self.libraries).index(component))

    def _parameters_changed(self, group: int, component: str) -> None:
        self._functions.change(self._groups[0][0], list(self.libraries).index(component))


CompiledDevice.loop = DeviceLoop


def program(fmus: Sequence[Path]) -> str:
    """Returns the program of a system of these FMUs, in C++ without other headers than C's."""
    spaces = [f"namespace c{i} {{\n{_component(path)}" for i, path in enumerate(fmus)]
    components = " ".join(f"X({i})" for i in range(len(fmus)))
    return "\n".join(
        [_file("device.h"), *spaces, f"#define COMPONENTS(X) {components}", _file("device_loop.h")]
    )


def _component(fmu: Path) -> str:
    """Returns the C layer of an FMU, to the end of its namespace, and forgets what it has defined."""
    with zipfile.ZipFile(fmu) as archive:
        names = [name for name in archive.namelist() if name.startswith("sources/") and name.endswith(".h")]
        files = {Path(name).name: archive.read(name).decode() for name in names}
    text = "\n".join([*_included(files, "instance.h", set()), _file("device_component.h"), "}"])
    macros = dict.fromkeys(re.findall(r"^ *# *define +(\w+)", text, re.MULTILINE))
    return "\n".join([text, *(f"#undef {name}" for name in macros), ""])


def _included(files: Mapping[str, str], name: str, known: set[str]) -> Iterator[str]:
    """Yields the lines of a file, with included files in place of their includes; each file once."""
    known.add(name)
    for line in files[name].splitlines():
        match = re.match(r'#include [<"](.+)[>"]', line)
        if not match:
            yield line
        elif match[1] in files and match[1] not in known:
            yield from _included(files, match[1], known)


def _file(name: str) -> str:
    return (resources.files("orchestration.places") / name).read_text("utf-8")
