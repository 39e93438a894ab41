"""The sources in a native FMU: they build elsewhere, without a warning, to an FMU that does the same."""

import importlib.metadata
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]

from fmus import platforms
from fmus.files import write_archive
from fmus.generate import builder
from fmus.native import toolchain
from tests.described_fmus import members
from tests.shared_builds import KINDS, Fmus, c_sources_of

REBUILT = ("DepthReference", "ExamplePlant")  # without inputs, and with inputs and continuous states
# block and version of FMI: the layer of FMI 3.0 is around the same code of a block
SOURCES = [*((kind, 2) for kind in KINDS), ("ExamplePlant", 3)]
OTHER_TARGETS = ["x86_64-windows-gnu", "aarch64-macos"]
# what is generated has all arguments and functions whether or not a model has use for them
GENERATED = ("-Wno-unused-function", "-Wno-unused-parameter")
HEADERS = ("-isystem", str(toolchain.FMI_HEADERS))


# FMI 2.0 has 44 functions, of which three macros make eleven; FMI 3.0 has 75, of which macros make 40
@pytest.mark.parametrize(("fmi", "count"), [(2, 36), (3, 38)])
def test_every_function_of_fmi_names_its_clause_of_the_standard(fmi: int, count: int) -> None:
    """In the comment above it, or above the functions that share one."""
    returns = rf"(?:(?:fmi{fmi})?Status|fmi{fmi}(?:Component|Instance)|void|const char \*)"
    made = r"#define (?:DEFINE|ABSENT)_(GET|SET|TYPE|STATUS)"
    defined = re.compile(rf"^(?:{returns} ?(fmi{fmi}\w+|FMI\(\w+\))|{made})\(", re.MULTILINE)
    names = []
    sources = c_sources_of(builder.load_block("ExamplePlant"), "guid", fmi=fmi)
    for text in sources.values():
        for function in defined.finditer(text):
            names.append(function[1] or function[2])
            comment = re.findall(r"^/\*.*?\*/", text[: function.start()], re.DOTALL | re.MULTILINE)[-1]
            assert re.search(r"\b[2-4]\.\d\.\d", comment), (function[0], comment)
    assert len(set(names)) == len(names) == count


