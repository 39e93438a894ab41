"""An FMU that behaves otherwise than it claims is caught: patched C of our own, and claims that are false."""

import re
from collections.abc import Iterator, Mapping
from ctypes import c_double, c_int, c_uint
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from fmus.compliance import actions as do
from fmus.compliance import behaviour
from fmus.compliance.examine import examine
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.instance_parts import array_of
from fmus.compliance.probe import Probe, Shared
from fmus.compliance.rule import Result, Stage, registered
from fmus.compliance.values import unknown_reference
from fmus.files import extract_archive
from tests.described_fmus import members
from tests.mutants.slaves import write_slave

from .archives import FALSE_CLAIMS, GLOBALS, STEP, Members, patched, write


@pytest.mark.slow
def test_a_discarded_step_whose_termination_has_no_status_of_fmi_is_a_finding(tmp_path: Path) -> None:
    value = "s == fmi2Terminated, fmi2False"
    patch = {STEP: f"{STEP} return fmi2Discard;", value: f"{value[:-9]}fmi2True; return (fmi2Status)-5"}
    (result,) = examine(patched(patch, tmp_path), names=["steps-and-terminates"])
    assert "terminate the simulation" not in result.not_judged


@pytest.mark.parametrize(
    ("with_both_interfaces", "said"),
    [
        (False, r"the FMU ended the process with SIGABRT, in fmi2DoStep\(0\.1, 0\.1, 0\) after fmi2DoStep"),
        pytest.param(
            True,
            r"co-simulation: the FMU ended the process with (SIGSEGV|SIGILL), in fmi2DoStep\(0, 0.0\d+, 0\) "
            "after fmi2ExitInitializationMode",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_crash_is_one_finding_and_what_needs_steps_is_not_judged(
    tmp_path: Path, with_both_interfaces: bool, said: str
) -> None:
    if with_both_interfaces:
        crashing = patched({STEP: STEP + " *(volatile int *)0 = 1;"}, tmp_path)
    else:
        crashing = write_slave(tmp_path, "steps crash")
    results = {result.rule.name: result for result in examine(crashing)}
    assert [name for name, result in results.items() if result.messages] == ["steps-and-terminates"]
    (message,) = results["steps-and-terminates"].messages
    assert re.fullmatch(said, message)
    assert results["several-instances"].outcome == "not judged"
    assert results["several-instances"].not_judged == "steps-and-terminates is broken"


def test_a_hang_is_a_finding_of_the_rule_that_it_stops(tmp_path: Path) -> None:
    least_step = STEP + " if (h > 0 && h < 0.0003) for (;;) pause();"  # of variable-step-size alone
    fmu = patched({GLOBALS: f"#include <unistd.h>\n{GLOBALS}", STEP: least_step}, tmp_path)
    (result,) = examine(fmu, timeout=2, names=["variable-step-size"])
    call = "fmi2DoStep(0.0035, 0.00025, 0) after fmi2DoStep"
    assert result.messages == (f"co-simulation: the FMU took more than 2 s in one call, in {call}",)


@pytest.fixture
def waiting(tmp_path: Path) -> Iterator[Probe]:
    """The probe of an FMU whose steps take 20 ms of the clock and nearly no CPU time."""
    fmu = FmuFile(write_slave(tmp_path, "waits in steps"))
    extract_archive(fmu.path, tmp_path / "unpacked")
    probe = Probe(fmu, tmp_path / "unpacked", Shared())
    probe.process.calls([])  # it has started
    probe.process.allow(30.0)
    yield probe
    probe.process.close()


def test_the_number_of_steps_does_not_depend_on_the_clock(waiting: Probe) -> None:
    """A second of the clock has 50 such steps, the default experiment 100."""
    assert do.steps_of_experiment(waiting) == 100


def test_many_short_calls_are_no_call_that_hangs(waiting: Probe) -> None:
    script = waiting.script(do.begin, do.go_on(100))
    waiting.process.allow(0.5)
    with pytest.raises(TimeoutError):
        waiting.play(script)
    assert not waiting.process.hangs(0.5)


@pytest.mark.slow
def test_a_slow_fmu_is_not_judged_where_it_takes_too_long(tmp_path: Path) -> None:
    slow = STEP + " poll(NULL, 0, 100);"
    path = patched({GLOBALS: f"#include <poll.h>\n{GLOBALS}", STEP: slow}, tmp_path)
    results = {result.rule.name: result for result in examine(path, timeout=2)}
    assert [name for name, result in results.items() if result.messages] == []
    reason = "the FMU is slow: its calls took more than 2 s"
    assert results["steps-and-terminates"].not_judged == reason


@pytest.mark.slow
def test_capabilities_that_are_claimed_but_not_there_are_caught(
    python_built: Mapping[str, Path], tmp_path: Path
) -> None:
    """`test_check` shows that the same FMU breaks none of these rules without the claims."""
    content: Members = members(python_built["ExamplePlant"])
    xml = content["modelDescription.xml"].decode()
    for _, old, new in FALSE_CLAIMS:
        assert old in xml
        xml = xml.replace(old, new)
    content["modelDescription.xml"] = xml.encode()
    path = write(content, tmp_path / "mutant.fmu")
    (result,) = examine(path, names=["allowed-calls-succeed"])
    assert result.messages


@pytest.mark.parametrize(
    ("values", "kind"),
    [([-1, 2], c_int), ([0, 2**32 - 1], c_uint), ([-0.5, 1.0], c_double), ([0, 0.5], c_double)],
)
def test_lists_are_arrays_of_the_type_that_holds_them(values: list[float], kind: type) -> None:
    array = array_of(values, [])
    assert array._type_ is kind
    assert list(array) == values


def test_lists_of_texts_are_arrays_of_their_bytes_and_empty_ones_are_null() -> None:
    strings: list[Any] = []
    array = array_of([b"a\xff".hex(), ""], strings)
    assert list(array) == [b"a\xff", b""] == [buffer.value for buffer in strings]
    assert array_of([], strings) is None


@pytest.mark.parametrize(
    ("used", "expected"), [([], 1000), ([0, 7], 1007), ([0, 1, 2**32 - 1], 2), ([None, 2**32 - 1000], 1)]
)
def test_an_unknown_reference_is_one_of_32_bit_that_no_variable_has(
    used: list[int | None], expected: int
) -> None:
    variables = [SimpleNamespace(reference=reference) for reference in used]
    fmu = SimpleNamespace(variables=variables, elements=None)
    assert unknown_reference(cast(FmuFile, fmu)) == expected


def test_findings_name_their_interface_unless_it_is_co_simulation_alone() -> None:
    rule = registered(Stage.BEHAVIOUR)[0]
    broken, lost = Result(rule, ("it fails",)), Result(rule, not_judged="it is slow")
    co_simulation, model_exchange = "CoSimulation", "ModelExchange"
    joined = behaviour._joined
    assert joined(rule, {co_simulation: broken}).messages == ("it fails",)
    assert joined(rule, {model_exchange: broken}).messages == ("model exchange: it fails",)
    both = joined(rule, {co_simulation: broken, model_exchange: broken})
    assert both.messages == ("co-simulation: it fails", "model exchange: it fails")
    assert joined(rule, {co_simulation: Result(rule), model_exchange: lost}).not_judged == "it is slow"
    other = Result(rule, not_applicable="it has no interface for co-simulation")
    assert not joined(rule, {co_simulation: Result(rule), model_exchange: other}).not_applicable
    of_both = replace(rule, clause="3.2.3 State Machine, 4.2.2 Computation, of it")
    clauses = [
        joined(of_both, {kind: Result(of_both)}).rule.clause for kind in (co_simulation, model_exchange)
    ]
    assert clauses == ["4.2.2 Computation, of it", "3.2.3 State Machine"]
    rule = replace(rule, interface=model_exchange)
    reasons = {kind: Result(rule, not_applicable=f"as {kind}") for kind in (co_simulation, model_exchange)}
    assert joined(rule, reasons).not_applicable == "as ModelExchange"


@pytest.mark.parametrize("mutation", ["no licence", "no licence to initialise"])
def test_a_refusal_for_a_licence_is_not_judged_by_any_rule(mutation: str, tmp_path: Path) -> None:
    results = [r for r in examine(write_slave(tmp_path, mutation)) if r.rule.stage == "behaviour"]
    assert [r.messages for r in results if r.messages] == []
    needing_none = {"library-loads", "instantiates-and-frees"}
    judged = {r.rule.name for r in results if not (r.not_judged or r.not_applicable)}
    assert judged <= needing_none
    reasons = {r.not_judged for r in results if r.not_judged}
    assert all("licen" in reason for reason in reasons), reasons


def test_an_instance_that_a_licence_refuses_after_others_is_tried_alone(tmp_path: Path) -> None:
    fmu = write_slave(tmp_path, "licences for 22 instances")
    (result,) = examine(fmu, names=["values-that-are-set-are-read"])
    assert result.outcome == "passed", result


@pytest.mark.slow
def test_a_finding_that_another_finding_hinders_from_being_repeated_stays(tmp_path: Path) -> None:
    """The tour that finds the unwritten value fails in a new process for what was found meanwhile."""
    value, save = "value[i] = vr[i] < N_VALUES ?", "if (!FMUState) return missing(instance, NAME(GetFMUState)"
    patch = {
        value: f"if (instance->data.mode != INITIALIZATION) {value}",
        save: f"if (instance->data.mode == INSTANTIATED) return ERROR;\n    {save}",
    }
    results = {r.rule.name: r for r in examine(patched(patch, tmp_path), names=["values-are-written"])}
    assert [name for name, result in results.items() if result.messages] == ["values-are-written"]


@pytest.mark.slow
def test_an_instance_of_the_other_interface_changes_nothing(tmp_path: Path) -> None:
    created = "if (instance) instance->log.enabled = log_mask(loggingOn);"
    patch = {
        GLOBALS: f"static int latest;\n{GLOBALS}",
        created: f"latest = fmuType;\n    {created}",
        STEP: f"{STEP} if (!latest) return ERROR;",  # after model exchange, which is 0
    }
    (result,) = examine(patched(patch, tmp_path), names=["several-instances"])
    assert all("beside an instance of the other interface: fmi2DoStep" in m for m in result.messages)
    assert result.messages
