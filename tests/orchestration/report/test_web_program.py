"""What a WebAssembly program cannot carry is refused; test_live.py runs programs."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus.errors import FmuLoadError
from fmus.files import write_archive
from orchestration import Experiment, System
from orchestration.errors import ScenarioError
from orchestration.report.web_program import program
from orchestration.system.prepared_run import prepare
from tests.described_fmus import described, members, redescribed

SOURCES = '><SourceFiles><File name="fmi2.c"/></SourceFiles></CoSimulation>'


def refusal(error: type[Exception], components: Mapping[str, Path], **settings: object) -> str:
    prepared = prepare(System(dict(components)), Experiment(1.0, 0.1, open_inputs="start", **settings))  # type: ignore[arg-type]
    with pytest.raises(error) as caught:
        program(prepared, prepared.initial_settings)
    return str(caught.value)


def with_list(fmu: Path, path: Path) -> Path:
    """Writes a copy whose model description lists a file of sources."""
    return redescribed(fmu, path, lambda text: text.replace("/><ModelV", f"{SOURCES}<ModelV"))


def test_an_fmu_without_sources_is_refused(tmp_path: Path) -> None:
    fmu = described(tmp_path / "a.fmu", outputs=["y"])
    assert refusal(FmuLoadError, {"a": fmu}) == (
        f"a WebAssembly program with a, {fmu}, without C sources: expected an FMU whose model description "
        "lists SourceFiles that it has, as the native flavour's of l1-depth build"
    )


def test_an_fmu_that_lists_sources_without_having_them_is_refused(tmp_path: Path) -> None:
    fmu = with_list(described(tmp_path / "a.fmu", outputs=["y"]), tmp_path / "b.fmu")
    assert "without C sources" in refusal(FmuLoadError, {"a": fmu})


def test_an_fmu_of_the_python_flavour_has_no_sources(python_built: Mapping[str, Path]) -> None:
    assert "without C sources" in refusal(FmuLoadError, {"plant": python_built["ExamplePlant"]})


def test_an_fmu_of_fmi_3_is_refused(fmi3_built: Mapping[str, Path]) -> None:
    fmu = fmi3_built["ExamplePlant"]
    text = refusal(FmuLoadError, {"plant": fmu})
    assert text == f"a WebAssembly program with {fmu}, of FMI 3.0: expected FMI 2.0"


def test_an_fmu_for_model_exchange_alone_is_refused(tmp_path: Path) -> None:
    fmu = redescribed(
        described(tmp_path / "a.fmu", outputs=["y"]),
        tmp_path / "b.fmu",
        lambda text: text.replace("<CoSimulation", "<ModelExchange"),
    )
    assert refusal(FmuLoadError, {"a": fmu}) == (
        f"a WebAssembly program with {fmu}, for model exchange alone: expected co-simulation"
    )


def test_two_fmus_with_one_model_identifier_are_refused(tmp_path: Path) -> None:
    """Their functions would have the same names."""
    fmu = with_list(described(tmp_path / "described.fmu", outputs=["y"]), tmp_path / "listed.fmu")
    content = members(fmu) | {"sources/fmi2.c": b""}
    first, second = (write_archive(tmp_path / f"{name}.fmu", content) for name in "ab")
    assert refusal(FmuLoadError, {"a": first, "b": second}) == (
        f"a WebAssembly program with {first} and {second}: expected different model identifiers"
    )


def test_a_tolerance_is_refused(built: Mapping[str, Path]) -> None:
    assert refusal(ScenarioError, {"plant": built["ExamplePlant"]}, tolerance=1e-4) == (
        "a WebAssembly program with a tolerance: expected none, its steps are on the grid"
    )


def test_strings_are_refused(tmp_path: Path) -> None:
    fmu = described(tmp_path / "a.fmu", outputs=["y", "text:String"])
    text = refusal(ScenarioError, {"a": fmu}, record=["a.text"])
    assert text.startswith("a WebAssembly program with a.text: expected type Real or Integer or Boolean")
    assert text.endswith("got String")
