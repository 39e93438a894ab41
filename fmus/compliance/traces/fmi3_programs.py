"""Programs of C and of FMPy that make the calls of a short trace by the functions of FMI 3.0.

A trace has calls of FMI 2.0. The programs make the same calls of FMI 3.0 for them as `fmi3_calls.c`.
"""

import json
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import names_of_fmi3
from fmus.compliance.script import KINDS
from fmus.compliance.traces.replay import CREATE, Call
from fmus.fmi.binding import EARLY_RETURN, EVENT_MODE
from fmus.fmi.fmi3_description import TYPES

SET_UP, _ENTER, _STEP = "fmi2SetupExperiment", "fmi2EnterInitializationMode", "fmi2DoStep"
_EXIT, _UPDATE, _COMPLETED = (
    "fmi2ExitInitializationMode",
    "fmi2NewDiscreteStates",
    "fmi2CompletedIntegratorStep",
)
DERIVATIVE = "fmi2GetDirectionalDerivative"
_OF_NO_VARIABLE = {"Real": "Float64", "String": "String"}  # of other kinds: Int32
_NOT_SET_UP = 0, 0.0, 0.0, 0, 0.0
_SAME = {
    "FMUstate": "FMUState",
    "deSerialize": "deserialize",
    ".getDerivatives": ".getContinuousStateDerivatives",
    "newDiscreteStates": "updateDiscreteStates",
}


class _Transfer(NamedTuple):
    """Scalars of one variable that a call reads or sets: those from an index on, of so many."""

    type: str
    reference: int
    size: int
    first: int
    values: Sequence[Any]


def _transfers(call: Call, fmu: FmuFile) -> list[_Transfer]:
    kind, elements = call.function[7:], fmu.elements or []
    (_, numbers), _, (_, values) = call.arguments
    none = next((number for number in numbers if number >= len(elements)), None)
    if none is not None:
        return [_Transfer(_OF_NO_VARIABLE.get(kind, "Int32"), none, 1, 0, values[:1])]
    # scalars of one array that follow one another have the same difference of index and place
    places = enumerate(zip(numbers, values, strict=True))
    groups = groupby(places, lambda place: (elements[place[1][0]].reference, place[1][0] - place[0]))
    transfers = list[_Transfer]()
    for _, group in groups:
        some = [pair for _, pair in group]
        element = elements[some[0][0]]
        first, of_type = some[0][0] - element.first, TYPES[element.type]
        transfers.append(_Transfer(of_type, element.reference, element.size, first, [x for _, x in some]))
    return transfers


def _derivative(call: Call, fmu: FmuFile) -> tuple[list[int], list[int], list[float], int]:
    """Returns references of unknowns and knowns, seeds and the number of results, all of whole arrays."""
    (_, unknowns), _, (_, knowns), _, (_, seed), _ = call.arguments
    elements, by_number = fmu.elements or [], dict(zip(knowns, seed, strict=True))
    arrays = [[*dict.fromkeys(elements[number] for number in some)] for some in (unknowns, knowns)]
    results, known = arrays
    seeds = [by_number.get(of.first + i, 0.0) for of in known for i in range(of.size)]
    return (
        [of.reference for of in results],
        [of.reference for of in known],
        seeds,
        sum(of.size for of in results),
    )


def own_calls(calls: Sequence[Call]) -> Iterator[Call]:
    """Yields the calls that the FMU gets: what sets an experiment up are arguments of the next one, and the
    status of a step is what it has returned.
    """
    set_up = dict[int, Sequence[Any]]()
    for call in calls:
        if call.function == SET_UP:
            set_up[call.instance] = call.arguments
        elif call.function == _ENTER:
            yield Call(call.instance, _ENTER, set_up.get(call.instance, _NOT_SET_UP), call.status)
        elif not call.function.endswith("Status"):
            yield call


