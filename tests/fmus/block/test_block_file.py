"""The blocks of a Python file: found, built in both flavours, and each mistake named with its line."""

import ast
import gc
import importlib
import re
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from fmus.block.block_file import blocks_in, write_new_block
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.cache import BuildRequest
from fmus.generate.python import source_closure
from fmus.generate.trace import trace
from fmus.generate.verify import check_trace
from fmus.registry import Flavour

LOWPASS = """\
from dataclasses import dataclass
{imports}
from fmus.block import Block, variable


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.0, "Input")


@dataclass(frozen=True)
class State:
    x: float = 0.0


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")


def step(t, h, s, u, p, c):
    return State(s.x + h * ({expression} - s.x))


{definitions}
"""
BLOCK = """\
{name} = Block(
    "{name}", "A low-pass filter", inputs=Inputs, state=State, outputs=Outputs,
    step=step, output=lambda t, s, p, c: Outputs(s.x),
)
"""


def write(folder: Path, imports: str = "", expression: str = "u.u", names: str = "Lowpass") -> Path:
    definitions = "".join(BLOCK.format(name=name) for name in names.split())
    path = folder / "lowpass.py"
    path.write_text(LOWPASS.format(imports=imports, expression=expression, definitions=definitions))
    return path


def test_every_block_that_a_file_defines_is_found(tmp_path: Path) -> None:
    path = write(tmp_path, "from plant_fmu.example_plant import BLOCK", names="First Second")
    with blocks_in(path) as blocks:
        assert [block.name for block in blocks] == ["First", "Second"]


@pytest.mark.slow
def test_the_python_flavour_carries_what_lies_beside_the_file(tmp_path: Path) -> None:
    """However it is imported; the module of the FMU is imported where nothing else of it can be found."""
    (tmp_path / "folder").mkdir()
    for name in ("gains.py", "folder/more.py"):
        (tmp_path / name).write_text("GAIN = 2.0\n")
    imports = (
        "from gains import GAIN\nimport gains\nimport gains as g  # beside\n"
        "from folder.more import GAIN as H\nfrom folder import more\nimport folder.more as m"
    )
    path = write(tmp_path, imports, "(GAIN + gains.GAIN + g.GAIN + H + more.GAIN + m.GAIN) * u.u")
    with builder.loaded(str(path)) as (traced,):
        fmu = builder.build_block(traced.block, tmp_path / "out", Flavour.PYTHON)
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(tmp_path / "unpacked")
    (entry,) = (tmp_path / "unpacked" / "resources").glob("lowpass_*.py")
    code = (
        f"from {entry.stem} import Lowpass; block = Lowpass.block\n"
        "print(block.step(0.0, 0.5, block.state(), block.inputs(3.0), None, None).x)\n"
    )
    command = [sys.executable, "-c", code]
    assert subprocess.check_output(command, cwd=entry.parent, env={}, text=True) == "18.0\n"


def test_the_python_flavour_refuses_what_reads_a_file_as_it_is_imported(tmp_path: Path) -> None:
    """An FMU of it does not carry the file; compiled code holds the number."""
    (tmp_path / "gain.txt").write_text("0.25")
    read = 'GAIN = float(open(__file__.replace("lowpass.py", "gain.txt")).read())'
    refusal = pytest.raises(ExportError, match="carries Python modules alone")
    with builder.loaded(str(write(tmp_path, read, "GAIN * u.u"))) as (traced,), refusal:
        builder.build_block(traced.block, tmp_path / "out", Flavour.PYTHON)
    assert not (tmp_path / "out").exists()


def test_a_changed_file_is_read_again_and_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "gains.py").write_text("GAIN = 2.0\n")
    path = write(tmp_path, "from gains import GAIN", "GAIN * u.u")
    before, paths = set(sys.modules), list(sys.path)
    for gain in ("2.0", "-3.25"):
        (tmp_path / "gains.py").write_text(f"GAIN = {gain}\n")
        with blocks_in(path) as (block,):
            assert block.step(0.0, 1.0, block.state(), block.inputs(1.0), None, None).x == float(gain)
    assert not {"lowpass", "gains"} & (set(sys.modules) - before)
    assert sys.path == paths


@pytest.mark.parametrize(
    ("helper", "message"),
    [
        (
            "def gain():\n    import time; return 1e-9 * time.monotonic()\n",
            "monotonic gives another value at",
        ),
        ("def gain():\n    import random; return random.gauss(1, 2)\n", "gives another value at each call"),
        (
            "def gain():\n    global COUNT\n    COUNT = 1\n    return 1e-15 * COUNT\n",
            "the global COUNT is assigned",
        ),
    ],
    ids=["clock", "random number", "global counter"],
)
def test_a_module_beside_the_block_may_change_no_more_than_the_block(
    tmp_path: Path, helper: str, message: str
) -> None:
    """Each value is so small, or so slow, that a comparison of two tracings need not see it."""
    (tmp_path / "helper.py").write_text(helper)
    path = write(tmp_path, "from helper import gain", "(1.0 + gain()) * u.u")
    with blocks_in(path) as (block,), pytest.raises(ExportError, match=rf"helper\.py:\d+: .*{message}"):
        check_trace(trace(block))


