"""FILE.py:Class -> FMU of the python flavour that runs a policy class, in the user's cache.

The FMU carries the file, the modules beside it that it imports, and the files beside it that a text in them
names, such as "weights.npz". Other libraries are those that are installed where it runs. It is made anew if
any of these files has changed, in a process of its own, which takes one step at the start values.
"""

import ast
import re
import sys
import tempfile
from collections.abc import Mapping
from contextlib import closing
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import fmus
from fmus import store
from fmus.block.block_file import check_file
from fmus.block.policy import PolicyInstance, line_below
from fmus.build.sources import in_package, source_closure, sources_beside
from fmus.errors import ExportError, nearest
from fmus.files import packed
from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from fmus.registry import Flavour, fmu_folder, unwritable

_NAMED = re.compile(r"(.+\.py):([^:/\\]*)", re.DOTALL)
_SLAVE = "fmus.build.policy_slave"
_PATIENCE_S = 120  # for the imports of a policy and its first step


def fmu_of_class(name: str, folder: Path = Path()) -> Path:
    """Returns the FMU of the class that FILE.py:Class names, made if that of the present files is missing.

    folder: that the file is relative to
    Raises ExportError for a file or a class of which none can be made.
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
    """Returns the FMU of a class, made in a process of its own; ExportError if that cannot make it."""
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
    """Makes an FMU; sends it, or why it cannot be made."""
    file, cls, sources, carried = parent.receive()
    try:
        parent.send((_fmu(file, cls, sources, carried), ""))
    except ExportError as error:
        parent.send((b"", str(error)))


def _fmu(file: Path, cls: str, sources: dict[str, str], carried: dict[str, bytes]) -> bytes:
    from fmus.build import python as python_flavour  # these load what builds FMUs
    from fmus.build.model_description import model_description
    from fmus.guid import GUID, with_guid

    package = python_flavour.package_of(cls)
    own = source_closure(_SLAVE)
    # a module of the user's that hides one of Python's hides it from the user's modules alone
    text = in_package(own | sources, package) | in_package(own, package)
    imports, member = [f"from {package}.{_SLAVE} import PolicySlave"], f'module = "{package}.{file.stem}"'
    text |= python_flavour.entry_point(cls, "PolicySlave", imports, member)
    files = {path: source.encode() for path, source in text.items()}
    files |= {f"{package}/{path}": content for path, content in carried.items()}
    block, can_save = _tried(file, cls, files, package)
    known = [v.value_reference for v in block.variables if v.settable]
    outputs = {v.value_reference: known for v in block.of_causality("output")}
    state = {"canGetAndSetFMUstate": str(can_save).lower(), "canSerializeFMUstate": "false"}
    capabilities = python_flavour.CAPABILITIES | state
    description = model_description(block, GUID, capabilities, dependencies=outputs)
    _, members = with_guid(python_flavour.archive(block, files, description))
    return packed(members)


def _tried(file: Path, cls: str, files: Mapping[str, bytes], package: str) -> tuple[Any, bool]:
    """Returns the variables of a class as a block, and whether its state can be copied, after one step."""
    folder = Path(tempfile.mkdtemp())  # which goes with this process
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    sys.path.insert(0, str(folder))
    try:
        module = import_module(f"{package}.{file.stem}")
    except (Exception, SystemExit) as error:
        where = file.parent / (line_below(error, folder / package) or file.name)
        raise ExportError(f"{where}: {type(error).__name__}: {error}{_hint(error)}") from error
    if cls not in vars(module):
        classes = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise ExportError(f"{file}: no class {cls!r}; {nearest(cls, classes)}")
    run = import_module(f"{package}.{PolicyInstance.__module__}")  # what the FMU carries of it
    try:
        block = run.policy_block(vars(module)[cls])
        trial = run.PolicyInstance(block)
        trial.start(0.0)
        trial.exit_initialization_mode()
        trial.do_step(0.0, block.step_size)
    except Exception as error:
        raise ExportError(f"{file}: {error}{_hint(error.__cause__)}") from error
    try:
        trial.restore(trial.snapshot())
    except Exception:
        return block, False
    return block, True


def _hint(error: BaseException | None) -> str:
    if not isinstance(error, FileNotFoundError):
        return ""
    return "; expected one beside the file, whose name stands in the code: 'weights.npz'"
