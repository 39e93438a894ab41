"""The equations of an FMU become equations for vectors, or are refused."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus.errors import ExportError
from fmus.native.lanes import SOURCE, lane_sources
from fmus.native.statement_order import as_late_as_possible


def changed(fmu: Path, path: Path, old: str, new: str) -> Path:
    """A copy whose model_code.h has another line."""
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "sources/model_code.h":
                assert old.encode() in content
                content = content.replace(old.encode(), new.encode())
            target.writestr(name, content)
    return path


def test_the_sources_of_an_fmu_become_those_of_its_lane_library(built: Mapping[str, Path]) -> None:
    sources = lane_sources(built["ExamplePlant"])
    own = {SOURCE, "lane_functions.h", "lane_sine.h", "model_lanes.h"}
    assert {"model.h", "variables.h"} | own == {*sources}
    assert "double *" not in sources["model_lanes.h"]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("next[0] = ", "next[0] += ", "expected a statement"),
        ("next[0] = ", "next[0] = 1 % 2 + ", "expected an expression"),
        ("model_output(", "model_outputs(", "expected N_STEP_CONSTANTS and .*model_output"),
    ],
)
def test_equations_of_another_version_are_refused(
    built: Mapping[str, Path], tmp_path: Path, old: str, new: str, problem: str
) -> None:
    fmu = changed(built["ExamplePlant"], tmp_path / "other.fmu", old, new)
    with pytest.raises(
        ExportError, match=rf"other.fmu: sources/model_code.h: .*{problem}.*; build the FMU again"
    ):
        lane_sources(fmu)


def test_an_fmu_without_our_sources_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "")
    with pytest.raises(ExportError, match=r"no sources/model\.h, sources/model_code\.h"):
        lane_sources(path)


def test_statements_stand_before_their_first_use_and_in_their_branch() -> None:
    lines = """
        v1 = x[0];
        v2 = x[1];
        v3 = v1 + v2;
        if (v2) {
            v4 = x[3];
            v5 = v2 * v2;
            v6 = v4 + v5;
        } else {
            v7 = v2;
        }
        v8 = v6 + v7;
        next[0] = v8;
        next[1] = v3;
    """
    assert as_late_as_possible(line.strip() for line in lines.strip().splitlines()) == [
        "v2 = x[1];",
        "if (v2) {",
        "v4 = x[3];",
        "v5 = v2 * v2;",
        "v6 = v4 + v5;",
        "} else {",
        "v7 = v2;",
        "}",
        "v8 = v6 + v7;",
        "next[0] = v8;",
        "v1 = x[0];",
        "v3 = v1 + v2;",
        "next[1] = v3;",
    ]  # fmt: skip