def fmpy_line(call: Call, fmu: FmuFile, usual: str) -> str:
    """Returns the line of a call; usual: the line that calls a method of FMI 2.0."""
    instance, function = f"instances[{call.instance}]", call.function
    if function == _ENTER:
        given, tolerance, start, stops, stop = call.arguments
        shown = repr(tolerance if given else None), repr(start), repr(stop if stops else None)
        return f"{instance}.enterInitializationMode({', '.join(shown)})"
    if function == _STEP:
        t, h, no_going_back = call.arguments
        return f"step({instance}, {t!r}, {h!r}, {bool(no_going_back)})"
    if function == _EXIT and fmu.uses & EVENT_MODE:
        return f"{instance}.exitInitializationMode()\nhandle_event({instance})"
    if function == DERIVATIVE:
        shown = ", ".join(map(str, _derivative(call, fmu)))
        return f"print({instance}.getDirectionalDerivative({shown}))"
    if function[7:] in KINDS:
        return "\n".join(_fmpy_transfer(one, instance, function[4:7]) for one in _transfers(call, fmu))
    for old, new in _SAME.items():
        usual = usual.replace(old, new)
    return usual


def _fmpy_transfer(one: _Transfer, instance: str, verb: str) -> str:
    read = f"{instance}.get{one.type}([{one.reference}], {one.size})"
    part = slice(one.first, one.first + len(one.values))
    if verb == "Get":
        return f"print({read}[{part.start}:{part.stop}])"
    if len(one.values) == one.size:
        return f"{instance}.set{one.type}([{one.reference}], {list(one.values)!r})"
    changed = f"x[{part.start}:{part.stop}] = {list(one.values)!r}"
    return f"x = {read}\n{changed}\n{instance}.set{one.type}([{one.reference}], x)"


FMPY_HELPERS = """

def handle_event(fmu):
    while fmu.updateDiscreteStates()[0]:
        pass
    fmu.enterStepMode()


def step(fmu, t, h, no_going_back):
    needs_event, *others = fmu.doStep(t, h, no_going_back)
    print(needs_event, *others)
    if needs_event and {uses_events}:
        fmu.enterEventMode()
        handle_event(fmu)
"""


# C


def c_lines(call: Call, fmu: FmuFile, usual: Sequence[str]) -> Sequence[str]:
    """Returns the lines of a call; usual: the lines that call a function of FMI 2.0."""
    instance, function = f"instances[{call.instance}]", call.function
    if function in (_STEP, _UPDATE, _COMPLETED):
        numbers = [repr(x) for x in call.arguments if not isinstance(x, list)]
        return [f"{_HELPERS[function]}({', '.join([instance, *numbers])});"]
    if function == _EXIT and fmu.uses & EVENT_MODE:
        return [*map(names_of_fmi3, usual), f"handle_event({instance});"]
    if function == DERIVATIVE:
        *some, count = _derivative(call, fmu)
        kinds = "fmi3ValueReference", "fmi3ValueReference", "fmi3Float64"
        arrays = (f"({kind}[]){{{str(x)[1:-1]}}}, {len(x)}" for kind, x in zip(kinds, some, strict=True))
        given = f"({', '.join([instance, *arrays])}, reals, {count})"
        shown = [f'printf("    %.17g\\n", reals[{i}]);' for i in range(count)]
        name = names_of_fmi3(function)
        return [f'printf("{name}: status %d\\n", CALL({name}){given});', *shown]
    if function[7:] in KINDS:
        lines = (_c_transfer(one, instance, function[4:7]) for one in _transfers(call, fmu))
        return [line for some in lines for line in some]
    return [line if function == CREATE else _of_fmi3(line) for line in usual]


_HELPERS = {_STEP: "step", _UPDATE: "update", _COMPLETED: "completed"}


def _of_fmi3(line: str) -> str:
    line = line.replace("(const char *)", "(const fmi3Byte *)").replace("(fmi2Real[])", "(fmi3Float64[])")
    return names_of_fmi3(line)


