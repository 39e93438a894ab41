"""Random traces, the shortest calls that show a finding, and the programs that make them."""

import subprocess
import sys
from importlib import resources
from pathlib import Path

import fmpy
import pytest

from fmus.compliance.check import main
from fmus.compliance.examine import examine
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe, Shared
from fmus.compliance.rule import Shown
from fmus.compliance.traces.generator import Trace, traces
from fmus.files import extract_archive
from fmus.platforms import host_platform, library_name
from tests.mutants.slaves import RUN_MUTANTS
from tests.shared_builds import slow_but

# mutant -> calls that show it: each is needed
SHORTEST = {
    "reset keeps parameters": [
        "fmi2Instantiate('instance', loggingOn = fmi2False)",
        "fmi2SetReal(gain = 2.02)",
        "fmi2Reset()",
        "fmi2SetupExperiment(0, 0, 0, 0, 0)",
        "fmi2EnterInitializationMode()",
        "fmi2ExitInitializationMode()",
        "fmi2GetReal(gain) is 2.02",
        "fmi2FreeInstance()",
    ],
    "a second state crashes": [
        "fmi2Instantiate('instance', loggingOn = fmi2True)",
        "fmi2SetupExperiment(0, 0, 1.5, 0, 0)",
        "fmi2EnterInitializationMode()",
        "fmi2ExitInitializationMode()",
        "fmi2GetFMUstate(state 0)",
        "fmi2GetFMUstate(state 1)",
    ],
    "another instance name": [
        "fmi2Instantiate('instance', loggingOn = fmi2True)",
        "fmi2FreeInstance()",
    ],
    "a changed working directory": [
        "fmi2Instantiate('instance of the tour', loggingOn = fmi2True)",
        "fmi2FreeInstance()",
    ],
    "step mode is not entered": [
        "fmi3Instantiate('instance', loggingOn = fmi3True, eventModeUsed = fmi3True)",
        "fmi3EnterInitializationMode(0, 0, 0, 0, 0)",
        "fmi3ExitInitializationMode() returned error",
        "fmi3FreeInstance()",
    ],
}


def _mutant(name: str, folder: Path) -> Path:
    (mutant,) = [mutant for mutant in RUN_MUTANTS if mutant.name == name]
    return mutant.write(folder)


def _shown(fmu: Path) -> Shown:
    """Returns the calls of the first finding."""
    return next(shown for result in examine(fmu) for shown in result.shown.values())


def _traces(fmu: Path, seed: int, folder: Path) -> list[Trace]:
    extract_archive(fmu, folder)
    probe = Probe(FmuFile(fmu), folder, Shared(seed=seed))
    try:
        return [*traces(probe)]
    finally:
        probe.process.close()


@pytest.mark.slow
def test_a_seed_gives_the_same_traces_again_and_another_gives_others(tmp_path: Path) -> None:
    fmu = _mutant("reset keeps parameters", tmp_path)
    first, again, other = (_traces(fmu, seed, tmp_path / str(i)) for i, seed in enumerate((1, 1, 2)))
    assert repr(first) == repr(again) != repr(other)
    assert [len(trace.legs) for trace in first] == [7, 7, 7, 7]


@pytest.mark.parametrize("name", slow_but(["reset keeps parameters"], SHORTEST))
def test_a_finding_is_shown_by_calls_each_of_which_it_needs(name: str, tmp_path: Path) -> None:
    shown = _shown(_mutant(name, tmp_path))
    assert [*shown.calls] == SHORTEST[name]
    in_programs = "fmi3True, fmi3False, NULL, 0" in shown.programs["c"], "Used=True" in shown.programs["py"]
    assert in_programs == ("eventModeUsed" in shown.calls[0],) * 2


@pytest.mark.slow
def test_a_finding_about_several_runs_has_the_reason_why_no_calls_show_it(tmp_path: Path) -> None:
    shown = _shown(_mutant("logs categories that were not chosen", tmp_path))
    assert (shown.calls, shown.reason) == ((), "none are known that show it alone")


@pytest.mark.slow
def test_programs_are_written_for_the_findings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu = _mutant("reset keeps parameters", tmp_path)
    assert main([str(fmu), "--reproduce", str(tmp_path / "programs"), "--seed", "3"]) == 1
    name = "Behaviour-reset-gives-the-start-values"
    assert {path.name for path in (tmp_path / "programs").iterdir()} == {f"{name}.c", f"{name}.py"}
    out, err = capsys.readouterr()
    assert f"\n      {SHORTEST['reset keeps parameters'][-2]}\n" in out
    assert "the seed of the random runs was 3" in err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the program of C loads a library as POSIX has it")
@pytest.mark.parametrize(
    "name",
    [
        "states without inputs",
        "derivatives have a history",
        "the second element of an array is lost",
        "derivatives of the states before",
        "a directional derivative moves the state",
    ],
)
def test_both_programs_read_what_the_check_read(name: str, tmp_path: Path) -> None:
    fmu = _mutant(name, tmp_path)
    shown, headers = _shown(fmu), resources.files(fmpy) / "c-code"
    source, script, program = (tmp_path / f"reproduce{end}" for end in (".c", ".py", ""))
    source.write_text(shown.programs["c"], "utf-8")
    script.write_text(shown.programs["py"], "utf-8")
    extract_archive(fmu, tmp_path / "unpacked")
    compiler = [sys.executable, "-m", "ziglang", "cc", source, "-I", headers, "-ldl", "-o", program]
    subprocess.run(list(map(str, compiler)), check=True)
    of_fmi3 = FmuFile(fmu).is_fmi3
    library = tmp_path / "unpacked" / library_name(fmu.stem, host_platform(), 3 if of_fmi3 else 2)
    resources_folder = tmp_path / "unpacked" / "resources"
    resource = f"{resources_folder}/" if of_fmi3 else resources_folder.as_uri()
    runs = [program, library, resource], [sys.executable, script, fmu]
    printed = [
        subprocess.run([*map(str, run)], check=True, capture_output=True, text=True).stdout for run in runs
    ]
    read = [line.rpartition(" is ")[2].strip("[]").split(", ") for line in shown.calls if ") is " in line]
    assert read
    for value in (float(text) for values in read for text in values):
        assert all(any(_number(word) == value for word in text.split()) for text in printed), value


def _number(word: str) -> float | None:
    try:
        return float(word.strip("[](),"))
    except ValueError:
        return None
