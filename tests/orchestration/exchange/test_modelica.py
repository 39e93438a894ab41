"""The Modelica package: its text against a compiler's front end, its C and equations against the master."""

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
import rumoca

from fmus.build import builder
from fmus.native import toolchain
from orchestration.errors import OrchestrationError
from orchestration.exchange import modelica, simulink
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Algorithm
from orchestration.system.signals import Cosine

from . import modelica_text

STANDARD_LIBRARY = Path(__file__).parent / "modelica" / "standard_library.mo"


@pytest.fixture(scope="module")
def chosen() -> scenario.Scenario:
    return scenario.load(scenario.find("nominal-extended"))


@pytest.fixture(scope="module")
def package(chosen: scenario.Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return modelica.write(chosen, tmp_path_factory.mktemp("modelica")).parent


def _one_file(texts: dict[str, str]) -> str:
    """The package as one file, after the part of the standard library that it uses."""
    head, end = texts["package.mo"].split("\n", 1)
    classes = [re.sub(r"^within .*\n", "", texts[f"{n}.mo"]) for n in texts["package.order"].split()]
    return "\n".join([STANDARD_LIBRARY.read_text(encoding="utf-8"), head, *classes, end])


def _without_objects(source: str) -> str:
    """The compiler knows no external objects: the constructor becomes a function that gives a Real."""
    constructor = re.search(r"function constructor.*?end constructor;", source, re.S)
    assert constructor
    opening = constructor[0].replace("constructor", "openFMU").replace("output FMU fmu", "output Real fmu")
    plain = re.sub(r"class FMU .*?end FMU;", lambda _: opening, source, flags=re.S)
    plain = plain.replace("FMU fmu = FMU(", "parameter Real fmu = openFMU(")
    return plain.replace("input FMU fmu", "input Real fmu")


def _compiled_by_rumoca(source: str) -> rumoca.StructuralInfo:
    name = f"{modelica.PACKAGE}.{modelica.SYSTEM}"
    return rumoca.Session().loads(_without_objects(source), model=name).structure()


def test_the_closed_loop_is_balanced_and_has_no_algebraic_loop(chosen: scenario.Scenario) -> None:
    """As rumoca sees it, with a stand-in for the part of the standard library that the package uses."""
    model = _compiled_by_rumoca(_one_file(modelica.texts(chosen)))
    assert model.is_balanced
    assert model.is_matched
    assert model.n_algebraic_loops == 0


def test_the_whole_package_with_its_external_object_is_parsed(chosen: scenario.Scenario) -> None:
    source = _one_file(modelica.texts(chosen))
    assert [d.message for d in rumoca.validate_source(source) if d.level == "error"] == []
    assert [d for d in rumoca.validate_source(source.replace("end when", "end")) if d.level == "error"]


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ("connect(plant.depth_rate,", "connect(plant.depth_rat,", "plant.depth_rat"),
        ("y = stepFMU(fmu,", "y = stepFM(fmu,", "stepFM"),
        ("thruster_efficiency = {1.0, 1.0}", "efficiency = {1.0, 1.0}", "unknown modifier `efficiency`"),
        ("  connect(plant.measured_depth, controller.measured_depth);\n", "", "unbalanced model"),
    ],
)
def test_the_compiler_would_see_a_mistake(
    chosen: scenario.Scenario, right: str, wrong: str, words: str
) -> None:
    source = _one_file(modelica.texts(chosen))
    assert right in source
    with pytest.raises(rumoca.CompileError, match=words):
        _compiled_by_rumoca(source.replace(right, wrong, 1))


def _compiled(code: str, package: Path, folder: Path) -> Path:
    (folder / "driver.c").write_text(code)
    include = [package / "Resources" / "Include", Path(__file__).parent / "modelica"]
    warnings = ["-Wall", "-Wextra", "-Werror"]
    options = [*toolchain.FLAGS, *warnings, *[f"-I{folder}" for folder in include]]
    toolchain.zig(
        ["cc", "-target", "x86_64-linux-gnu.2.17", *options, "-o", "driver.exe", "driver.c", "-ldl", "-lm"],
        folder,
    )
    return folder / "driver.exe"


