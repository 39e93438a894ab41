"""FMUs of FMI 3.0 are judged by its rules, and no finding quotes FMI 2.0."""

import json
import re
from pathlib import Path

import pytest

from fmus.compliance.check import NOT_JUDGED, main
from fmus.compliance.examine import examine
from fmus.compliance.fmu_file import CO_SIMULATION, FmuFile
from fmus.compliance.rule import Stage, all_rules
from fmus.compliance.sentences import titles
from fmus.generate import builder
from tests.described_fmus import XML, members
from tests.mutants.base import BASE_3, written
from tests.mutants.slaves import write_slave
from tests.shared_builds import Fmus

from .archives import Members, broken_rules, write

TIME = b'name="time" valueReference="14"'
TWICE = TIME.replace(b"14", b"9")  # that of the disturbance


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> Members:
    """Members of the FMU of a block in FMI 3.0."""
    block = builder.load_block("ExamplePlant")
    return members(builder.build_block(block, tmp_path_factory.mktemp("fmi 3"), fmi=3))


def changed(content: Members, old: bytes, new: bytes, folder: Path) -> Path:
    """The FMU with a place of its description replaced."""
    assert content[XML].count(old) == 1
    return write(content | {XML: content[XML].replace(old, new)}, folder / "changed.fmu")


STEPS = "steps-and-terminates", "steps-with-events", "state-restores", "wrong-references-are-refused"


@pytest.mark.parametrize("names", [STEPS, pytest.param(None, marks=pytest.mark.slow)])
def test_ours_breaks_no_rule(content: Members, names: tuple[str, ...] | None, tmp_path: Path) -> None:
    results = examine(write(content, tmp_path / "plant.fmu"), names=names)
    assert {result.outcome for result in results} <= {"passed", "not applicable"}
    assert names is None or len(results) == len(names)


@pytest.mark.slow
def test_adjoint_derivatives_by_a_table_with_a_jump_are_numbers(fmi3_built: Fmus) -> None:
    """The table of thrusters has 0 N at two voltages."""
    (result,) = examine(fmi3_built["L1DepthController"], names=["directional-derivatives"])
    assert result.outcome == "passed"


@pytest.mark.parametrize(
    ("mutation", "rule"),
    [
        ("a state that is not restored", "state-restores"),
        pytest.param("any token", "wrong-guid-is-refused", marks=pytest.mark.slow),
        pytest.param("step mode is not entered", "steps-with-events", marks=pytest.mark.slow),
    ],
)
def test_behaviour_is_found_by_its_rule_alone(mutation: str, rule: str, tmp_path: Path) -> None:
    results = examine(write_slave(tmp_path, mutation, slave="Fmi3"), names=[rule])
    assert [result.rule.name for result in results if result.messages] == [rule]
    assert [text for r in results for text in r.messages if "fmi2" in text] == []


@pytest.mark.slow
def test_clocks_and_scheduled_execution_are_said_to_be_not_judged(tmp_path: Path) -> None:
    path = write_slave(tmp_path, slave="Fmi3", is_clocked=True)
    (result,) = examine(path, names=["clocks-have-partitions"])
    assert result.not_judged == "clocks are not judged"
    assert main([str(path), "--only", "clocks-have-partitions", "--strict"]) == NOT_JUDGED
    text = re.sub(r" *<(?:ModelExchange|CoSimulation).*\n", "", BASE_3[XML].decode())
    scheduled = text.replace("  <UnitDef", '  <ScheduledExecution modelIdentifier="Fmi3"/>\n  <UnitDef')
    results = examine(write(BASE_3 | {XML: scheduled.encode()}, tmp_path / "scheduled.fmu"))
    reasons = {r.not_judged for r in results if r.rule.stage is Stage.BEHAVIOUR}
    assert reasons == {"scheduled execution is not judged"}


def test_clauses_are_those_of_its_own_text(tmp_path: Path) -> None:
    # without a library, each rule of behaviour is there and not judged
    results = examine(written(BASE_3, tmp_path))
    assert {result.rule.fmi for result in results} == {3}
    places = [place for r in results for place in r.rule.clause.split(", ") if place[0].isdigit()]
    assert set(places) <= {f"{clause} {title}" for clause, title in titles(3).items()}
    assert [r.rule.claim for r in results if "fmi2" in r.rule.claim or "FMI 2" in r.rule.claim] == []
    assert len(results) > len(all_rules()) / 2


def test_findings_have_the_exit_status_the_line_and_the_waivers_of_fmi_2(
    content: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(content, TIME, TWICE, tmp_path)
    assert main([str(path), "--format", "sarif"]) == 1
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert {result["ruleId"] for result in run["results"]} == {"value-references-are-unique"}
    (rule,) = run["tool"]["driver"]["rules"]
    assert rule["help"]["text"] == "FMI 3.0.2, 2.4.7.4 Variable Attributes"
    line = run["results"][0]["locations"][0]["physicalLocation"]["region"]["startLine"]
    assert TIME in content[XML].splitlines()[line - 1]
    waivers = tmp_path / "waivers.toml"
    waivers.write_text(
        '[[waiver]]\nrule = "value-references-are-unique"\nfmu = "changed.fmu"\nreason = "known"\n'
    )
    assert main([str(path), "--waivers", str(waivers)]) == 0


@pytest.mark.parametrize("version", [b"3.1", b"2.1", b"1.0"])
def test_other_versions_are_an_error_and_judged_no_further(
    content: Members, version: bytes, tmp_path: Path
) -> None:
    stated = b'Description fmiVersion="%s"'
    path = changed(content, stated % b"3.0", stated % version, tmp_path)
    expected = f"fmiVersion '{version.decode()}': expected '2.0' or '3.0'"
    assert broken_rules(path) == {"fmi-version": (expected,)}


def test_scalars_of_an_array_share_their_dependencies(tmp_path: Path) -> None:
    """Dependencies of each scalar alone would take memory by the square of the array's size."""
    outputs = FmuFile(written(BASE_3, tmp_path)).judged_as(CO_SIMULATION).unknowns["Outputs"]
    first, second = (unknown for unknown in outputs if unknown.variable.name.startswith("y["))
    assert (first.variable.name, second.variable.name) == ("y[1,1]", "y[2,1]")
    assert first.element is second.element
    assert first.indices is second.indices