def test_a_clock_that_is_read_once_at_an_import_is_a_constant(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("import random\nimport time\nGAIN = time.time() + random.random()\n")
    path = write(tmp_path, expression="__import__('helper').GAIN * u.u")
    with blocks_in(path) as (block,):
        check_trace(trace(block))


@pytest.mark.slow
def test_what_an_installed_library_remembers_and_times_is_not_the_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a library does that counts its calls, or what the garbage collector calls it for."""
    library = tmp_path / "lib" / "site-packages" / "a_library.py"
    library.parent.mkdir(parents=True)
    library.write_text(
        "import gc, time\nCALLS = STARTED = 0\n\n"
        "def watch(phase, info):\n    global STARTED\n    STARTED = time.time()\n\n"
        "def twice(x):\n    global CALLS\n    CALLS += 1\n    CALLS > 1 or gc.collect()\n    return 2.0 * x\n"
    )
    monkeypatch.syspath_prepend(library.parent)
    a_library = importlib.import_module("a_library")
    gc.callbacks.append(a_library.watch)
    try:
        with blocks_in(write(tmp_path, "from a_library import twice", "twice(u.u)")) as (block,):
            check_trace(trace(block))
    finally:
        gc.callbacks.remove(a_library.watch)
        del sys.modules["a_library"]
    assert a_library.STARTED > 0
    assert a_library.CALLS > 1


@pytest.mark.parametrize(
    ("imports", "message"),
    [
        ("import no_such_module", r"lowpass\.py:2: ModuleNotFoundError: No module named 'no_such_module'"),
        ("from broken import x", r"broken\.py:2: ZeroDivisionError"),
        ("def f(:", r"lowpass\.py:2: SyntaxError"),
        ("from .broken import x", r"lowpass\.py:2: ImportError: .*; import it without dots, or name the"),
        ("raise SystemExit(3)", r"lowpass\.py:2: SystemExit: 3"),
    ],
)
def test_a_file_that_cannot_be_imported_is_named_with_the_line(
    imports: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "broken.py").write_text("\nx = 1 / 0\n")
    with pytest.raises(ExportError, match=message), blocks_in(write(tmp_path, imports)):
        pass


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("", r"lowpass\.py: no block at the top level of the file; expected BLOCK = Block\("),
        ("Same Other", r"lowpass\.py: two blocks named 'Same': expected names that differ"),
        ("Case CASE", r"lowpass\.py: two blocks named 'Case': expected names that differ, in upper case too"),
    ],
)
def test_a_file_has_blocks_of_different_names(names: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, names=names)
    path.write_text(path.read_text().replace('"Other"', '"Same"'))
    with pytest.raises(ExportError, match=message), blocks_in(path):
        pass


def test_a_class_of_pythonfmu_is_named_with_the_command_that_makes_its_fmu(tmp_path: Path) -> None:
    path = tmp_path / "mpc_slave.py"
    path.write_text("from pythonfmu import Fmi2Slave\nclass MpcSlave(Fmi2Slave):\n    pass\n")
    made = f"; pythonfmu build -f {path} makes MpcSlave.fmu of MpcSlave"
    with pytest.raises(ExportError) as refusal, blocks_in(path):
        pass
    assert str(refusal.value).endswith(made)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("lowpas.py", r"lowpas\.py: no such file; nearest is 'lowpass\.py'"),
        ("signal.py", r"signal\.py: 'signal' is no name for a module of yours: rename the file"),
        ("low-pass.py", r"'low-pass' is no name for a module of yours"),
        ("class.py", r"'class' is no name for a module of yours"),
        ("numpy.py", r"'numpy' is no name for a module of yours"),
    ],
)
def test_a_file_that_cannot_be_a_module_is_refused(file: str, message: str, tmp_path: Path) -> None:
    text = write(tmp_path).read_text()
    if "nearest" not in message:
        (tmp_path / file).write_text(text)
    with pytest.raises(ExportError, match=message), blocks_in(tmp_path / file):
        pass


# as it is traced, or called, or at the end of the reference results alone
@pytest.mark.slow
@pytest.mark.parametrize(
    ("expression", "flavour"),
    [
        ("exit(0)", Flavour.NATIVE),
        *(
            pytest.param(expression, Flavour.NATIVE, marks=pytest.mark.slow)
            for expression in (
                "(exit(0) if type(u.u) is float else u.u)",
                "(exit(0) if type(t) is float and h == 0.01 and 0.985 < t < 0.995 else u.u)",
            )
        ),
        ("(exit(0) if type(t) is float and h == 0.01 and 0.985 < t < 0.995 else u.u)", Flavour.PYTHON),
    ],
)
def test_a_block_that_ends_python_is_refused_with_the_line(
    expression: str, flavour: Flavour, tmp_path: Path
) -> None:
    path = write(tmp_path, expression=expression)
    orders = [BuildRequest(block, tmp_path / "out", flavour) for block in (str(path), "ExamplePlant")]
    refusal, built = builder.build_orders(orders)
    assert re.fullmatch(rf"{re.escape(str(path))}:\d+: exit\(0\): ends Python: .*", str(refusal))
    assert isinstance(built, list)
    assert not (tmp_path / "out" / "Lowpass.fmu").exists()


def test_a_folder_without_a_python_file_is_named(tmp_path: Path) -> None:
    message = f"{tmp_path / 'pid.py'}: no such file; {tmp_path} has no Python file"
    with pytest.raises(ExportError, match=re.escape(message)), blocks_in(tmp_path / "pid.py"):
        pass


@pytest.mark.parametrize(
    ("encoding", "first_line"), [("utf-8-sig", ""), ("latin-1", "# -*- coding: latin-1 -*-\n")]
)
def test_a_file_may_declare_its_encoding(encoding: str, first_line: str, tmp_path: Path) -> None:
    """The python flavour carries it as UTF-8, without a declaration of another encoding."""
    path = write(tmp_path)
    text = first_line + path.read_text().replace('"A low', '"\xc4 low')
    path.write_text(text, encoding=encoding)
    with blocks_in(path) as (block,):
        assert block.description == "\xc4 low-pass filter"
        source = source_closure("lowpass")["lowpass"].encode()
    assert ast.dump(ast.parse(source)) == ast.dump(ast.parse(text))
    assert not source.startswith("\ufeff".encode())


@pytest.mark.parametrize("kind", ["controller", "vehicle", "plain"])
def test_a_new_block_passes_its_test(tmp_path: Path, kind: str) -> None:
    path, test = write_new_block("depth_pid", tmp_path, kind)
    with blocks_in(path) as (block,):
        claims = {name: f for name, f in runpy.run_path(str(test)).items() if name.startswith("test_")}
        assert len(claims) == 4
        for claim in claims.values():
            claim()
        assert block.name == "DepthPid"


def test_a_new_block_replaces_no_file(tmp_path: Path) -> None:
    (tmp_path / "test_pid.py").write_text("mine")
    with pytest.raises(ExportError, match=r"test_pid\.py: is there already; expected another name"):
        write_new_block("pid", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["test_pid.py"]
    assert (tmp_path / "test_pid.py").read_text() == "mine"


NAMES_OF_NO_MODULE = "Pid signal lambda a-b ../pid pid.py orchestration numpy none con com1"


@pytest.mark.parametrize("name", ["", *NAMES_OF_NO_MODULE.split()])
def test_a_name_that_no_module_can_have_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r": expected lower-case letters"):
        write_new_block(name, tmp_path)


def test_the_block_of_a_new_file_has_40_lines(tmp_path: Path) -> None:
    """Of code: without blank lines, docstrings and comments."""
    block, _ = write_new_block("pid", tmp_path)
    text = re.sub(r'^ *""".*?"""$', "", block.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert len([line for line in text.splitlines() if line.partition("#")[0].strip()]) == 40


def test_the_sampling_period_of_a_new_block_cannot_change_during_a_run(tmp_path: Path) -> None:
    with blocks_in(write_new_block("pid", tmp_path)[0]) as (block,):
        parameters = block.of_causality("parameter")
        assert [v.name for v in parameters if v.variability == "fixed"] == ["period", "internal_step"]


@pytest.mark.slow
def test_a_scenario_takes_the_only_block_of_a_file(tmp_path: Path) -> None:
    """Its FMU is built once, and again when the file has changed."""
    path = write(tmp_path)
    fmu = builder.fmu_of_file(path, Flavour.PYTHON)
    built = fmu.stat().st_mtime_ns
    assert builder.fmu_of_file(path, Flavour.PYTHON).stat().st_mtime_ns == built
    builder.fmu_of_file(write(tmp_path, expression="2.0 * u.u"), Flavour.PYTHON)
    assert fmu.stat().st_mtime_ns != built
    with pytest.raises(ExportError, match=r"lowpass\.py defines First, Second: expected one block"):
        builder.fmu_of_file(write(tmp_path, names="First Second"), Flavour.PYTHON)


def test_a_block_that_leaves_the_domain_of_a_function_is_refused_with_the_line(tmp_path: Path) -> None:
    path = write(tmp_path, "from fmus.numerics import sqrt", "u.u + 3.7", names="Root")
    text = path.read_text().replace("Outputs(s.x)", "Outputs(sqrt(1.0 - s.x))")
    path.write_text(text.replace("step=step,", "step=step, step_size=0.1,"))
    with pytest.raises(ExportError) as refused:
        builder.fmu_of_file(path, Flavour.PYTHON)
    message, line = str(refused.value), text[: text.index("sqrt(1.0")].count("\n") + 1
    assert f"block 'Root': {path}:{line}: sqrt(1.0 - s.x): the reference run ends: step to 0.3" in message
    assert "not finite any more; take shorter steps: math domain error" in message
    assert list(tmp_path.glob("*.fmu")) == []
