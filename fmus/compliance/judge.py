"""Judge rules of behaviour, one after the other, as long as the process of the FMU lives."""

import time
from collections.abc import Iterator, Mapping, Sequence

from fmus.compliance.fmu_file import BrokenMemberError
from fmus.compliance.fmu_process import START_S
from fmus.compliance.probe import Probe
from fmus.compliance.rule import (
    CANNOT_LOAD,
    IS_BROKEN,
    RANDOM,
    NotApplicableError,
    NotJudgedError,
    Result,
    Rule,
    defect,
    messages_of,
)
from fmus.compliance.script import CallError, DefectError
from fmus.fmi.process import ProcessEndedError

FUNDAMENTAL = (
    "library-loads", "instantiates-and-frees", "steps-and-terminates", "frees-in-every-state",
    "runs-are-repeatable",
)  # fmt: skip
"""Without these no behaviour is judged: what else would be found has the same cause."""
ENDED = "the FMU ended the process with"
_RANDOM_RUNS = "runs-are-not-random"
HUNG, SLOW = "the FMU took more than", "the FMU is slow: its calls took more than"


def judged_by_one_process(
    probe: Probe, rules: Sequence[Rule], results: Mapping[str, Result], timeout: float
) -> Iterator[Result]:
    """Results, up to the first rule that the process does not survive, but one at least.

    results: of the rules before; it grows with what this yields
    """
    rule, limit = rules[0], START_S
    try:
        probe.process.calls([])  # it has started
        limit = timeout
        for rule in rules:
            probe.process.deadline = time.monotonic() + limit
            yield _judge(rule, probe, results)
    except TimeoutError:
        if probe.process.hangs(limit):
            yield Result(rule, (f"{HUNG} {limit:g} s in one call{_call(probe)}",))
        else:
            yield Result(rule, not_judged=f"{SLOW} {limit:g} s")
    except ProcessEndedError as ended:
        yield Result(rule, (f"{ENDED} {ended}{_call(probe)}",))
    finally:
        probe.process.close()


def _call(probe: Probe) -> str:
    call = probe.process.call_under_way
    return f", in {call}" if call else ""


def _breach(result: Result) -> str:
    """Returns the reason why what needs a rule is not judged: it is broken, or is not judged itself."""
    if result.messages:
        return f"{result.rule.name}{IS_BROKEN}"
    is_of_all = result.not_judged.startswith(CANNOT_LOAD) or result.not_judged.endswith((IS_BROKEN, RANDOM))
    return result.not_judged if is_of_all else ""


def _judge(rule: Rule, probe: Probe, results: Mapping[str, Result]) -> Result:
    needed = [results[name] for name in (*FUNDAMENTAL, *rule.needs) if name in results]
    reasons = set(filter(None, map(_breach, needed)))
    if others := reasons - {RANDOM}:
        return Result(rule, not_judged=min(others))
    try:
        messages = messages_of(rule.check(probe))
        is_random = RANDOM in reasons and rule.name != _RANDOM_RUNS  # calls that fail or crash are told still
        return Result(rule, not_judged=RANDOM) if is_random else Result(rule, messages)
    except (TimeoutError, ProcessEndedError):
        raise
    except (NotJudgedError, DefectError) as reason:
        return Result(rule, not_judged=str(reason))
    except NotApplicableError as reason:
        return Result(rule, not_applicable=str(reason))
    except (CallError, BrokenMemberError) as error:  # whatever an FMU answers is a finding
        return Result(rule, messages_of([str(error)]))
    except Exception as error:
        return Result(rule, not_judged=defect(error))
