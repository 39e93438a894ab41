"""Rules of the settings of its process, which an FMU leaves as they are."""

from collections.abc import Iterator

from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import ARGUMENTS, UNWRITTEN
from fmus.compliance.session import session

_GENERAL = "2.1 FMI Application Programming Interface"
_FLOATING_POINT = "floating-point control"


@behaviour_rule(_GENERAL)
def floating_point_control_is_restored(probe: Probe) -> Iterator[str]:
    """Rounding mode, traps and flushing to zero are as before when a function returns or calls back."""
    named = set()
    for reply in session(probe).script.everything:
        for setting, before, after in reply.changed:
            if setting.startswith(_FLOATING_POINT) and reply.function not in named:
                named.add(reply.function)
                where = setting.removeprefix(_FLOATING_POINT)
                values = f" ({before} before, {after} after)" if before else ""
                yield (
                    f"{reply.function} changes the floating-point control{where}{values}: expected "
                    "it restored"
                )


@behaviour_rule("advice: 2.1, settings that other parts of the process share")
def process_settings_are_restored(probe: Probe) -> Iterator[str]:
    """Working directory, locale, file mode mask, signal handlers and mask, environment, standard streams,
    timers, limits and priority are not changed.
    """
    named = set()
    for reply in session(probe).script.everything:
        for setting, before, after in reply.changed:
            if not setting.startswith((_FLOATING_POINT, ARGUMENTS, UNWRITTEN)) and setting not in named:
                named.add(setting)
                got, expected = after or "as at first", before or "no change"
                yield f"{reply.function} changes the {setting}: {got}, expected {expected}"


@behaviour_rule("2.1.7 Getting and Setting Variable Values")
def arguments_are_not_written(probe: Probe) -> Iterator[str]:
    """Arrays that are constant by their declaration, value references and values to set, stay as they are,
    and so does what lies behind an array of values that are read.
    """
    everything = session(probe).script.everything
    for name in dict.fromkeys(r.function for r in everything for row in r.changed if row[0] == ARGUMENTS):
        yield f"{name} writes into an array that is constant, or behind one: expected that unchanged"


@behaviour_rule("2.1.7 Getting and Setting Variable Values")
def values_are_written(probe: Probe) -> Iterator[str]:
    """fmi2GetXXX that returns ok has written each value."""
    everything = session(probe).script.everything
    for name in dict.fromkeys(r.function for r in everything for row in r.changed if row[0] == UNWRITTEN):
        yield f"{name} returned ok and left a value unwritten: expected each written"


@behaviour_rule("advice: messages belong to the logger")
def nothing_is_printed(probe: Probe) -> Iterator[str]:
    """Nothing is printed to standard output or standard error."""
    printing = {reply.function: reply.printed for reply in session(probe).script.everything if reply.printed}
    for function, count in printing.items():
        yield f"{function} prints {count} bytes to standard output or standard error: expected none"
        return
