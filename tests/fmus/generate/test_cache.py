"""An FMU that is stamped is of the present sources: whatever changes, it is built again."""

import os
import py_compile
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest

import fmus
from fmus import store
from fmus.block.block_file import blocks_in, write_new_block
from fmus.generate import builder
from fmus.generate.cache import BuildCache, BuildRequest, Sources
from fmus.platforms import PLATFORMS
from fmus.registry import Flavour, block_names

LATER = time.time() + 1e6  # so that files of a test count as older than the process
BLOCK = """\
from dataclasses import dataclass
from gains import GAIN
from fmus.block import Block, variable

@dataclass(frozen=True)
class Parameters:
    gain: float = variable(1.0, "Gain")

@dataclass(frozen=True)
class State:
    x: float = 0.0

@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")

def step(t, h, s, u, p, c):
    return State(s.x + h * GAIN * p.gain)


LAG = Block.of_module(__name__, "Lag", "A lag", output=lambda t, s, p, c: Outputs(s.x))
"""

PACKAGE = {  # what stands for the files of `fmus`
    "native/fmi2.c": '#include "instance.h"\n',
    "export/operations.py": '"""Operations."""\n',
    "documentation/page.html": "<html></html>\n",
    "numerics/__init__.py": "",
}

Change = Callable[[Path], object]


@pytest.fixture
def order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BuildRequest:
    """A block in a file beside a module that it imports, and what stands for its FMU, stamped."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    package = {f"package/{name}": text for name, text in PACKAGE.items()}
    for name, text in {"lag.py": BLOCK, "gains.py": "GAIN = 2.0\n", **package}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    order = BuildRequest(str(tmp_path / "lag.py"), tmp_path / "built")
    (tmp_path / "built").mkdir()
    stamp(order)
    return order


def stamps(order: BuildRequest, begun: float = LATER) -> BuildCache:
    """Those of a process that began then."""
    return BuildCache(order.folder.parent / "package", begun)


def sources_of(order: BuildRequest) -> Sources:
    sources = stamps(order).sources(order)
    assert sources
    return sources


def stamp(order: BuildRequest) -> None:
    sources = sources_of(order)
    with blocks_in(Path(order.source)):
        fmu = order.folder / "Lag.fmu"
        fmu.write_bytes(b"what was built")
        stamps(order).write(sources.if_loaded, {fmu.name: fmu.read_bytes()})


def current(order: BuildRequest) -> list[Path] | None:
    return stamps(order).current(order)


def test_an_fmu_of_unchanged_sources_is_current(order: BuildRequest, tmp_path: Path) -> None:
    assert current(order) == [tmp_path / "built" / "Lag.fmu"]
    assert current(BuildRequest(order.source, tmp_path / "elsewhere")) is None


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        ("lag.py", "s.x + h", "s.x - h"),
        ("lag.py", "variable(1.0", "variable(1.5"),
        ("gains.py", "2.0", "2.5"),
        ("package/native/fmi2.c", "#include", "/* another */\n#include"),
        ("package/export/operations.py", '"""', '"""Changed. '),
        ("package/documentation/page.html", "<html", "<html "),
        ("built/Lag.fmu", "built", "built by another"),
    ],
    ids=["function", "default", "helper", "C layer", "exporter", "documentation", "the FMU itself"],
)
def test_a_changed_file_makes_it_stale(
    order: BuildRequest, tmp_path: Path, file: str, before: str, after: str
) -> None:
    path = tmp_path / file
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))
    assert current(order) is None
    path.write_text(text)
    assert current(order)


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "package" / "native" / "more.h").write_text(""),
        lambda folder: (folder / "gains.py").unlink(),
        lambda folder: shutil.copytree(folder / "package" / "numerics", folder / "gains"),
        lambda folder: (folder / "built" / "Lag.fmu").unlink(),
    ],
    ids=["a new file of the C layer", "a missing helper", "a package before the helper", "no FMU"],
)
def test_a_file_that_comes_or_goes_makes_it_stale(
    order: BuildRequest, tmp_path: Path, change: Change
) -> None:
    change(tmp_path)
    assert current(order) is None


def test_other_options_make_it_stale(order: BuildRequest) -> None:
    of_platforms = [{"platforms": PLATFORMS}, {"platforms": ("win64",)}]
    others = {
        "flavour": Flavour.PYTHON,
        "with_terminals": True,
        "reals_only": True,
        "fmi": 3,
        "scalars": True,
    }
    for options in (*of_platforms, *({name: value} for name, value in others.items())):
        assert current(BuildRequest(order.source, order.folder, **options)) is None, options


@pytest.mark.parametrize("library", ["casadi", "ziglang", "l1-depth"])
def test_another_version_of_a_library_makes_it_stale(
    order: BuildRequest, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = type(distribution(library))  # Dask brings a class of its own with importlib_metadata
    read_text = kind.read_text

    def updated(installed: Distribution, file: str) -> str | None:
        text = read_text(installed, file)
        is_meant = text and f"\nName: {library}\n" in text
        return text.replace("\nVersion: ", "\nVersion: 1") if text and is_meant else text

    monkeypatch.setattr(kind, "read_text", updated)
    assert current(order) is None


@pytest.mark.slow
def test_python_without_assertions_and_docstrings_makes_it_stale(order: BuildRequest, tmp_path: Path) -> None:
    """A block may depend on `__debug__`, and its description on a docstring."""
    code = """
