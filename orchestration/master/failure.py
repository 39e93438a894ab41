"""What the loop reports, in words."""

from collections.abc import Mapping

from orchestration.errors import FmuError, OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.master.loop import CONNECTION, FAILURE, STATUS, STEP, WHICH, WHO, Wiring
from orchestration.master.wiring import Loom

_DISCARD = 2  # of fmi2Status


def is_discarded_step(w: Wiring) -> bool:
    return w.report[FAILURE] == STEP and w.report[STATUS] == _DISCARD


def explain(loom: Loom, components: Mapping[str, FmuInstance], t: float) -> OrchestrationError:
    """The failure that the loop reports, as an error to raise; t: begin of the step under way [s]."""
    report = loom.wiring.report
    which = int(report[WHICH])
    if report[FAILURE] == CONNECTION:
        source, target = loom.links[which]
        value = loom.wiring.links.value[which]
        return OrchestrationError(
            f"{source} is {value:g} at t = {t:.9g} s: expected a finite number, as it goes to {target}"
        )
    component = list(components.values())[report[WHO]]
    component.time = t
    call = loom.functions[int(report[FAILURE])][which]
    try:
        component.check_status(call, int(report[STATUS]))
    except FmuError as error:
        return error
    return FmuError(component.name, t, call, "an error that it took back", [])


def judge_warnings(loom: Loom, components: Mapping[str, FmuInstance], failed: bool) -> None:
    """Let Python warn of what components warned of in the loop; what failed there is explained elsewhere."""
    w = loom.wiring
    for c, component in enumerate(components.values()):
        if failed and c == w.report[WHO]:
            continue
        if w.warned[c] or component.log:
            call = loom.functions[int(w.warned[c])][0] if w.warned[c] else "fmi2DoStep"
            component.time = float(w.warned_at[c] if w.warned[c] else w.begun[c])
            component.check_status(call, int(w.warned[c] > 0))
            w.warned[c] = 0
