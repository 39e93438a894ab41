"""A short trace of calls as text, and as programs of C and of FMPy that make the same calls."""

import json
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from itertools import chain, groupby
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Shown, names_of_fmi3
from fmus.compliance.script import KINDS
from fmus.compliance.traces import fmi3_programs
from fmus.compliance.traces.replay import CREATE, FREE, Call, ShortTrace
from fmus.fmi.binding import EARLY_RETURN, EVENT_MODE, status_name

_MOST_LINES = 40  # of a trace in a report
_MOST_STEPS = 3  # in succession
_STATES = 8  # saved states of a program
_READS, _COUNTS = "fmi2Get", "fmi2GetNumberOf"
_SERIALISES = "fmi2SerializeFMUstate"
_VECTORS = "Derivatives", "EventIndicators", "ContinuousStates", "NominalsOfContinuousStates"


def shown(trace: ShortTrace, fmu: FmuFile, finding: str) -> Shown:
    """Returns the lines of a trace that shows a finding, with both programs."""
    trace, fmu = _with_own_bytes(trace), copy(fmu)
    fmu.uses = trace.uses
    told = tuple(lines(trace, fmu))
    if fmu.fmi == 3:
        finding, trace = names_of_fmi3(finding), replace(trace, calls=[*fmi3_programs.own_calls(trace.calls)])
    programs = {"c": c_program(trace, fmu, finding), "py": fmpy_program(trace, fmu, finding)}
    return Shown(told, programs)


def _with_own_bytes(trace: ShortTrace) -> ShortTrace:
    """Returns a trace without the bytes of states that it serialises, which programs have in a variable."""
    owns = any(call.function == _SERIALISES for call in trace.calls)

    def without(call: Call) -> Call:
        if not owns and call.function != _SERIALISES:
            return call
        arguments = [["bytes", ""] if isinstance(x, list) and x[0] == "bytes" else x for x in call.arguments]
        return replace(call, arguments=arguments)

    return replace(trace, calls=[*map(without, trace.calls)])


def lines(trace: ShortTrace, fmu: FmuFile) -> list[str]:
    """Returns a line for each call, with names of variables, and values that were read."""
    names = {(v.base_kind, v.reference): v.name for v in reversed(fmu.variables)}
    several = len({call.instance for call in trace.calls}) > 1
    told = list[str]()
    for (instance, function), group in groupby(trace.calls, lambda call: (call.instance, call.function)):
        some = [f"{instance + 1}: " * several + _line(call, names, trace.uses) for call in group]
        if function == "fmi2DoStep" and len(some) > _MOST_STEPS:
            some = [some[0], f"... {len(some) - 2} more steps", some[-1]]
        told += some
    if len(told) > _MOST_LINES:
        half = _MOST_LINES // 2
        told = [*told[:half], f"... {len(told) - 2 * half} more calls", *told[-half:]]
    return told


def _line(call: Call, names: dict[tuple[str, int | None], str], uses: int) -> str:
    if call.function == CREATE:
        name, logging = call.arguments
        used = ", eventModeUsed = fmi2True" * bool(uses & EVENT_MODE)
        used += ", earlyReturnAllowed = fmi2True" * bool(uses & EARLY_RETURN)
        return f"{CREATE}({name!r}, loggingOn = {'fmi2True' if logging else 'fmi2False'}{used})"
    kind = call.function[7:]
    status = "" if call.status == 0 else f" returned {status_name(call.status)}"
    if kind in KINDS:
        (_, references), _, (_, values) = call.arguments
        shown = [names.get((kind, r), f"reference {r}") for r in references]
        if call.function.startswith(_READS):
            return f"{call.function}({', '.join(shown)}) is {str(values)[1:-1]}{status}"
        pairs = (f"{name} = {value!r}" for name, value in zip(shown, values, strict=True))
        return f"{call.function}({', '.join(pairs)}){status}"
    if call.function == fmi3_programs.DERIVATIVE:
        (_, unknowns), _, (_, knowns), _, (_, seed), (_, values) = call.arguments
        of, by = (", ".join(str(names.get(("Real", r), r)) for r in some) for some in (unknowns, knowns))
        return f"{call.function}(of {of} by {by}, seed {seed}) is {values}{status}"
    place = _place_of_results(call)
    shown = ", ".join(_text(x) for i, x in enumerate(call.arguments) if i != place)
    told = "" if place is None else f" is {call.arguments[place][1]}"
    return f"{call.function}({shown}){told}{status}"


def _text(argument: Any) -> str:
    match argument:
        case ["state" | "state&", slot]:
            return f"state {slot}"
        case ["address" | "bytes", _]:
            return "..."
        case [_, elements]:
            return str(elements)
    return (
        "NULL" if argument is None else f"{argument:.12g}" if isinstance(argument, float) else str(argument)
    )


# C