import sys
from pathlib import Path
from fmus.generate.cache import BuildCache, BuildRequest, Sources
folder = Path(sys.argv[1])
order = BuildRequest(str(folder / "lag.py"), folder / "built")
print(BuildCache(folder / "package").current(order) is not None)
"""

    def is_current(*options: str) -> str:
        command = [sys.executable, *options, "-c", code, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    assert [is_current(), is_current("-O"), is_current("-OO")] == ["True", "False", "False"]


def test_another_date_makes_it_stale(order: BuildRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    assert current(order) is None


@pytest.mark.parametrize(
    "line",
    [
        "import json",
        "import numpy as np",
        "from pathlib import Path",
        "from gains import *",
        "TEXT = open(__file__).read()",
        "import not_there",
        "from fmus import compliance",
        "import fmus.files",
        "from contextlib import os",
        "import dataclasses; dataclasses.sys",
        "from collections import _sys",
        "import collections.abc",
        "from typing import get_type_hints",
        "from fmus.block import math",
        "from fmus.numerics import symbols",
        "from fmus import numerics; numerics.symbols.sys",
        "import fmus.numerics",
        "from lag import __builtins__",
        "globals()['__builtins__']",
        "vars()['__builtins__']",
        "getattr(GAIN, 'real')",
        "(lambda: 0).__globals__",
        "(x for x in ()).gi_frame",
        "'{0.gi_frame}'.format(x for x in ())",
        "match GAIN:\n        case object(__class__=kind): pass",
        "list({'a', 'b'})",
        "list({text for text in ('a', 'b')})",
        "list(frozenset(('a', 'b')))",
        "list({'a': 1}.keys() | {'b': 1}.keys())",
        "hash('a')",
        "id(GAIN)",
    ],
)
def test_a_block_that_may_depend_on_more_than_its_sources_gets_no_stamp(
    order: BuildRequest, tmp_path: Path, line: str
) -> None:
    """Even where a module imports it that the block imports."""
    (tmp_path / "gains.py").write_text(
        f"GAIN = 2.0\nif GAIN > 3.0:\n    {line}\n" if "*" not in line else line
    )
    assert stamps(order).sources(order) is None


@pytest.mark.parametrize(
    "line",
    [
        "import math; math.pi",
        "from fmus import numerics; numerics.sqrt(2.0)",
        "from dataclasses import replace",
        "from collections.abc import Callable",
        "TABLE = {'a': 1.0}; list(TABLE.values())",
        "raise ValueError(f'{GAIN}')",
    ],
)
def test_a_block_of_names_that_lead_to_nothing_else_gets_a_stamp(
    order: BuildRequest, tmp_path: Path, line: str
) -> None:
    (tmp_path / "gains.py").write_text(f"GAIN = 2.0\nif GAIN > 3.0:\n    {line}\n")
    assert sources_of(order)


@pytest.mark.parametrize("name", block_names())
def test_every_installed_block_gets_a_stamp(name: str, tmp_path: Path) -> None:
    assert BuildCache().sources(BuildRequest(name, tmp_path))


def test_a_block_that_l1_depth_new_writes_gets_a_stamp(tmp_path: Path) -> None:
    (path, _) = write_new_block("depth_pid", tmp_path)
    assert BuildCache().sources(BuildRequest(str(path), tmp_path))


def test_sources_that_may_have_changed_since_they_were_loaded_give_no_stamp(
    order: BuildRequest, tmp_path: Path
) -> None:
    fmu = tmp_path / "built" / "Lag.fmu"
    sources = sources_of(order)
    fmu.write_bytes(b"another")
    built = {fmu.name: b"another"}
    stamps(order, sources.changed).write(sources, built)  # changed as the process began
    assert current(order) is None
    (tmp_path / "gains.py").write_text("GAIN = 2.5\n")
    stamps(order).write(sources, built)  # changed while it was built
    assert current(order) is None
    stamps(order).write(sources_of(order), built)
    assert current(order)


def test_a_module_that_appears_where_an_import_failed_makes_it_stale(
    order: BuildRequest, tmp_path: Path
) -> None:
    """Also where it hides one of the standard library."""
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "__init__.py").write_text(
        "from enum import Enum\ntry:\n    from . import fast\nexcept ImportError:\n    fast = None\n"
    )
    (tmp_path / "gains.py").write_text("import tools\nGAIN = 3.0 if tools.fast else 2.0\n")
    stamp(order)
    assert current(order)
    for name in ("tools/fast.py", "enum.py"):
        (tmp_path / name).write_text("")
        assert current(order) is None
        (tmp_path / name).unlink()
        assert current(order)


@pytest.mark.parametrize("folder", [".", "on_the_path"])
def test_a_helper_named_like_a_module_of_python_is_a_source(
    order: BuildRequest, tmp_path: Path, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside the block, or in a folder of PYTHONPATH, which comes before the standard library."""
    helper = tmp_path / folder / "statistics.py"
    helper.parent.mkdir(exist_ok=True)
    helper.write_text("GAIN = 2.0\n")
    (tmp_path / "gains.py").write_text("from statistics import GAIN\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "on_the_path"), *sys.path])
    sources = sources_of(order)
    assert sources.modules["statistics"][0] == str(helper)


@pytest.mark.parametrize(
    ("file", "expected"),
    [("lag.py", (1.5, 2.0, 1.0)), ("gains.py", (1.0, 2.5, 1.0)), ("tools/__init__.py", (1.0, 2.0, 1.5))],
)
def test_a_changed_source_of_the_same_size_and_second_is_what_is_imported(
    order: BuildRequest, tmp_path: Path, file: str, expected: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python takes the compiled file of the older one for it."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "__init__.py").write_text("TOOL = 1.0\n")
    (tmp_path / "gains.py").write_text("from tools import TOOL\nGAIN = 2.0\n")
    source = tmp_path / file
    os.utime(source, (1e9, 1e9))
    py_compile.compile(str(source))  # as an import elsewhere does
    before = source.read_text()
    source.write_text(before.replace("1.0", "1.5", 1).replace("2.0", "2.5", 1))
    assert len(before) == len(source.read_text())
    os.utime(source, (1e9, 1e9))
    with blocks_in(Path(order.source)) as (block,):
        values = block.parameters().gain, sys.modules["gains"].GAIN, sys.modules["tools"].TOOL
    assert values == expected
    stamp(order)
    assert current(order)


def test_modules_that_were_imported_before_this_package_give_no_stamp(
    order: BuildRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When their files were read is not known."""
    sources = sources_of(order)
    monkeypatch.setattr(fmus, "IMPORTED_BEFORE", frozenset({"gains"}))
    with blocks_in(Path(order.source)):
        assert sources.if_loaded is None


def test_an_fmu_that_another_process_wrote_meanwhile_is_not_current(
    order: BuildRequest, tmp_path: Path
) -> None:
    sources = stamps(order).sources(order)
    (tmp_path / "built" / "Lag.fmu").write_bytes(b"of the other")
    stamps(order).write(sources, {"Lag.fmu": b"of this one"})
    assert current(order) is None


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Builds into a cache of the test's own, in which files of the test count as older than the process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(builder, "BuildCache", partial(BuildCache, begun=LATER))


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_an_fmu_that_was_found_and_not_built_is_stamped_for_runs_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its GUID tells neither its icon nor whether it has terminals, with which `build --cache` wrote it."""
    with monkeypatch.context() as older_sources:
        older_sources.setattr(builder, "icon", lambda block: b"an older icon")
        path = builder.build_block("ExamplePlant", tmp_path / "built", with_terminals=True)
    older = path.read_bytes()
    order = BuildRequest("ExamplePlant", tmp_path / "built")
    assert BuildCache().current(order, to_run=True) is None
    assert builder.build_if_stale("ExamplePlant", tmp_path / "built").read_bytes() == older
    assert BuildCache().current(order, to_run=True) == [path]
    assert BuildCache().current(order) is None
    path.unlink()
    builder.build_if_stale("ExamplePlant", tmp_path / "built")
    assert BuildCache().current(order) == [path]
    assert path.read_bytes() != older


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_an_fmu_without_a_record_of_its_build_is_built_again_where_it_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would run like one of another tool, as one does in a folder of the administrator's."""
    fmu = builder.build_block("ExamplePlant", tmp_path / "built").read_bytes()
    shutil.rmtree(store.folder(store.BUILDS))
    with monkeypatch.context() as of_another_user:
        of_another_user.setattr(os, "access", lambda path, mode: False)
        builder.build_if_stale("ExamplePlant", tmp_path / "built")
    assert not store.is_own_build(fmu)
    shutil.rmtree(store.folder(store.BUILDS))
    builder.build_if_stale("ExamplePlant", tmp_path / "built")
    assert store.is_own_build(fmu)


def test_modules_that_were_loaded_from_another_file_or_text_are_not_the_sources(
    order: BuildRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = sources_of(order)
    assert sources.if_loaded is None
    with blocks_in(Path(order.source)):
        assert sources.if_loaded is sources
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr(sys.modules["gains"], "__file__", str(tmp_path / "elsewhere" / "gains.py"))
            assert sources.if_loaded is None
        (tmp_path / "gains.py").write_text("GAIN = 2.5\n")
        assert sources.if_loaded is sources  # and `write` finds that they have changed
        later = sources_of(order)
        assert later.if_loaded is None


def test_a_damaged_stamp_is_none(order: BuildRequest, tmp_path: Path) -> None:
    (file,) = (tmp_path / "cache").rglob("builds/*")
    content = file.read_bytes()
    for damaged in (b"", b"{}", content[:-1], content[1:], content.replace(b"gains", b"pains", 1)):
        file.write_bytes(damaged)
        assert current(order) is None
    file.write_bytes(content)
    assert current(order)


@pytest.mark.slow
def test_a_second_build_builds_nothing_and_loads_no_exporter(tmp_path: Path) -> None:
    """Of an installed block, with the command line itself."""
    code = """
import sys
from orchestration.cli.commands import run_command
run_command(["build", "DepthReference", "ExamplePlant", "--out", "out"])
print({"casadi", "numpy", "fmus.generate.builder"} & set(sys.modules))
"""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}

    def build() -> tuple[list[str], dict[str, tuple[int, int]]]:
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        files = {path.name: path.stat() for path in (tmp_path / "out").iterdir()}
        return done.stdout.splitlines(), {name: (s.st_ino, s.st_mtime_ns) for name, s in files.items()}

    built, again = build(), build()
    assert built[0][:2] == again[0][:2] == ["out/DepthReference.fmu", "out/ExamplePlant.fmu"]
    assert built[1] == again[1]
    assert again[0][2] == "set()"
    assert "casadi" in built[0][2]
