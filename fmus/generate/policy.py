"""FILE.py:Class -> FMU of the python flavour that runs a policy class, in the user's cache.

The FMU carries the file, the modules beside it that it imports, and the files beside it that a text in them
names, such as "weights.npz". Other libraries must be installed where the FMU runs. A separate process makes
the FMU, again if any of these files has changed, and runs two objects of the class.
"""

import ast
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Mapping
from contextlib import closing, suppress
from hashlib import sha256
from importlib import import_module
from importlib.metadata import version
from inspect import getclosurevars
from math import inf, sin
from pathlib import Path
from time import perf_counter
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

import fmus
from fmus import store
from fmus.block.block_file import check_file
from fmus.block.policy import PolicyInstance, line_below
from fmus.errors import ExportError, nearest
from fmus.files import packed
from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from fmus.generate.python import entry_point, in_package, package_of, source_closure, sources_beside
from fmus.guid import GUID
from fmus.registry import Flavour, fmu_folder, unwritable

_NAMED = re.compile(r"(.+\.py):([^:/\\]*)", re.DOTALL)
_SLAVE = "fmus.block.policy_slave"
# for the imports of a policy and its first steps
_PATIENCE_S = 120
# of the first object: a build should not wait for a slow policy
_MOST_SAMPLES, _MOST_S = 20, 0.5
_HELD = {FunctionType: "default values of arguments, closure or attributes of "}
# threads may add numbers in another order
_EQUAL = {"rtol": 1e-9, "atol": 1e-12, "equal_nan": True}


def fmu_of_class(name: str, folder: Path = Path()) -> Path:
    """Returns the FMU of the class that FILE.py:Class names; makes it if the files have changed.

    folder: the folder that the file is relative to
    Raises ExportError for a file or a class that cannot become an FMU.
    """
    found = _NAMED.fullmatch(name)
    if not found or not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", found[2]):
        raise ExportError(
            f"{name}: expected FILE.py:Class, with a class of ASCII letters, digits and single _"
        )
    file, cls = (folder / found[1]).absolute(), found[2]
    check_file(file)
    sources = sources_beside(file)
    carried = _named_files(sources, file.parent)
    own = [(path, content) for path, content, _ in store.digests(Path(fmus.__file__).parent)]
    parts = str(file), cls, sources, carried, own, version("l1-depth"), version("pythonfmu"), sys.version
    key = store.digest(*parts)
    path = fmu_folder(Flavour.PYTHON) / store.digest(str(file).encode())[:12] / f"{cls}.fmu"
    store.keep_fmus()
    if path.is_file() and store.get(store.BUILDS, key) == store.digest(path.read_bytes()).encode():
        return path
    content = _made(file, cls, sources, carried)
    try:
        store.write(path, content)
    except OSError as error:
        raise unwritable(path.parent, error) from error
    store.put(store.BUILDS, key, store.digest(content).encode())
    return path


def _named_files(sources: Mapping[str, str], folder: Path) -> dict[str, bytes]:
    """Returns path -> content of the files of a folder that a text in the sources names, but for modules."""
    nodes = (node for source in sources.values() for node in ast.walk(ast.parse(source)))
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    files: dict[str, bytes] = {}
    for text in sorted(texts):
        is_name = text and "\0" not in text and len(text) < 256 and not text.endswith(".py")
        path = folder / text
        if is_name and path.is_file() and path.resolve().is_relative_to(folder.resolve()):
            files[path.relative_to(folder).as_posix()] = path.read_bytes()
    return files


def _made(file: Path, cls: str, sources: Mapping[str, str], carried: Mapping[str, bytes]) -> bytes:
    """Returns the FMU of a class, which a separate process makes; ExportError if it cannot."""
    # The user's code may end, block or change its process.
    with closing(WorkerProcess(_worker)) as process:
        process.send((file, cls, dict(sources), dict(carried)))
        try:
            content, reason = process.receive(_PATIENCE_S)
        except TimeoutError:
            reason = (
                f"{file}: {cls} took no step within {_PATIENCE_S} s: expected imports and a step that end"
            )
            raise ExportError(reason) from None
        except ProcessEndedError as error:
            raise ExportError(f"{file}: {cls} ended Python: {error}: {error.last_error_line}") from error
    if reason:
        raise ExportError(reason)
    return content


def _worker(parent: Parent) -> None:
    """Makes an FMU; sends it, or the reason of a failure."""
    file, cls, sources, carried = parent.receive()
    try:
        parent.send((_fmu(file, cls, sources, carried), ""))
    except ExportError as error:
        parent.send((b"", str(error)))


def _fmu(file: Path, cls: str, sources: dict[str, str], carried: dict[str, bytes]) -> bytes:
    # CasADi, which these load, takes time: a process that finds the FMU in the cache does without.
    from fmus.generate.archive import OF_PYTHON, with_resources
    from fmus.generate.describe import model_description

    package = package_of(cls)
    own = source_closure(_SLAVE)
    # a module of the user's that hides one of Python's hides it from the user's modules alone
    text = in_package(own | sources, package) | in_package(own, package)
    imports, member = [f"from {package}.{_SLAVE} import PolicySlave"], f'module = "{package}.{file.stem}"'
    text |= entry_point(cls, "PolicySlave", imports, member)
    files = {path: source.encode() for path, source in text.items()}
    files |= {f"{package}/{path}": content for path, content in carried.items()}
    block, can_save = _tried(file, cls, files, package)
    known = [v.value_reference for v in block.variables if v.settable]
    outputs = {v.value_reference: known for v in block.of_causality("output")}
    state = {"canGetAndSetFMUstate": str(can_save).lower(), "canSerializeFMUstate": "false"}
    _, members = with_resources(block, files, model_description(block, GUID, OF_PYTHON | state, outputs))
    return packed(members)


