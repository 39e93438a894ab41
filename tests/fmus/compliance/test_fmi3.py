"""Of an FMU of FMI 3.0 the check has the findings of the schema and of FMPy, and no behaviour."""

import json
import re
from pathlib import Path

import pytest

from fmus.compliance.check import NOT_JUDGED, main
from fmus.compliance.examine import examine
from fmus.compliance.rule import Stage, registered
from fmus.generate import builder
from tests.described_fmus import XML, members

from .archives import Members, broken_rules, write

NOTE = "FMI 3.0: behaviour not judged, the description by schema and FMPy alone"
TIME = b'name="time" valueReference="23"'
TWICE = TIME.replace(b"23", b"15")  # that of the disturbance


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> Members:
    """Members of the FMU of a block in FMI 3.0."""
    block = builder.load_block("ExamplePlant")
    return members(builder.build_block(block, tmp_path_factory.mktemp("fmi 3"), fmi=3))


def changed(content: Members, old: bytes, new: bytes, folder: Path) -> Path:
    """The FMU with a place of its description replaced."""
    assert content[XML].count(old) == 1
    return write(content | {XML: content[XML].replace(old, new)}, folder / "changed.fmu")


def test_ours_passes_and_one_line_tells_that_behaviour_is_not_judged(
    content: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(content, tmp_path / "plant.fmu")
    others = [rule for stage in Stage if stage is not Stage.FILE for rule in registered(stage)]
    results = {result.rule.name: result for result in examine(path)}
    not_judged = {name for name, result in results.items() if result.not_judged}
    assert not_judged == {rule.name for rule in others} - {"schema"}
    assert {result.not_judged for result in results.values()} == {"", NOTE}
    assert main([str(path)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "not judged:" in line]
    assert NOTE in line
    assert main([str(path), "--strict"]) == NOT_JUDGED


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'causality="independent"', b'causality="clock"', r"line 55: .*'clock' is not an element"),
        (b'<BaseUnit s="-1" />', b'<BaseUnit S="-1" />', "line 10: .*attribute 'S' is not allowed"),
        (TIME, TWICE, r"FMPy: .*\(line 55\) has the same value reference as variable .disturbance."),
        (b'<Output valueReference="18" dependencies="7 19" />', b"", "FMPy: .*Outputs must have"),
        (b'<Output valueReference="18"', b'<Output valueReference="99"', r"FMPy: .*\(KeyError: 99\)"),
    ],
    ids=["schema", "unit", "reference", "output", "unknown"],
)  # fmt: skip
def test_a_broken_description_is_a_finding_of_the_schema_or_of_fmpy(
    content: Members, old: bytes, new: bytes, message: str, tmp_path: Path
) -> None:
    broken = broken_rules(changed(content, old, new, tmp_path))
    assert list(broken) == ["schema"]
    assert [text for text in broken["schema"] if re.match(message, text)]


def test_findings_have_the_exit_status_the_line_and_the_waivers_of_fmi_2(
    content: Members, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(content, TIME, TWICE, tmp_path)
    assert main([str(path), "--format", "sarif"]) == 1
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert {result["ruleId"] for result in run["results"]} == {"schema"}
    line = run["results"][0]["locations"][0]["physicalLocation"]["region"]["startLine"]
    assert TIME in content[XML].splitlines()[line - 1]
    waivers = tmp_path / "waivers.toml"
    waivers.write_text('[[waiver]]\nrule = "schema"\nfmu = "changed.fmu"\nreason = "known"\n')
    assert main([str(path), "--waivers", str(waivers)]) == 0


@pytest.mark.parametrize("version", [b"3.1", b"2.1", b"1.0"])
def test_other_versions_are_an_error_and_judged_no_further(
    content: Members, version: bytes, tmp_path: Path
) -> None:
    stated = b'Description fmiVersion="%s"'
    path = changed(content, stated % b"3.0", stated % version, tmp_path)
    expected = f"fmiVersion '{version.decode()}': expected '2.0' or '3.0'"
    assert broken_rules(path) == {"fmi-version": (expected,)}
