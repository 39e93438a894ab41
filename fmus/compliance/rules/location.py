"""Rules of the locations where an FMU finds its resources and other programs."""

from collections.abc import Iterator

from fmus.compliance.comparison import differing, failing_or_differing
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.script import CallError, Reading
from fmus.compliance.values import if_not_claimed

_RESOURCES = "resources/"
_CODE = (".class", ".dll", ".dylib", ".exe", ".jar", ".m", ".py", ".pyc", ".pyd", ".so", ".whl", ".zip")
_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"


def _without_resources(fmu: FmuFile) -> str:
    has_resources = any(n.startswith(_RESOURCES) and not n.endswith("/") for n in fmu.names)
    return "" if has_resources else "it has no resources"


@behaviour_rule(_CREATION)
def resource_locations_of_both_forms(probe: Probe) -> Iterator[str]:
    """The location of the resources may be a URI with or without authority: file:///path and file:/path."""
    usual = probe.ask("resource_location")
    expected = probe.script(location=usual).begin()
    first = expected.run(2)
    expected.play()
    yield from _with_location(probe, usual.replace("file:///", "file:/", 1), first)


@behaviour_rule(_CREATION)
def resource_location_is_decoded(probe: Probe) -> Iterator[str]:
    """The location of the resources is a URI of RFC 3986: %20 in it is a space of the path."""
    script = probe.script().begin()
    first = script.run(2)
    script.play()
    try:
        location = probe.ask("link", "a folder")
    except CallError as error:  # an operating system without links
        raise NotJudgedError(str(error)) from error
    yield from _with_location(probe, location, first)


def _without_data(fmu: FmuFile) -> str:
    if fmu.claims("needsExecutionTool"):
        return "a tool may read its resources"
    has_code = any(n.startswith(_RESOURCES) and n.lower().endswith(_CODE) for n in fmu.names)
    return "its resources hold code, which may be loaded later" if has_code else _without_resources(fmu)


@behaviour_rule("2.3 FMU Distribution (resources)", condition=_without_data)
def resources_are_read_in_initialization(probe: Probe) -> Iterator[str]:
    """Resources that are data are read before fmi2ExitInitializationMode returns: steps need them no more."""
    usual = probe.script().begin()
    expected = usual.run(2)
    usual.play()
    try:
        location = probe.ask("link", "linked")
        script = probe.script(location=location, logging=True).begin()
        script.call("remove_link", location)
        got = script.run(2)
        script.play(keep_going=True)
    except CallError as error:  # an operating system without links, or an FMU that does not follow them
        raise NotJudgedError(str(error)) from error
    yield from failing_or_differing(script, expected, got, "without its resources after initialisation")


def _with_location(probe: Probe, location: str, expected: list[Reading]) -> Iterator[str]:
    script = probe.script(location=location, logging=True).begin()
    got = script.run(len(expected))
    try:
        script.play()
    except CallError as error:
        yield (
            "with the resource location "
            f"{location.split('/', maxsplit=1)[0]}{'/' * location[5:].count('/', 0, 3)}...: {error}"
        )
        return
    yield from differing(expected, got, f"with the resource location {location}")


@behaviour_rule(_FLAGS + ": needsExecutionTool", condition=if_not_claimed("needsExecutionTool"))
def needs_no_tool(probe: Probe) -> Iterator[str]:
    """Without needsExecutionTool, the FMU runs here although no program can be found by the search path."""
    before = probe.ask("set_search_path", "")
    try:
        probe.script(logging=True).begin().step().play()
    finally:
        probe.ask("set_search_path", before)
    yield from ()
