"""Tests of installations: the wheel, the archive of sources and an editable install work like the clone."""

import base64
import hashlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from fmus.platforms import PLATFORMS, host_platform
from tests.shared_builds import Build, built_once, session_folder

ROOT = Path(__file__).parent.parent
PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
# what `simulate` imports of others (docs/how-to/run-without-building.md)
FOR_RUNNING = ("cloudpickle", "fmpy", "numpy")

pytestmark = pytest.mark.packaging


def run(command: Sequence[str | Path], cwd: Path, **variables: str) -> str:
    """Returns the output of a command that does not see the clone; raises CalledProcessError if it fails."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    try:
        done = subprocess.run(
            command, cwd=cwd, env={**environment, **variables}, capture_output=True, text=True, check=True
        )
    except subprocess.CalledProcessError as error:
        pytest.fail(f"{command}: status {error.returncode}: {error.stdout}{error.stderr}")
    assert "runs in Python" not in done.stderr
    return done.stdout


def built(folder: Path, *options: str, umask: int = 0o022) -> Path:
    """The wheel, built in a copy of the sources: a build writes beside them, and two may run at once.

    umask: of the user who checks the sources out and builds
    """
    unwanted = shutil.ignore_patterns(".git", ".*_cache", "__pycache__", "*.egg-info", "*.fmu")
    sources = shutil.copytree(ROOT, folder / "copy", ignore=unwanted)
    for path in Path(sources).rglob("*"):
        path.chmod((0o777 if path.is_dir() else 0o666) & ~umask)
    before = os.umask(umask)
    try:
        run([sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, *options, sources], folder)
    finally:
        os.umask(before)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel built from the archive of sources beside it."""
    folder = built_once(
        session_folder(tmp_path_factory, "packaging") / "wheel", lambda path: path.mkdir() or built(path)
    )
    return next(folder.glob("*.whl"))


@pytest.fixture
def folder() -> Iterator[Path]:
    """An empty folder of a user."""
    path = Path(tempfile.mkdtemp(prefix="l1-depth-user-"))
    yield path
    for inside in path.rglob("*"):
        if inside.is_dir() and not inside.is_symlink():
            inside.chmod(0o755)
    shutil.rmtree(path)


Venv = Callable[..., Path]


@pytest.fixture
def venv(folder: Path) -> Venv:
    """Makes a virtual environment with given installations, and optionally the libraries of the tests."""

    def make(*packages: str | Path, with_libraries: bool) -> Path:
        path = folder / "venv"
        run([sys.executable, "-m", "venv", "--without-pip", path], folder)
        python = path / "bin" / "python"
        if with_libraries:
            (site,) = path.glob("lib/python*/site-packages")
            libraries = next(entry for entry in sys.path if entry.endswith("site-packages"))
            (site / "libraries.pth").write_text(libraries)
        options = ["--quiet", "--no-deps", "--no-build-isolation"]
        run([sys.executable, "-m", "pip", "--python", python, "install", *options, *packages], folder)
        return path / "bin"

    return make


def read_only(venv: Path) -> list[str]:
    """Makes an environment read-only. A command with the returned prefix cannot write there even as root."""
    for path in (venv, *venv.rglob("*")):
        if not path.is_symlink():
            path.chmod(path.stat().st_mode & ~0o222)
    if os.geteuid() != 0:
        return []
    privileges = "-dac_override,-dac_read_search"
    return ["setpriv", f"--bounding-set={privileges}", f"--inh-caps={privileges}"]


def installed_files(venv: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in venv.rglob("*") if path.is_file()}


def test_an_isolated_build_has_the_compiler_and_the_headers_of_fmi(monkeypatch: pytest.MonkeyPatch) -> None:
    """FMPy holds the headers; the other tests build where it is installed."""
    monkeypatch.syspath_prepend(str(ROOT / ".ci"))
    backend = importlib.import_module("build_backend")
    monkeypatch.setattr(backend.build_meta, "get_requires_for_build_wheel", lambda _: [])
    required = backend.get_requires_for_build_wheel()
    assert {re.split("[<>=]", name)[0] for name in required} == {"ziglang", "fmpy"}


def test_the_wheel_holds_every_file_and_the_libraries_of_five_platforms(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith(PACKAGES)}
    sources = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".fmu")  # which git ignores
    }
    libraries = sorted(names - sources)
    assert sources <= names
    beginnings = [
        f"{source}-{platform}-"
        for source in ("fmus/fmi/fmi3_calls", "orchestration/run/loop")
        for platform in sorted(PLATFORMS)
    ]
    assert len(libraries) == len(beginnings)
    assert all(map(str.startswith, libraries, beginnings))


def test_the_wheel_has_a_bill_of_materials_of_its_libraries(wheel: Path) -> None:
    """The bill follows PEP 770, has the digest of each library, and is in RECORD like every file."""
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    with zipfile.ZipFile(wheel) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    (path,) = (name for name in members if ".dist-info/sboms/" in name)
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(members[path].decode()) is None
    files = [part for part in json.loads(members[path])["components"] if part["type"] == "file"]
    assert len(files) == 2 * len(PLATFORMS)
    for file in files:
        assert file["hashes"][0]["content"] == hashlib.sha256(members[file["name"]]).hexdigest()
    digest = base64.urlsafe_b64encode(hashlib.sha256(members[path]).digest()).decode().rstrip("=")
    (record,) = (text.decode() for name, text in members.items() if name.endswith(".dist-info/RECORD"))
    assert record.splitlines()[-1] == f"{path},sha256={digest},{len(members[path])}"


def test_a_wheel_follows_from_its_sources_byte_for_byte_whatever_the_umask(
    wheel: Path, tmp_path: Path
) -> None:
    assert built(tmp_path, "--wheel", umask=0o077).read_bytes() == wheel.read_bytes()


