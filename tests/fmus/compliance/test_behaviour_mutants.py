"""Each sentence of FMI that an FMU breaks by what it does is found by its rules and no others."""

import itertools
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from fmus.compliance import actions as do
from fmus.compliance.behaviour import FUNDAMENTAL, behaviour
from fmus.compliance.check import NO_VERDICT, main
from fmus.compliance.differential import AT_FIRST, Start
from fmus.compliance.examine import examine
from fmus.compliance.findings import findings_of, key_of
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Result, Rule, Stage, registered
from fmus.compliance.rules import effects
from fmus.compliance.rules.environment import LEAST_LEAK, growth_of_the_heap
from fmus.compliance.rules.lifecycle import is_of_the_machine
from fmus.compliance.sentences import levels
from fmus.platforms import host_platform, library_name
from tests.described_fmus import XML, members
from tests.mutants.mutant import Mutant, broken_rules, unexpected
from tests.mutants.slaves import CHANGES, EXCHANGE_CHANGES, LEGAL, RUN_MUTANTS, write_slave

from .archives import write

OSCILLATORS = (
    "", "other values are refused", "first order alone", "first order alone, or a warning",
    "tunable locals stay", "logs its calls", "backward differences", "seven digits",
    "begins anew where an input is set",
)  # fmt: skip
EXCHANGES = (
    "",
    "completed steps are not needed",
    "a hidden value of the start",
    "an indicator grows with an input",
)
QUICK = (
    "keeps the pointer to its name",
    "a changed rounding mode",
)
# the beginning of a message that names the cause
FIRST_MESSAGES = {
    "initialization ends in continuous-time mode": (
        "in the state 'event mode': fmi2ExitInitializationMode does not lead into event mode: "
    ),
    "a completed step ends continuous-time mode": (
        "in the state 'continuous-time mode after a completed step': fmi2SetTime returned error"
    ),
    "the size of a state is too small": "fmi2SerializedFMUstateSize is 264, which is too small",
    "bytes are those of the present": "gives other bytes of a saved state",
    "states change where continuous time begins": "by fmi2EnterContinuousTimeMode",
    "a flag of an event is not written": "fmi2NewDiscreteStates returned ok and left a value unwritten",
    "states cannot be set by reference": "fmi2SetReal of x returned error",
    "the process counts its steps": "; only after other instances in the process, found by ",
    "lastSuccessfulTime is not written": "fmi3DoStep returned ok and left lastSuccessfulTime unwritten",
    "an intermediate update before the step": (
        "fmi3DoStep returned ok: the time of an intermediate update is -0.01 s: expected 0..0.01 s"
    ),
    "a pending step has no status": "fmi2DoStep returned pending, then fmi2GetStatus returned error: ",
    "reset takes the environment of the first instance": (
        "the logger was called without the componentEnvironment of its instance"
    ),
    "the start time is ignored": "time is 0 after initialisation with startTime 0.3 s: expected 0.3",
}


def first_of_each_rule(mutants: Sequence[Mutant]) -> Iterator[str]:
    """Yields the names of mutants with a rule that no mutant before has."""
    known = set[str]()
    for mutant in mutants:
        if not mutant.rules <= known:
            yield mutant.name
        known |= mutant.rules


FIRST_OF_RULES = {*first_of_each_rule(RUN_MUTANTS)}


@pytest.mark.parametrize(
    "mutant",
    [m if m.name in QUICK else pytest.param(m, marks=pytest.mark.slow) for m in RUN_MUTANTS],
    ids=lambda mutant: mutant.name,
)
def test_a_mutant_that_runs_is_found_by_its_rules_and_no_others(mutant: Mutant, tmp_path: Path) -> None:
    """Of each rule one mutant is judged by all rules, and others by their own: each check takes seconds.

    Each rule finds the same, numbers aside, where it is judged alone: no rule before has a part in it.
    """
    fmu = mutant.write(tmp_path)
    names = None if mutant.name in FIRST_OF_RULES else mutant.rules
    results = [result for result in examine(fmu, names=names) if result.messages]
    broken = {result.rule.name: result.messages for result in results}
    assert list(unexpected(mutant, broken)) == []
    assert any(FIRST_MESSAGES.get(mutant.name, "") in first for first, *_ in broken.values()), broken
    if names is not None:
        return
    alone = [result for name in broken for result in examine(fmu, names=[name]) if result.messages]
    assert _keys(fmu, alone) == _keys(fmu, results)


def _keys(fmu: Path, results: Sequence[Result]) -> set[str]:
    """Returns the findings without their numbers."""
    return {key_of(finding) for finding in findings_of({fmu: results})}


