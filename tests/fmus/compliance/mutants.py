"""Changes to an FMU that is run, each with the rule that it breaks. Those of files alone: `tests/mutants`."""

from collections.abc import Callable

from fmus.platforms import host_platform, library_name

from .archives import Members

Patch = dict[str, str]  # what stands in the sources -> what is to stand there
XML, LIBRARY = "modelDescription.xml", library_name("L1Controller", host_platform())

XML_MUTANTS = [
    ("instantiates-and-frees", 'guid="', 'guid="{00000000-0000-0000-0000-000000000000}" was="'),
    ("start-values-are-as-declared", 'start="10.0"', 'start="9.0"'),
    ("variables-can-be-read", 'valueReference="51"', 'valueReference="999"'),
]


def _changed(**changes: bytes | None) -> Callable[[Members], Members]:
    def change(content: Members) -> Members:
        return {k: v for k, v in {**content, **changes}.items() if v is not None}

    return change


def _first_results_off_by_a_percent(content: Members) -> Members:
    path = next(path for path in content if path.endswith("_ref.csv"))
    header, *rows = content[path].decode().splitlines()
    table = [[float(cell) for cell in row.split(",")] for row in rows]
    changed = [[row[0], 1.01 * row[1], *row[2:]] for row in table]
    return content | {path: "\n".join([header, *(",".join(map(repr, row)) for row in changed)]).encode()}


ARCHIVE_MUTANTS = [
    ("runs-on-this-platform", _changed(**{LIBRARY: None})),
    ("reference-results-are-reproduced", _first_results_off_by_a_percent),
]


STEP = 'if (!is_allowed(instance, STEPPING, "fmi2DoStep")) return fmi2Error;'
GLOBALS = "static const char *const TYPE_NAMES[]"
LAST_OF_BECOME = "d->parameters_are_stale = d->outputs_are_stale = 0;"
RESET = "if (!instance) return fmi2Error;\n    instance_reset(instance);"
ALLOCATE = "instance = calloc(1, sizeof *instance"
FREE = "{ free(c); }"
OWN_MEMORY = 'canNotUseMemoryManagementFunctions="true"'
NO_OWN_MEMORY = {OWN_MEMORY: OWN_MEMORY.replace("true", "false")}
RESTORE = "((Instance *)c)->data = snapshot->data;"

C_MUTANTS: dict[str, tuple[str, Patch]] = {
    "another version": ("library-version", {"return fmi2Version;": 'return "2.1";'}),
    "no second instance": (
        "instantiates-and-frees",
        {
            ALLOCATE: (
                "static int count;\n    if (count++) return NULL;\n    " + ALLOCATE
            )
        },
    ),
    "any GUID": ("wrong-guid-is-refused", {"!fmuGUID || strcmp(fmuGUID, MODEL_GUID)": "!fmuGUID"}),
    "another start value": (
        "start-values-are-as-declared",
        {"= VARIABLES[i].start;": "= VARIABLES[i].start * (i == INTERNAL_STEP ? 0.5 : 1);"},
    ),
    "an output that is no number": (
        "outputs-are-finite",
        {LAST_OF_BECOME: LAST_OF_BECOME + " d->value[FIRST_OUTPUT] = NAN;"},
    ),
    "no end": ("steps-and-terminates", {"instance->data.mode = TERMINATED;": "return fmi2Error;"}),
    "a tool by the search path": (
        "needs-no-tool",
        {STEP: STEP + ' if (!*getenv("PATH")) return refuse(instance, fmi2Error, "no tool");'},
    ),
    "a reset of the mode alone": (
        "reset-gives-the-start-values",
        {
            RESET: "if (!instance) return fmi2Error;\n    instance->data.mode = INSTANTIATED;",
            ": DBL_MAX;\n    instance->data.outputs_are_stale = 1;": ": DBL_MAX;",
        },
    ),
    "a reset that forgets a parameter": (
        "reset-gives-the-start-values",
        {RESET: RESET + " instance->data.value[INTERNAL_STEP] *= 0.5;"},
    ),
    "one instance at a time": (
        "several-instances",
        {
            GLOBALS: "static int live;\n" + GLOBALS,
            ALLOCATE: "if (live++) return NULL;\n    " + ALLOCATE,
            FREE: "{ live = 0; free(c); }",
        },
    ),
    "instances that share a count": (
        "runs-are-repeatable",
        {LAST_OF_BECOME: LAST_OF_BECOME + " static int count; d->value[FIRST_OUTPUT] += 1e-9 * count++;"},
    ),
    "one step size": (
        "variable-step-size",
        {STEP: STEP + " static double first; if (!first) first = h; if (h != first) return fmi2Discard;"},
    ),
    "memory leaked": (
        "memory-is-freed",
        {ALLOCATE: "functions->allocateMemory(1, 1);\n    " + ALLOCATE} | NO_OWN_MEMORY,
    ),
    "memory freed that was not given": (
        "memory-is-freed",
        {ALLOCATE: "functions->freeMemory(&instance);\n    " + ALLOCATE} | NO_OWN_MEMORY,
    ),
    "inputs without derivatives": ("allowed-calls-succeed",
        {"if (!is_input(vr[i]))": "if (is_input(vr[i]))"}),
    "an infinite derivative": (
        "output-derivatives-are-finite",
        {"? rate[vr[i] - FIRST_OUTPUT] : 0": "? INFINITY : 0"},
    ),
    "a step that moves one per cent less": (
        "reference-results-are-reproduced",
        {
            "model_output(t + h, next,": (
                "for (int i = 0; i < N_STATES; i++) next[i] -= 0.01 * (next[i] - d->state[i]);\n"
                "    model_output(t + h, next,"
            )
        },
    ),
    "a wrong derivative": ("directional-derivatives", {"dvUnknown[i] = along[": "dvUnknown[i] = 1 + along["}),
    "a state that is not restored": (
        "state-restores",
        {RESTORE: "const Data old = ((Instance *)c)->data;\n    " + RESTORE
         + "\n    memcpy(((Instance *)c)->data.state, old.state, sizeof old.state);"},
    ),
    "a state freed but not forgotten": (
        "freed-state-is-null",
        {"*FMUstate = NULL;\n    return fmi2OK;": "return fmi2OK;"},
    ),
    "a single state": (
        "allowed-calls-succeed",
        {
            "static const Snapshot *own_snap": "static Snapshot only;\nstatic const Snapshot *own_snap",
            "*FMUstate ? *FMUstate : calloc(1, sizeof *snapshot);": "&only;",
        },
    ),
    "a state that is not written over": (
        "state-can-be-saved-often",
        {"snapshot->data = instance->data;": "if (!*FMUstate) snapshot->data = instance->data;"},
    ),
    "a serialised state cut short": (
        "allowed-calls-succeed",
        {"*size = SERIALIZED_SIZE;": "*size = SERIALIZED_SIZE - 8;"},
    ),
    "a serialised state without its states": (
        "serialised-state-restores",
        {
            "*(Snapshot *)*FMUstate = restored;": (
                "memset(restored.data.state, 0, sizeof restored.data.state);\n"
                "    *(Snapshot *)*FMUstate = restored;"
            )
        },
    ),
}  # fmt: skip


FALSE_CLAIMS = [
    ("input-derivatives", 'canInterpolateInputs="false"', 'canInterpolateInputs="true"'),
    ("output-derivatives", 'maxOutputDerivativeOrder="0"', 'maxOutputDerivativeOrder="1"'),
    (
        "directional-derivatives",
        'providesDirectionalDerivative="false"',
        'providesDirectionalDerivative="true"',
    ),
]
