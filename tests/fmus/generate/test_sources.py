"""An FMU carries every source that it needs, and nothing that a bare Python lacks."""

import ast
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.documentation import page
from fmus.generate.python import defined_as, in_package, source_closure
from fmus.registry import Flavour


@pytest.mark.parametrize("name", builder.block_names())
def test_the_closure_imports_the_standard_library_and_itself_only(name: str) -> None:
    closure = source_closure(builder.load_block(name).step.__module__)
    for source in closure.values():
        for statement in ast.parse(source).body:
            if isinstance(statement, ast.ImportFrom) and not statement.level:
                module = statement.module or ""
                assert module in closure or module.split(".")[0] in sys.stdlib_module_names


def test_every_absolute_import_moves_into_the_package() -> None:
    closure = source_closure("plant_fmu.depth_plant")
    moved = in_package(closure, "unique")
    assert "from unique.fmus.block import" in moved["unique/plant_fmu/depth_plant.py"]
    assert "from unique.plant_fmu import depth_sensor" in moved["unique/plant_fmu/depth_plant.py"]
    for source in moved.values():
        assert "\nfrom fmus" not in source
        assert "\nfrom plant_fmu" not in source
        assert "\nfrom pythonfmu" not in source


NEEDS_NUMPY = """
from dataclasses import dataclass
import numpy
from fmus.block import Block, variable

@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")

def output(t, s, p, c):
    return Outputs(float(numpy.float64(2.0)))


BLOCK = Block.of_module(__name__, "NeedsNumpy", "A block that needs NumPy")
"""


@pytest.mark.slow
def test_a_block_that_imports_numpy_is_for_the_native_flavour(tmp_path: Path) -> None:
    file = tmp_path / "needs_numpy.py"
    file.write_text(NEEDS_NUMPY)
    message = r"needs_numpy imports numpy: expected .*; the native flavour, .* any"
    with pytest.raises(ExportError, match=message):
        builder.fmu_of_file(file, Flavour.PYTHON)
    assert builder.fmu_of_file(file).is_file()


def test_a_block_that_no_module_holds_is_refused_by_the_python_flavour() -> None:
    """Its sources would define another block."""
    block = replace(builder.load_block("ExamplePlant"), description="another")
    with pytest.raises(ExportError, match="'ExamplePlant': expected a name at the top level of a module"):
        defined_as(block)


def test_a_licence_that_the_installed_project_lacks_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "distributions", lambda name: [])
    with pytest.raises(ExportError, match="the installed pythonfmu has no LICENSE among its licences"):
        page.licenses("pythonfmu")