def test_the_first_messages_are_those_of_mutants() -> None:
    assert FIRST_MESSAGES.keys() <= {mutant.name for mutant in RUN_MUTANTS}


# slave, its mutation if it is legal, flags, changes of the description, and the rules that warn
LEGAL_SLAVES = [
    *(("Behaviour", "", *row) for row in LEGAL),
    *(("Oscillator", "", flags, (), []) for flags in OSCILLATORS),
    ("Fmi3", "", "", (), []),
    ("Oscillator", "legal formats, a new string of the version", "", (), []),
    *(("Exchange", "", flags, EXCHANGE_CHANGES.get(flags, ()), []) for flags in EXCHANGES),
    # 3.2.2: it is active in event mode, and frozen after it
    ("Exchange", "", "a relation of a parameter", (), []),
    # multiples of this size are no sums of it
    ("Exchange", "", "", [('stepSize="0.04"', 'stepSize="0.05"')], []),
    # 2.2.4: other categories enable none of its messages
    ("Oscillator", "", "events are of logAll", [('name="logEvents"', 'name="logAll"')], []),
]


@pytest.mark.parametrize(
    ("slave", "mutation", "flags", "changes", "warned"),
    [LEGAL_SLAVES[0], *(pytest.param(*row, marks=pytest.mark.slow) for row in LEGAL_SLAVES[1:])],
)
def test_a_slave_that_does_nothing_wrong_breaks_no_rule(
    slave: str, mutation: str, flags: str, changes: list[tuple[str, str]], warned: list[str], tmp_path: Path
) -> None:
    """The second one, Oscillator, refuses what is not allowed; Exchange is for model exchange."""
    broken = broken_rules(write_slave(tmp_path, mutation, flags, changes, slave), is_static=False)
    assert set(broken) == set(warned)


def test_sources_of_another_language_beside_a_library_need_not_be_listed(tmp_path: Path) -> None:
    """2.3: names of C sources have to be; the others of this FMU are there to be read."""
    content = members(write_slave(tmp_path)) | {"sources/model.cpp": b""}
    assert broken_rules(write(content, tmp_path / "read.fmu")) == {}