def _tried(file: Path, cls: str, files: Mapping[str, bytes], package: str) -> tuple[Any, bool]:
    """Returns the variables of a class as a block, and whether its state can be saved, after short runs."""
    folder = Path(tempfile.mkdtemp())  # which goes with this process
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    sys.path.insert(0, str(folder))
    # the copy that the FMU carries: it is tried as it will run
    run = import_module(f"{package}.{PolicyInstance.__module__}")
    modules = run.OwnModules(package, folder / package)
    try:
        with modules.present():
            module = import_module(f"{package}.{file.stem}")
    except (Exception, SystemExit) as error:
        where = file.parent / (line_below(error, folder / package) or file.name)
        raise ExportError(f"{where}: {type(error).__name__}: {error}{_hint(error)}") from error
    if cls not in vars(module):
        classes = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise ExportError(f"{file}: no class {cls!r}; {nearest(cls, classes)}")
    try:
        block = run.policy_block(vars(module)[cls], modules)
        return block, check_repeats(run, block)
    except Exception as error:
        raise ExportError(f"{file}: {error}{_hint(error.__cause__)}") from error


def check_repeats(policies: ModuleType, block: Any) -> bool:
    """Returns whether the state of a policy can be saved, after runs of two objects.

    policies: the copy of `fmus.block.policy` in the FMU
    block: of a class whose modules are newly imported
    Raises ExportError if the second object has other outputs, and errors of the policy at the start.
    """
    before, saved = _memory(block), None
    trial, end = _begun(policies, block), perf_counter() + _MOST_S
    # the first step may import further modules
    before = _memory(block) | before
    with suppress(Exception):
        saved = trial.snapshot()
    first = _outputs(trial, block, _MOST_SAMPLES, end)
    second = _outputs(_begun(policies, block), block, len(first))
    changed = [name for name, content in _memory(block).items() if content != before.get(name)]
    for k, i in np.argwhere(~np.isclose(first, second, **_EQUAL)):
        expected = "random numbers that reset seeds, self.random = numpy.random.default_rng(1), no clock, "
        expected += "and nothing that a file or another library keeps from one run to the next"
        if changed:
            expected = f"in self what reset sets and a run changes, not in {', '.join(changed)}"
        output, at = block.of_causality("output")[i].name, k * block.step_size
        raise ExportError(
            f"{block.name}: two objects, one run after the other on equal inputs, have {first[k, i]:.9g} and "
            f"{second[k, i]:.9g} as {output} at t = {at:.9g} s; expected {expected}"
        )
    if changed or not saved:
        return False
    trial.restore(saved)
    return np.allclose(first, _outputs(trial, block, len(first)), **_EQUAL)


def _begun(policies: ModuleType, block: Any) -> Any:
    """Returns an instance after one step at the start values."""
    trial = policies.PolicyInstance(block)
    trial.start(0.0)
    trial.exit_initialization_mode()
    trial.do_step(0.0, block.step_size)
    return trial


def _outputs(trial: Any, block: Any, count: int, end: float = inf) -> np.ndarray:
    """Returns the outputs of `count` samples, the last one and more: shape (samples, outputs).

    end: the time of `perf_counter` after which no step is begun
    """
    # Outputs stay NaN from a failed step on: the policy may not expect these inputs.
    outputs = block.of_causality("output")
    values = np.full((count, len(outputs)), np.nan)
    for k in range(count):
        values[k] = [trial.get(v.value_reference) for v in outputs]
        if perf_counter() > end:
            return values[: k + 1]
        for i, v in enumerate(block.of_causality("input")):
            trial.set(v.value_reference, 0.5 * sin(0.3 * k + i))
        try:
            trial.do_step(trial.time, block.step_size)
        except Exception:
            break
    return values


def _memory(block: Any) -> dict[str, Any]:
    """Returns module.name and Class.name -> a digest of the value, for all values outside of objects."""
    memory = {}
    with block.modules.present():
        for module in block.modules.loaded():
            known = [value for value in vars(module).values() if isinstance(value, type)]
            for holder in (module, *(cls for cls in known if cls.__module__ == module.__name__)):
                own = [item for item in vars(holder).items() if not item[0].startswith("__")]
                label = holder.__name__.rpartition(".")[2]
                memory |= {f"{_HELD.get(type(x), '')}{label}.{name}": _digest(x) for name, x in own}
    return memory | {"os.environ": _digest(dict(os.environ))}


def _digest(value: Any) -> Any:
    try:
        if isinstance(value, FunctionType):
            value = value.__defaults__, value.__kwdefaults__, vars(value), getclosurevars(value).nonlocals
        return sha256(pickle.dumps(value)).digest()
    except Exception:
        return repr(value)


def _hint(error: BaseException | None) -> str:
    if isinstance(error, ImportError) and "pythonfmu" in str(error):
        return "; pythonfmu build -f FILE.py makes an FMU of a class of PythonFMU"
    if not isinstance(error, FileNotFoundError):
        return ""
    return "; expected one beside the file, whose name stands in the code: 'weights.npz'"