def test_the_wheel_builds_runs_and_reproduces_where_nothing_can_be_written(
    wheel: Path, folder: Path, venv: Venv, tmp_path: Path, scenario_fmus: None
) -> None:
    bin_folder = venv(wheel, with_libraries=True)
    home, cwd = folder / "home", folder / "cwd"
    home.mkdir()
    cwd.mkdir()
    variables = {
        "HOME": str(home),
        "L1_DEPTH_FMUS": "",
        **{f"XDG_{name}_HOME": str(home / name) for name in ("CACHE", "CONFIG", "DATA", "STATE")},
    }
    prefix = read_only(bin_folder.parent)
    before = installed_files(bin_folder.parent)
    command = [*prefix, bin_folder / "l1-depth"]
    run([*command, "reproduce", "--out", "results"], cwd, **variables)
    run([*command, "run", "nominal-l1", "--out", "again"], cwd, **variables)
    run([*command, "build", "ExamplePlant", "--out", "fmus-built"], cwd, **variables)
    assert installed_files(bin_folder.parent) == before
    assert {path.name for path in cwd.iterdir()} == {"results", "again", "fmus-built"}
    where = run([bin_folder / "python", "-c", "import orchestration; print(orchestration.__file__)"], cwd)
    assert Path(where.strip()).is_relative_to(bin_folder.parent)
    clone = [sys.executable, "-c", "from orchestration.cli import main; main()"]
    run([*clone, "run", "nominal-l1", "--out", tmp_path], ROOT)
    (recording,) = tmp_path.glob("*.csv")
    for installed in ("results", "again"):
        assert (cwd / installed / recording.name).read_bytes() == recording.read_bytes()


FOREIGN_PAIR = """
import sys, time, warnings
from pathlib import Path
warnings.simplefilter("error")  # such as that the loop runs in Python
from orchestration import System, simulate
one, two = sys.argv[1:]
system = System({"one": one, "two": two}, (("one.y[1]", "two.u[1]"), ("two.y[1]", "one.u[1]")))
start = time.process_time()
recording = simulate(system, stop_time=1000.0, step_size=0.01)
print(time.process_time() - start)
assert len(recording.time) == 100001
unneeded = {"casadi", "ziglang", "scipy", "pint", "PIL", "matplotlib", "pandas", "rich", "typer"}
unneeded |= {"fmus.generate"}
assert not unneeded & set(sys.modules), unneeded & set(sys.modules)
maps = Path("/proc/self/maps").read_text()
print(*{line.split("/", 1)[1] for line in maps.splitlines() if "l1-depth-" in line})
"""


def test_running_foreign_fmus_needs_few_libraries_and_no_compiler(
    wheel: Path, folder: Path, venv: Venv, linear: Build
) -> None:
    """They run at full speed with the compiled loop of the wheel: nothing else could have compiled one."""
    bin_folder = venv(wheel, *FOR_RUNNING, with_libraries=False)
    home = folder / "home"
    home.mkdir()
    cache = {"HOME": str(home), "XDG_CACHE_HOME": str(home)}
    fmus = [linear(), linear(a=-2.0)]
    output = run([bin_folder / "python", "-c", FOREIGN_PAIR, *fmus], folder, **cache)
    seconds = float(output.split()[0])
    assert seconds < 2.0  # 100,000 steps: 0.1 s in C, 5 s in Python
    assert list(home.iterdir()) == []
    for library in ("casadi", "ziglang", "scipy", "pint", "PIL", "matplotlib"):
        code = f"import importlib.util; assert importlib.util.find_spec({library!r}) is None"
        run([bin_folder / "python", "-c", code], folder)


@pytest.fixture(scope="module")
def unpacked(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The archive of sources, unpacked."""
    (archive,) = wheel.parent.glob("*.tar.gz")
    folder = tmp_path_factory.mktemp("sources")
    with tarfile.open(archive) as stream:
        stream.extractall(folder, filter="data")
    (unpacked,) = folder.iterdir()
    return unpacked


def test_folders_of_the_users_do_not_hide_an_editable_install(
    unpacked: Path, folder: Path, venv: Venv
) -> None:
    bin_folder = venv("--editable", unpacked, with_libraries=True)
    cwd = folder / "cwd"
    for package in PACKAGES:
        (cwd / package).mkdir(parents=True)
        (cwd / package / "notes.txt").touch()
    (cwd / "test_own.py").write_text("def test_own(): pass\n")
    python = bin_folder / "python"
    run([bin_folder / "l1-depth", "--help"], cwd)
    code = "import fmus.block, plant_fmu.heave, orchestration.run as m; print(m.__file__)"
    assert Path(run([python, "-c", code], cwd).strip()).is_relative_to(unpacked)
    assert "1 passed" in run([python, "-m", "pytest", "-p", "no:cacheprovider"], cwd)


def test_an_editable_install_compiles_the_loop_once_for_its_user(
    unpacked: Path, folder: Path, venv: Venv, linear: Build
) -> None:
    bin_folder = venv("--editable", unpacked, with_libraries=True)
    variables = {"HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}
    code = "import sys; from orchestration import System, simulate; "
    code += "simulate(System({'one': sys.argv[1]}), stop_time=1.0, step_size=0.1, inputs={'one.u[1]': 0.0})"
    command = [bin_folder / "python", "-W", "error", "-c", code, linear()]
    run(command, folder, **variables)
    (loop,) = (folder / "cache" / "l1-depth" / "libraries").iterdir()
    written = loop.stat().st_ino
    run(command, folder, **variables)
    assert loop.stat().st_ino == written
    assert loop.name.startswith(f"loop-{host_platform()}-")