@pytest.mark.slow
def test_directional_derivatives_are_judged_beside_an_input_that_is_at_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays there, as a value at a limit is not set for a difference quotient."""

    def starts(probe: Probe) -> list[Start]:
        (u,) = (v for v in probe.fmu.variables if v.name == "u")
        return [AT_FIRST, Start("", (do.set_values([(u, 0.1)]), do.step()))]

    monkeypatch.setattr(effects, "starts", starts)
    limit = [('<Real start="0.2"/>', '<Real start="0.2" min="0.1"/>')]
    fmu = write_slave(tmp_path, "", "a product with an input", limit, "Exchange")
    rules = "dependencies-are-declared", "directional-derivatives", "directional-derivatives-are-linear"
    assert [result.outcome for result in examine(fmu, names=rules)] == ["passed"] * 3


@pytest.mark.skipif(sys.platform != "linux", reason="patches a library of Linux")
@pytest.mark.parametrize(("name", "other"), [(b"libm.so.6", b"libin.so1"), (b"fesetround", b"fesetrounq")])
def test_a_library_that_does_not_load_is_one_finding_and_no_behaviour_is_judged(
    name: bytes, other: bytes, tmp_path: Path
) -> None:
    content = members(write_slave(tmp_path))
    path = library_name("Behaviour", host_platform())
    assert b"\0" + name + b"\0" in content[path]
    content[path] = content[path].replace(b"\0" + name + b"\0", b"\0" + other + b"\0")
    content[f"{path.rpartition('/')[0]}/libin.so1"] = b""
    results = [r for r in examine(write(content, tmp_path / "unloaded.fmu")) if r.rule.stage == "behaviour"]
    (broken,) = [r for r in results if r.messages]
    assert broken.rule.name == "library-loads"
    assert other.decode() in broken.messages[0]
    assert {r.outcome for r in results if r is not broken} == {"not judged", "not applicable"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="patches a library of Linux")
@pytest.mark.parametrize("is_claimed", [False, True])
def test_a_library_that_lacks_a_function_is_judged_unless_importers_call_it(
    is_claimed: bool, tmp_path: Path
) -> None:
    """2.1.1 demands every function; an importer binds those of the capabilities that are claimed."""
    content = members(write_slave(tmp_path, "any GUID"))
    path, name = library_name("Behaviour", host_platform()), b"\0fmi2GetDirectionalDerivative\0"
    assert name in content[path]
    content[path] = content[path].replace(name, name.replace(b"ve\0", b"es\0"))
    claim = b' providesDirectionalDerivative="true"'
    content[XML] = content[XML] if is_claimed else content[XML].replace(claim, b"")
    broken = broken_rules(write(content, tmp_path / "lacks.fmu"), is_static=False)
    assert "library-exports" in broken
    assert ("wrong-guid-is-refused" in broken) is not is_claimed


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="patches a library of Linux")
def test_a_library_that_this_machine_cannot_load_is_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = members(write_slave(tmp_path))
    path = library_name("Behaviour", host_platform())
    assert b"\0libm.so.6\0" in content[path]
    content[path] = content[path].replace(b"\0libm.so.6\0", b"\0libm.so.9\0")
    fmu = write(content, tmp_path / "unloaded.fmu")
    reason = (
        "this machine cannot load the library: libm.so.9: cannot open shared object file: No such file or "
        "directory; install what it needs, or check it on a machine that has it"
    )
    results = [r for r in examine(fmu) if r.rule.stage == "behaviour"]
    assert {r.outcome for r in results} == {"not judged", "not applicable"}
    assert {r.not_judged for r in results if r.not_judged} == {reason}
    assert main([str(fmu)]) == NO_VERDICT
    printed = capsys.readouterr()
    assert reason in printed.err
    assert printed.out.count(reason) == 1
    assert main([str(fmu), str(write(content | {"../escape": b""}, tmp_path / "wrong.fmu"))]) == 1


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("/lib/libc.so.6: version `GLIBC_2.38' not found (required by /tmp/model.so)", True),
        ("/tmp/binaries/linux64/Behaviour.so: wrong ELF class: ELFCLASS32", True),
        (
            "/tmp/binaries/linux64/Behaviour.so: cannot open shared object file: No such file or directory",
            True,
        ),
        ("Error loading shared library libstdc++.so.6: No such file or directory (needed by model.so)", True),
        ("dlopen(model.dylib, 0x0006): Library not loaded: @rpath/libomp.dylib", True),
        ("mach-o file, but is an incompatible architecture (have 'arm64', need 'x86_64')", True),
        ("[WinError 193] %1 is not a valid Win32 application", True),
        ("Could not find module 'model.dll' (or one of its dependencies)", True),
        ("FMI 3.0 needs a library of fmi3_calls.c, which a wheel has: no compiler", True),
        ("libinside.so: cannot open shared object file: No such file or directory", False),
        ("/tmp/Behaviour.so: undefined symbol: nope", False),
        ("/tmp/Behaviour.so: file too short", False),
    ],
)
def test_a_library_in_the_fmu_and_a_missing_symbol_are_not_of_the_machine(
    message: str, expected: bool
) -> None:
    folder = "binaries/linux64"
    paths = {f"{folder}/Behaviour.so", f"{folder}/libinside.so"}
    fmu = SimpleNamespace(host_library=f"{folder}/Behaviour.so", paths=paths)
    assert is_of_the_machine(cast(FmuFile, fmu), message) is expected


@pytest.mark.parametrize(
    ("steps", "leaks"),
    [
        ([0] * 18 + [1248, 1120] + [0] * 11, False),  # met with an FMU that leaves nothing
        ([80] * 31, True),
        ([0, 160] * 16, True),
        ([4080, -3920] * 16, True),
    ],
    ids=["jumps", "leak", "leak of every other instance", "leak beside what is taken and freed by turns"],
)
def test_a_leak_goes_on_where_other_growth_of_the_heap_stops(steps: list[int], leaks: bool) -> None:
    counts = [{"heap": heap} for heap in itertools.accumulate(steps[:31], initial=100_000)]
    assert (growth_of_the_heap(counts) >= LEAST_LEAK) is leaks


@pytest.mark.slow
@pytest.mark.parametrize("slave", ["Behaviour", pytest.param("Oscillator", marks=pytest.mark.slow)])
def test_blanks_around_booleans_and_numbers_are_no_finding(slave: str, tmp_path: Path) -> None:
    """xs:boolean, xs:int and xs:double collapse them."""
    content = members(write_slave(tmp_path, slave=slave))
    xml = content[XML].decode()
    xml = re.sub(r'\b(min|max|nominal|can[A-Z]\w+)="(.*?)"', r'\1=" \2\n"', xml)
    xml = re.sub(r'(<(?:Real|Integer|Boolean) [^>]*\bstart)="(.*?)"', r'\1=" \2 "', xml)
    assert xml.count(' start=" ') >= 8
    assert broken_rules(write(content | {XML: xml.encode()}, tmp_path / "blanks.fmu"), is_static=False) == {}


def test_a_rule_that_fails_by_itself_is_not_judged_and_no_finding_of_the_fmu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> Iterator[str]:
        raise TypeError("a number has no length")
        yield ""

    def one_rule(stage: Stage) -> tuple[Rule, ...]:
        return (Rule("schema", "", "", stage, broken, lambda _: ""),)

    monkeypatch.setattr("fmus.compliance.examine.registered", one_rule)
    monkeypatch.setattr("fmus.compliance.behaviour.registered", one_rule)
    results = examine(write_slave(tmp_path))
    assert {result.outcome for result in results} == {"not judged"}
    assert all("by a defect of this checker (TypeError: " in result.not_judged for result in results)


@pytest.mark.slow
def test_a_call_that_ends_the_process_is_told_by_the_first_of_the_rules_that_are_as_severe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check(probe: Probe) -> Iterator[str]:
        probe.creates()
        probe.ask("free_of_null")
        yield from ()

    names = ("free-of-null-is-ignored", "wrong-guid-is-refused", "state-restores")
    assert [levels()[name][0] for name in names] == ["deviation", "deviation", "error"]
    rules = tuple(Rule(name, "", "", Stage.BEHAVIOUR, check, lambda _: "") for name in names)
    monkeypatch.setattr("fmus.compliance.behaviour.registered", lambda _: rules)
    first, second, severe = behaviour(FmuFile(write_slave(tmp_path, "free of NULL crashes")), 30.0)
    call = "fmi2FreeInstance(NULL)"
    assert first.messages[0].endswith(f", in {call}")
    assert severe.messages == first.messages
    assert second.not_judged == f"{call} does not return, as free-of-null-is-ignored reports"


@pytest.mark.slow
def test_an_fmu_that_gives_one_instance_in_each_process_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """4.3.1, canBeInstantiatedOnlyOncePerProcess: no rule lacks its instance."""
    names = {*FUNDAMENTAL, "floating-point-control-is-restored"}
    rules = tuple(rule for rule in registered(Stage.BEHAVIOUR) if rule.name in names)
    monkeypatch.setattr("fmus.compliance.behaviour.registered", lambda _: rules)
    path = write_slave(tmp_path, "rounds in a step", "refuses others", CHANGES["once"])
    results = list(behaviour(FmuFile(path), 30.0))
    assert {r.rule.name for r in results if r.messages} == {"floating-point-control-is-restored"}
    assert {r.outcome for r in results} == {"passed", "error"}


@pytest.mark.slow
def test_an_instance_that_is_refused_after_many_others_is_one_finding_and_all_rules_are_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {*FUNDAMENTAL, "instances-follow-each-other", "several-instances"}
    rules = tuple(rule for rule in registered(Stage.BEHAVIOUR) if rule.name in names)
    monkeypatch.setattr("fmus.compliance.behaviour.registered", lambda _: rules)
    results = list(behaviour(FmuFile(write_slave(tmp_path, "no instance after many others")), 30.0))
    assert {r.rule.name for r in results if r.messages} == {"instances-follow-each-other"}
    assert {r.outcome for r in results} == {"passed", "error"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "derivatives of outputs are refused",
        pytest.param("approximations cannot be set", marks=pytest.mark.slow),
    ],
)
def test_a_call_that_fails_is_told_once_and_leaves_what_does_not_make_it_judged(
    name: str, tmp_path: Path
) -> None:
    results = [r for r in examine(write_slave(tmp_path, name)) if r.rule.stage == "behaviour"]
    assert [r.rule.name for r in results if r.messages] == ["allowed-calls-succeed"]
    reasons = {r.not_judged for r in results if r.not_judged}
    assert all(reason.endswith("fails, as allowed-calls-succeed reports") for reason in reasons), reasons
    assert sum(bool(r.not_judged) for r in results) <= 10


@pytest.mark.slow
def test_an_fmu_whose_outputs_follow_the_clock_is_not_judged(tmp_path: Path) -> None:
    results = [r for r in examine(write_slave(tmp_path, "steps follow the clock")) if r.not_judged]
    assert {r.not_judged for r in results} == {"the outputs are random"}
    assert "runs-are-repeatable" in {r.rule.name for r in results}


def test_another_guid_inside_the_library_is_one_finding_with_its_own_words(tmp_path: Path) -> None:
    wrong = (('guid="{5', 'guid="{6'),)
    results = [r for r in examine(write_slave(tmp_path, "", "", wrong)) if r.rule.stage == "behaviour"]
    (broken,) = [r for r in results if r.messages]
    assert broken.rule.name == "instantiates-and-frees"
    assert broken.messages == (
        "fmi2Instantiate returned NULL: expected an instance; the GUID of the library is another one; "
        "the FMU logged: another GUID",
    )