_C_TYPES = {"c_double": "fmi2Real", "c_uint": "fmi2ValueReference", "c_int": "fmi2Integer"}
_C_RESULTS = {"c_double": ("reals", "%.17g"), "c_char_p": ("texts", "%s"), "c_int": ("numbers", "%d")}
_C_ADDRESSES = {
    "c_ulong": "&size",
    "EventInfo": "&info",
    "c_int": "numbers",
    "c_double": "reals",
    "c_char_p": "texts",
}
_C_OTHERS = {"state": "states[{}]", "state&": "&states[{}]", "bytes": "bytes"}


def c_program(trace: ShortTrace, fmu: FmuFile, finding: str) -> str:
    """Returns a program that loads the library of the unpacked FMU and makes the calls."""
    lines, helpers, variables = map(_c_lines, trace.calls), _C_HELPERS, _C_VARIABLES
    if fmu.fmi == 3:
        lines = (fmi3_programs.c_lines(call, fmu, [*_c_lines(call)]) for call in trace.calls)
        helpers, variables = fmi3_programs.c_helpers(fmu), fmi3_programs.C_VARIABLES
    return f"{_C_HEAD}{helpers}{_C_MAIN}{variables}{_C_END}".format(
        **fmi3_programs.c_parts(fmu),
        finding=finding.replace("*/", "* /"),
        fmi=fmu.fmi,
        library=fmu.host_library,
        guid=json.dumps(fmu.root.get("guid", "")),
        count=_count(trace),
        states=_STATES,
        body="\n".join(f"    {line}" for line in chain(*lines)),
    )


def _count(trace: ShortTrace) -> int:
    """Returns the number of instances."""
    return max(call.instance for call in trace.calls) + 1


def _c_lines(call: Call) -> Iterator[str]:
    """Yields the lines that call a function of FMI 2.0."""
    if call.function in (CREATE, FREE):
        instance, arguments = f"instances[{call.instance}]", ", ".join(map(json.dumps, call.arguments))
        created, freed = f"{instance} = create({arguments});", f"CALL({FREE})({instance});"
        yield created if call.function == CREATE else freed
        return
    place = _place_of_results(call)
    kind, content = call.arguments[place] if place is not None else ("c_int", [])
    buffer, form = _C_RESULTS[kind]
    arguments = [buffer if i == place else _c_argument(x) for i, x in enumerate(call.arguments)]
    called = ", ".join([f"instances[{call.instance}]", *arguments])
    yield f'printf("{call.function}: status %d\\n", CALL({call.function})({called}));'
    for i in range(len(content)):
        yield f'printf("    {form}\\n", {buffer}[{i}]);'
    if call.function == "fmi2SerializedFMUstateSize":
        yield "bytes = malloc(size);"
    if call.function.startswith(_COUNTS):
        yield 'printf("    %zu\\n", size);'


def _place_of_results(call: Call) -> int | None:
    """Returns which argument is the array of results of a function that reads, if it has one."""
    arrays = [i for i, x in enumerate(call.arguments) if isinstance(x, list) and isinstance(x[1], list)]
    return arrays[-1] if arrays and call.function.startswith(_READS) else None


def _c_argument(argument: Any) -> str:
    if not isinstance(argument, list):
        return "NULL" if argument is None else repr(argument)
    kind, content = argument
    if kind == "bytes" and content:
        return '(const char *)"' + "".join(f"\\x{byte:02x}" for byte in bytes.fromhex(content)) + '"'
    if kind in _C_OTHERS:
        return _C_OTHERS[kind].format(content)
    if kind == "address":
        return _C_ADDRESSES[content]
    elements = ", ".join(map(json.dumps, content))
    return f"({_C_TYPES.get(kind, 'fmi2String')}[]){{{elements}}}"


_C_HEAD = """\
/* {finding}
 * cc reproduce.c -I HEADERS_OF_FMI -ldl -o reproduce && ./reproduce UNPACKED/{library} {resources}
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi{fmi}Functions.h"

static void *library;
static char *location;
#define CALL(name) ((name##TYPE *)dlsym(library, #name))
"""

_C_HELPERS = """
static void log_message(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                        fmi2String format, ...) {{
    va_list arguments;
    va_start(arguments, format);
    vprintf(format, arguments);
    printf("\\n");
    va_end(arguments);
}}

static fmi2CallbackFunctions callbacks = {{log_message, calloc, free, NULL, NULL}};

static fmi2Component create(fmi2String name, fmi2Boolean logging) {{
    return CALL(fmi2Instantiate)(name, fmi2{interface}, {guid}, location, &callbacks, fmi2False, logging);
}}
"""

_C_MAIN = """
int main(int argc, char **argv) {{"""

_C_VARIABLES = """
    fmi2Component instances[{count}];
    fmi2FMUstate states[{states}] = {{NULL}};
    fmi2Real reals[10000];
    fmi2Integer numbers[10000];
    fmi2String texts[10000];
    fmi2EventInfo info;
    char *bytes = NULL;"""