@pytest.fixture(scope="session")
def rebuilt(built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """FMUs without libraries, to which `fmpy compile` added this platform's."""
    folder = tmp_path_factory.mktemp("rebuilt")
    compiler = folder / "cc"
    compiler.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang cc "$@"\n')
    compiler.chmod(0o755)
    return {name: _rebuilt(built[name], folder, compiler) for name in REBUILT}


def _rebuilt(fmu: Path, folder: Path, compiler: Path) -> Path:
    sources = {name: data for name, data in members(fmu).items() if not name.startswith("binaries/")}
    copy = write_archive(folder / fmu.name, sources)
    tools = (_program("cmake"), _program("ninja"))
    done = subprocess.run(
        [sys.executable, "-m", "fmpy", "compile", str(copy), "--generator", "Ninja"],
        env=os.environ
        | {
            "PATH": os.pathsep.join(str(tool.parent) for tool in tools),
            "CC": str(compiler),
            "CXX": str(compiler),  # fmpy's project asks for one and has no file for it
        },
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return copy


def _program(package: str) -> Path:
    """The program that a package of PyPI of the same name brings."""
    for file in importlib.metadata.files(package) or ():
        if file.stem == package and file.parent.name in ("bin", "Scripts"):
            return Path(str(file.locate())).resolve()
    raise AssertionError(f"{package} is not installed")


@pytest.mark.slow
@pytest.mark.parametrize("name", REBUILT)
def test_what_fmpy_compiles_from_the_sources_does_the_same(
    built: Fmus, rebuilt: dict[str, Path], tmp_path: Path, name: str
) -> None:
    """To rounding only: another importer's compiler may fuse a product and a sum."""
    libraries = [m for m in members(rebuilt[name]) if m.startswith("binaries/") and not m.endswith("/")]
    assert libraries == [platforms.library_name(name, platforms.host_platform())]
    expected, recompiled = (_trace(fmu) for fmu in (built[name], rebuilt[name]))
    # 100 steps of rounding errors of 1e-16
    assert np.all(np.abs(recompiled - expected) <= 1e-13 * np.abs(expected).max(axis=0))
    assert np.abs(expected).max() > 0


def _trace(fmu: Path) -> np.ndarray:
    """All outputs over 100 steps with inputs that move."""
    description: Any = fmpy.read_model_description(str(fmu))
    inputs = [v.name for v in description.modelVariables if v.causality == "input" and v.min is None]
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    h = float(description.defaultExperiment.stepSize)
    t = np.arange(101) * h
    moved = np.array(
        [(time, *(np.cos(5.0 * time * (k + 1)) for k in range(len(inputs)))) for time in t],
        dtype=[("time", float), *((name, float) for name in inputs)],
    )
    result: Any = fmpy.simulate_fmu(
        str(fmu), stop_time=t[-1], step_size=h, output_interval=h, input=moved, output=outputs
    )
    return np.array([result[name] for name in outputs]).T


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Ball", "Items"])
def test_the_build_description_is_valid_and_names_the_source_files(small_built: Fmus, name: str) -> None:
    files = members(small_built[name])
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3BuildDescription.xsd"
    description = etree.fromstring(files["sources/buildDescription.xml"])
    etree.XMLSchema(etree.parse(schema)).assertValid(description)
    model = ElementTree.fromstring(files["modelDescription.xml"])
    listed = [file.get("name") for file in model.iterfind("CoSimulation/SourceFiles/File")]
    assert listed == [file.get("name") for file in description.iterfind(".//SourceFile")]
    assert listed
    assert {f"sources/{file}" for file in listed} <= {*files}
    for owner in (description.find("BuildConfiguration"), model.find("CoSimulation")):
        assert owner is not None
        assert owner.get("modelIdentifier") == name


def write_sources(folder: Path, block: str, fmi: int) -> None:
    """Writes the sources of an FMU of a version of the standard."""
    for name, text in c_sources_of(builder.load_block(block), "guid", fmi=fmi).items():
        (folder / name).write_text(text, encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("block", "fmi", "target"),
    [
        *((*source, "x86_64-linux-gnu") for source in SOURCES),
        *(("ExamplePlant", fmi, target) for fmi in (2, 3) for target in OTHER_TARGETS),
    ],
)
def test_the_sources_compile_without_a_warning(block: str, fmi: int, target: str, tmp_path: Path) -> None:
    write_sources(tmp_path, block, fmi)
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", *GENERATED)
    toolchain.zig(
        ["cc", "-target", target, "-std=c99", *warnings, *HEADERS, "-c", f"fmi{fmi}.c", "-o", "it.o"],
        tmp_path,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("block", "fmi"), SOURCES)
def test_our_own_sources_need_no_warning_switched_off(block: str, fmi: int, tmp_path: Path) -> None:
    """What is generated becomes a system header, of which no warning is given."""
    write_sources(tmp_path, block, fmi)
    (tmp_path / "generated").mkdir()
    (tmp_path / "model_code.h").rename(tmp_path / "generated" / "model_code.h")
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wstrict-prototypes", "-Werror")
    toolchain.zig(
        ["cc", "-std=c99", *warnings, "-isystem", "generated", *HEADERS, "-c", f"fmi{fmi}.c", "-o", "it.o"],
        tmp_path,
    )


@pytest.mark.cross
@pytest.mark.parametrize(("block", "fmi"), SOURCES)
def test_gcc_for_a_microcontroller_has_no_warning(block: str, fmi: int, tmp_path: Path) -> None:
    """It sees more uninitialized variables than Clang, and there uint32_t is no unsigned int."""
    options = ("-mcpu=cortex-m7", "-Os", "-std=c99", "-Wall", "-Wextra", "-Werror", *GENERATED, *HEADERS)
    write_sources(tmp_path, block, fmi)
    command = ["arm-none-eabi-gcc", *options, "-c", f"fmi{fmi}.c", "-o", "it.o"]
    subprocess.run(command, cwd=tmp_path, check=True)