def _c_transfer(one: _Transfer, instance: str, verb: str) -> Iterator[str]:
    is_part = len(one.values) < one.size
    yield "{"
    yield f"    fmi3ValueReference reference = {one.reference};"
    yield f"    fmi3{one.type} x[{one.size}] = {{0}};"

    def call(name: str) -> str:
        arguments = f"({instance}, &reference, 1, x, {one.size})"
        return f'    printf("{name}: status %d\\n", CALL({name}){arguments});'

    if verb == "Get" or is_part:
        yield call(f"fmi3Get{one.type}")
    for i, value in enumerate(one.values, one.first):
        if verb == "Set":
            yield f"    x[{i}] = {json.dumps(value)};"
        elif one.type == "String":
            yield f'    printf("    %s\\n", x[{i}]);'
        else:
            yield f'    printf("    %.17g\\n", (double)x[{i}]);'
    if verb == "Set":
        yield call(f"fmi3Set{one.type}")
    yield "}"


_C_HELPERS = """
static void log_message(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category,
                        fmi3String message) {{
    printf("%s\\n", message);
}}

static fmi3Instance create(fmi3String name, fmi3Boolean logging) {{
    return CALL(fmi3Instantiate{interface})(name, {guid}, location, fmi3False, logging,
        {options}NULL, log_message{last});
}}
"""

_C_EVENTS = """
static int update(fmi3Instance a) {{
    fmi3Boolean flags[5] = {{fmi3False}};
    fmi3Float64 next = 0;
    printf("fmi3UpdateDiscreteStates: status %d\\n",
           CALL(fmi3UpdateDiscreteStates)(a, flags, flags + 1, flags + 2, flags + 3, flags + 4, &next));
    printf("    %d %d %d %d %d %.17g\\n", flags[0], flags[1], flags[2], flags[3], flags[4], next);
    return flags[0];
}}
"""

_C_STEPS = """
static void handle_event(fmi3Instance a) {{
    while (update(a)) continue;
    printf("fmi3EnterStepMode: status %d\\n", CALL(fmi3EnterStepMode)(a));
}}

static void step(fmi3Instance a, double t, double h, int no_going_back) {{
    fmi3Boolean flags[3] = {{fmi3False}};
    fmi3Float64 reached = 0;
    printf("fmi3DoStep: status %d\\n",
           CALL(fmi3DoStep)(a, t, h, no_going_back, flags, flags + 1, flags + 2, &reached));
    printf("    %d %d %d %.17g\\n", flags[0], flags[1], flags[2], reached);
    if (!flags[0] || !{uses_events}) return;
    printf("fmi3EnterEventMode: status %d\\n", CALL(fmi3EnterEventMode)(a));
    handle_event(a);
}}
"""

_C_COMPLETED = """
static void completed(fmi3Instance a, int no_going_back) {{
    fmi3Boolean flags[2] = {{fmi3False}};
    printf("fmi3CompletedIntegratorStep: status %d\\n",
           CALL(fmi3CompletedIntegratorStep)(a, no_going_back, flags, flags + 1));
    printf("    %d %d\\n", flags[0], flags[1]);
}}
"""

C_VARIABLES = """
    fmi3Instance instances[{count}];
    fmi3FMUState states[{states}] = {{NULL}};
    fmi3Float64 reals[10000];
    fmi3Byte *bytes = NULL;"""


def c_helpers(fmu: FmuFile) -> str:
    """Returns the functions of the program before `main`."""
    return _C_HELPERS + _C_EVENTS + (_C_COMPLETED if fmu.is_model_exchange else _C_STEPS)


def c_parts(fmu: FmuFile) -> dict[str, str]:
    """Returns the parts of the program that depend on the FMU."""
    uses_events, returns_early = (
        "fmi3True" if fmu.uses & use else "fmi3False" for use in (EVENT_MODE, EARLY_RETURN)
    )
    return {
        "interface": fmu.interface,
        "options": "" if fmu.is_model_exchange else f"{uses_events}, {returns_early}, NULL, 0, ",
        "last": "" if fmu.is_model_exchange else ", NULL",
        "uses_events": uses_events,
        "resources": "UNPACKED/resources/" if fmu.fmi == 3 else "file:///UNPACKED/resources",
    }