_C_END = """
    size_t size = 0;
    if (argc < 3) return printf("expected a library and {resources}\\n"), 1;
    location = argv[2];
    if (!(library = dlopen(argv[1], RTLD_NOW))) return printf("%s\\n", dlerror()), 1;
{body}
    return 0;
}}
"""


# FMPy


def fmpy_program(trace: ShortTrace, fmu: FmuFile, finding: str) -> str:
    """Returns a program that makes the calls by FMPy."""
    kind = f"FMU{fmu.fmi}{'Model' if fmu.is_model_exchange else 'Slave'}"
    element = fmu.root.find("ModelExchange" if fmu.is_model_exchange else "CoSimulation")
    identifier = element.get("modelIdentifier") if element is not None else ""
    uses_events, returns_early = bool(fmu.uses & EVENT_MODE), bool(fmu.uses & EARLY_RETURN)
    lines, helpers = map(_fmpy_line, trace.calls), ""
    if fmu.fmi == 3:
        lines = (fmi3_programs.fmpy_line(call, fmu, _fmpy_line(call)) for call in trace.calls)
        helpers = fmi3_programs.FMPY_HELPERS.format(uses_events=uses_events)
    return _FMPY_PROGRAM.format(
        finding=finding,
        kind=kind,
        guid=fmu.root.get("guid", ""),
        identifier=identifier,
        fmi=fmu.fmi,
        helpers=helpers,
        options=", eventModeUsed=True" * uses_events + ", earlyReturnAllowed=True" * returns_early,
        body="\n".join(lines),
    )


_FMPY_PROGRAM = '''\
"""{finding}

python reproduce.py FMU
"""
import sys
from ctypes import c_double

from fmpy import extract
from fmpy.fmi{fmi} import {kind}

folder = extract(sys.argv[1])
instances, states = {{}}, {{}}


def create(name, logging):
    fmu = {kind}(guid={guid!r}, unzipDirectory=folder, modelIdentifier={identifier!r}, instanceName=name)
    fmu.instantiate(loggingOn=bool(logging){options})
    return fmu
{helpers}

{body}
'''


_FMPY_LINES = {
    CREATE: "{fmu} = create({0}, {1})",
    FREE: "{fmu}.freeInstance()",
    "fmi2SetupExperiment": "{fmu}.setupExperiment({0}, {1}, {2})",
    "fmi2SetDebugLogging": "{fmu}.setDebugLogging({0}, {2})",
    "fmi2GetFMUstate": "states[{0}] = {fmu}.getFMUstate()",
    "fmi2SetFMUstate": "{fmu}.setFMUstate(states[{0}])",
    "fmi2FreeFMUstate": "{fmu}.freeFMUstate(states[{0}])",
    "fmi2SerializedFMUstateSize": "# serializeFMUstate asks for the size",
    "fmi2SerializeFMUstate": "content = {fmu}.serializeFMUstate(states[{0}])",
    "fmi2DeSerializeFMUstate": "states[{2}] = {fmu}.deSerializeFMUstate(bytes.fromhex({0}) or content)",
    "fmi2GetDirectionalDerivative": "print({fmu}.getDirectionalDerivative({0}, {2}, {4}))",
    "fmi2SetRealInputDerivatives": "{fmu}.setRealInputDerivatives({0}, {2}, {3})",
    "fmi2GetRealOutputDerivatives": "print({fmu}.getRealOutputDerivatives({0}, {2}))",
    "fmi2SetContinuousStates": "{fmu}.setContinuousStates((c_double * {1})(*{0}), {1})",
    "fmi2NewDiscreteStates": "print({fmu}.newDiscreteStates())",
    "fmi2CompletedIntegratorStep": "print({fmu}.completedIntegratorStep({0}))",
    **{f"{_COUNTS}{kind}": f"print({{fmu}}.getNumberOf{kind}())" for kind in _VECTORS[1:3]},
    **{f"fmi2Get{kind}Status": f"print({{fmu}}.get{kind}Status({{0}}))" for kind in ("", *KINDS)},
    **{f"fmi2Set{kind}": f"{{fmu}}.set{kind}({{0}}, {{2}})" for kind in KINDS},
    **{f"fmi2Get{kind}": f"print({{fmu}}.get{kind}({{0}}))" for kind in KINDS},
    **{
        f"fmi2Get{kind}": f"x = (c_double * {{1}})()\n{{fmu}}.get{kind}(x, {{1}})\nprint(list(x))"
        for kind in _VECTORS
    },
}


def _fmpy_line(call: Call) -> str:
    """Returns the line that calls a method of FMI 2.0."""
    plain = [x[1] if isinstance(x, list) else x for x in call.arguments]
    if call.function == "fmi2SetupExperiment":
        given, tolerance, start, stops, stop = plain
        plain = [tolerance if given else None, start, stop if stops else None]
    name = call.function[4].lower() + call.function[5:]
    fmu, shown = f"instances[{call.instance}]", [repr(x) for x in plain]
    if template := _FMPY_LINES.get(call.function):
        return template.format(*shown, fmu=fmu)
    return f"{fmu}.{name}({', '.join(shown)})"