def test_the_external_functions_give_what_the_master_gives(
    chosen: scenario.Scenario, package: Path, tmp_path: Path
) -> None:
    """Bit for bit: value references, parameters, wiring and order are read from the package's own text."""
    loop = modelica_text.read_loop(package)
    program = _compiled(modelica_text.driver(loop, package), package, tmp_path)
    subprocess.run([program, tmp_path / "result.bin"], check=True, timeout=120)
    names = modelica_text.columns(loop)
    written = np.fromfile(tmp_path / "result.bin").reshape(-1, len(names))
    recording = simulate(chosen.system, replace(chosen.experiment, record=tuple(names)))
    assert np.array_equal(written, recording.values)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["x86_64-windows-gnu", "aarch64-linux-gnu.2.17", "aarch64-macos.11.0"])
def test_the_external_functions_compile_for_other_platforms(
    package: Path, tmp_path: Path, target: str
) -> None:
    (tmp_path / "driver.c").write_text(_open_only("somewhere", "It"))
    include = [package / "Resources" / "Include", Path(__file__).parent / "modelica"]
    options = [*toolchain.FLAGS, "-Wall", "-Wextra", "-Werror", *[f"-I{folder}" for folder in include]]
    toolchain.zig(["cc", "-target", target, *options, "-c", "-o", "driver.o", "driver.c"], tmp_path)
    assert (tmp_path / "driver.o").stat().st_size > 0


def _open_only(folder: str, name: str) -> str:
    """Opens the plant with its first voltage and its depth alone."""
    variables = builder.load_block("RovDepthPlant").variables
    voltage, depth = (
        v.value_reference for name in ("voltage[1]", "depth") for v in variables if v.name == name
    )
    return (
        '#include "modelica_fmu.h"\nint main(void) {\n    double u[9] = {0}, y[7];\n'
        f'    void *it = modelica_fmu_open("{folder}", "{name}", "it", NULL, NULL, 0, NULL, NULL, 0,\n'
        f"        NULL, NULL, 0, (const int[]){{{voltage}}}, 1, (const int[]){{{depth}}}, 1);\n"
        "    modelica_fmu_start(it, 0.0, u, y);\n    modelica_fmu_step(it, 0.0, 0.02, 1, u, y);\n"
        "    modelica_fmu_step(it, 0.0, 0.02, 3, u, y);\n    modelica_fmu_close(it);\n    return 0;\n}\n"
    )


@pytest.mark.parametrize(
    ("folder", "name", "words"),
    [
        ("/nowhere", "RovDepthPlant", "cannot read /nowhere/modelDescription.xml"),
        ("{fmu}", "AnotherName", "cannot load"),
        ("{fmu}", "RovDepthPlant", "step 3 after step 1: expected the same or the next"),
    ],
)
def test_what_goes_wrong_ends_the_simulation_with_one_line(
    package: Path, tmp_path: Path, folder: str, name: str, words: str
) -> None:
    unpacked = folder.format(fmu=package / "Resources" / "FMUs" / "RovDepthPlant")
    program = _compiled(_open_only(unpacked, name), package, tmp_path)
    done = subprocess.run([program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 3
    assert words in done.stderr


@pytest.mark.parametrize("write", [modelica.texts, simulink.text])
def test_what_the_package_or_the_script_of_simulink_cannot_express_is_refused(
    chosen: scenario.Scenario, write: Callable[[scenario.Scenario], object]
) -> None:
    gauss_seidel = replace(chosen.experiment, algorithm=Algorithm.GAUSS_SEIDEL)
    with pytest.raises(OrchestrationError, match=r"with algorithm gauss-seidel.*: expected none"):
        write(replace(chosen, experiment=gauss_seidel))
    cosine = replace(chosen.experiment, signals={"controller.depth_reference": Cosine(0.1, 1.0)})
    with pytest.raises(OrchestrationError, match="expected straight ramps"):
        write(replace(chosen, experiment=cosine))


def test_the_package_carries_the_headers_that_its_annotation_names(package: Path) -> None:
    headers = {path.name for path in (package / "Resources" / "Include").iterdir()}
    included = set(re.findall(r'Include = "#include \\"(.*?)\\""', (package / "stepFMU.mo").read_text()))
    assert included == {"modelica_fmu.h"}
    assert headers >= included | {"load.h", "fmi2Functions.h"}
    assert fmpy.read_model_description(package / "Resources" / "FMUs" / "RovDepthPlant").coSimulation
