"""Mutants that run: one compiled library, which misbehaves by the name in its resources (behaviour.c)."""

from functools import cache, partial
from importlib import resources
from pathlib import Path

import fmpy

from fmus.native.toolchain import compile_library
from fmus.platforms import host_platform, library_name
from tests.mutants.base import replaced, written
from tests.mutants.mutant import Mutant

_FOLDER = Path(__file__).parent
_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_OWN_MEMORY = 'canNotUseMemoryManagementFunctions="true"'
_CALLBACK_MEMORY = ((_OWN_MEMORY, 'canNotUseMemoryManagementFunctions="false"'),)
_MALLOC = "memory-functions-are-callbacks"  # warns: it holds both kinds of memory
ONLY_ONCE = ((_OWN_MEMORY, f'{_OWN_MEMORY} canBeInstantiatedOnlyOncePerProcess="true"'),)
ASYNCHRONOUS = ((_OWN_MEMORY, f'{_OWN_MEMORY} canRunAsynchronuously="true"'),)
_NO_CATEGORIES = (
    (
        '<LogCategories>\n    <Category name="logEvents"/>\n    <Category name="logStatusWarning"/>\n'
        '    <Category name="logStatusDiscard"/>\n    <Category name="logStatusError"/>\n'
        "  </LogCategories>\n",
        "",
    ),
)


@cache
def _library(slave: str) -> bytes:
    headers = resources.files(fmpy) / "c-code"
    source = f"{slave.lower()}.c"
    sources = {name: (headers / name).read_text("utf-8") for name in _HEADERS}
    sources[source] = (_FOLDER / source).read_text("utf-8")
    return compile_library(slave, sources, [source], host_platform())


def write_slave(
    folder: Path,
    mutation: str = "",
    flags: str = "",
    changes: tuple[tuple[str, str], ...] = (),
    slave: str = "Behaviour",
) -> Path:
    """The slave with a mutation; changes: of its model description. Without a mutation it is legal."""
    xml = (_FOLDER / f"{slave.lower()}.xml").read_text("utf-8")
    for old, new in changes:
        xml = replaced(xml, old, new)
    members = {
        "modelDescription.xml": xml.encode(),
        library_name(slave, host_platform()): _library(slave),
        "resources/mutation.txt": f"{mutation}\n{flags}\n".encode(),
    }
    return written(members, folder, f"{slave}.fmu")


def _mutant(
    name: str, clause: str, rules: str, flags: str = "", changes: tuple[tuple[str, str], ...] = ()
) -> Mutant:
    write = partial(write_slave, mutation=name, flags=flags, changes=changes)
    return Mutant(name, clause, frozenset(rules.split()), write, is_static=False)


_PLAIN = [
    ("rounds in a callback", "2.1", "floating-point-control-is-restored"),
    ("rounds in a step", "2.1", "floating-point-control-is-restored"),
    ("a changed rounding mode", "2.1", "floating-point-control-is-restored"),
    ("traps of exceptions", "2.1", "floating-point-control-is-restored"),
    ("a changed working directory", "2.1", "process-settings-are-restored"),
    ("a changed locale", "2.1", "process-settings-are-restored"),
    ("a changed signal handler", "2.1", "process-settings-are-restored"),
    ("a changed file mode mask", "2.1", "process-settings-are-restored"),
    ("prints", "2.1", "nothing-is-printed"),
    ("unknown references are ignored", "2.1.2", "wrong-references-are-refused"),
    ("unknown references are discarded", "2.1.2", "wrong-references-are-refused"),
    ("unknown references of derivatives are discarded", "2.1.3", "refusals-have-legal-statuses"),
    ("constants can be set", "2.1.2", "constants-cannot-be-set"),
    ("values by place", "2.1.2", "values-belong-to-references start-values-are-as-declared"),
    ("Booleans of 2", "2.1.2", "values-belong-to-references"),
    ("a string that is NULL", "2.1.2", "variables-can-be-read"),
    ("a string that is not UTF-8", "2.1.2", "strings-are-utf-8"),
    ("keeps the pointer to a string", "2.1.2", "strings-are-copied reset-gives-the-start-values"),
    ("a status of its own", "2.1.3", "steps-and-terminates"),
    ("pending steps", "2.1.3", "steps-are-not-pending"),
    ("warnings without a message", "2.1.3", "refusals-are-logged"),
    ("silent refusals", "2.1.3", "refusals-are-logged"),
    ("terminate is discarded", "2.1.3", "steps-and-terminates"),
    ("initialisation is discarded", "2.1.3", "steps-and-terminates"),
    ("reading is discarded", "2.1.3", "statuses-are-legal"),
    ("no reset after an error", "2.1.3", "error-leaves-other-instances-unchanged"),
    ("no state after an error", "2.1.3", "state-restores-after-the-end"),
    ("another version", "2.1.4", "library-version"),
    ("another platform of types", "2.1.4", "library-version"),
    ("refuses an instance in silence", "2.1.5", "failed-instantiation-is-logged"),
    ("any GUID", "2.1.5", "wrong-guid-is-refused"),
    ("no instance", "2.1.5", "instantiates-and-frees"),
    ("no second life", "2.1.5", "instantiates-and-frees"),
    ("only one instance at a time", "2.1.5", "several-instances"),
    ("states of all instances", "2.1.5", "runs-are-repeatable"),
    ("steps follow the clock", "4.1.2", "runs-are-not-random"),
    ("an instance after others crashes", "2.1.5", "instances-follow-each-other"),
    ("keeps the pointer to its name", "2.1.5", "arguments-of-instantiation-are-copied"),
    ("keeps the pointer to the location", "2.1.5", "arguments-of-instantiation-are-copied"),
    ("keeps the pointer to the callbacks", "2.1.5", "arguments-of-instantiation-are-copied"),
    ("file:/ is not understood", "2.1.5", "resource-locations-of-both-forms"),
    ("percent signs are not decoded", "2.1.5", "resource-location-is-decoded"),
    (
        "logs although logging is off",
        "2.1.5",
        "no-messages-with-logging-off only-chosen-categories-are-logged "
        "disabled-categories-alone-are-disabled",
    ),
    ("messages without instance name", "2.1.5", "messages-have-the-instance-name"),
    ("another instance name", "2.1.5", "messages-have-the-instance-name"),
    ("no environment", "2.1.5", "messages-have-the-instance-name"),
    ("an undeclared category", "2.1.5", "log-categories-are-declared"),
    ("an undeclared category of a refusal", "2.1.5", "log-category-of-a-refusal-is-declared"),
    ("no category", "2.1.5", "messages-have-a-category"),
    ("a trailing line break", "2.1.5", "messages-have-no-trailing-line-break"),
    ("a variable that is none", "2.1.5", "variables-in-messages-exist"),
    ("a single hash", "2.1.5", "variables-in-messages-exist"),
    ("a status that is none", "2.1.5", "status-of-messages-is-legal"),
    ("memory functions are called", "2.1.5", "memory-functions-may-be-null"),
    ("needs stepFinished", "2.1.5", "optional-callbacks-may-be-null"),
    ("needs the environment", "2.1.5", "optional-callbacks-may-be-null"),
    ("free of NULL crashes", "2.1.5", "free-of-null-is-ignored"),
    ("files stay open", "2.1.5", "resources-are-freed"),
    ("threads stay", "2.1.5", "resources-are-freed"),
    ("memory leaks", "2.1.5", "memory-does-not-grow"),
    (
        "debug logging stays on",
        "2.1.5",
        "no-messages-with-logging-off disabled-categories-alone-are-disabled",
    ),
    ("categories are refused", "2.1.5", "debug-logging-can-be-set"),
    (
        "categories are not enabled",
        "2.1.5",
        "chosen-categories-are-logged disabled-categories-alone-are-disabled",
    ),
    (
        "all categories are enabled",
        "2.1.5",
        "only-chosen-categories-are-logged disabled-categories-alone-are-disabled",
    ),
    (
        "logs categories that were not chosen",
        "2.1.5",
        "only-chosen-categories-are-logged disabled-categories-alone-are-disabled",
    ),
    ("an unknown category crashes", "2.1.5", "reset-works-after-unknown-categories"),
    ("a tolerance is refused", "2.1.6", "tolerance-is-accepted"),
    (
        "an undefined stop time counts",
        "2.1.6",
        "undefined-arguments-are-ignored undefined-tolerance-is-ignored",
    ),
    ("steps beyond the stop time", "2.1.6", "step-beyond-the-stop-time-is-an-error"),
    (
        "the stop time is reached too early",
        "2.1.6",
        "step-beyond-the-stop-time-is-an-error default-experiment-runs",
    ),
    ("initialisation fails", "2.1.6", "steps-and-terminates"),
    ("another start value", "2.1.6", "start-values-are-as-declared"),
    ("values set when instantiated are lost", "2.1.6", "values-that-are-set-are-read"),
    (
        "values set in initialization mode are lost",
        "2.1.6",
        "values-that-are-set-are-read directional-derivatives-in-step-mode",
    ),
    ("approximations cannot be set", "2.1.6", "allowed-calls-succeed"),
    ("final values are lost", "2.1.6", "final-values-after-terminate"),
    ("terminate fails", "2.1.6", "steps-and-terminates"),
    ("reset keeps parameters", "2.1.6", "reset-gives-the-start-values"),
    ("reset keeps the state", "2.1.6", "reset-gives-the-start-values"),
    ("reset keeps the mode", "2.1.6", "reset-in-every-state"),
    ("an output that is no number", "2.1.7", "outputs-are-finite"),
    ("values that were read once do not follow", "2.1.7", "initial-values-follow-what-is-set"),
    ("outputs cannot be read at first", "2.1.7", "allowed-calls-succeed"),
    ("a tool by the search path", "4.3.1", "needs-no-tool"),
    ("empty calls fail", "2.1.7", "empty-calls-succeed"),
    ("states cannot be saved when instantiated", "2.1.8", "allowed-calls-succeed"),
    ("states without continuous states", "2.1.8", "state-restores"),
    ("states without time", "2.1.8", "state-restores"),
    ("states without inputs", "2.1.8", "state-holds-inputs-and-parameters"),
    ("states without parameters", "2.1.8", "state-holds-inputs-and-parameters"),
    ("states without mode", "2.1.8", "state-holds-the-mode"),
    ("states of initialization mode without inputs", "2.1.8", "state-in-initialization-mode"),
    ("states up to rounding", "2.1.8", "state-restores-exactly"),
    ("states are lost when set", "2.1.8", "state-can-be-saved-often"),
    ("a single state", "2.1.8", "state-can-be-saved-often"),
    ("states are not written over", "2.1.8", "state-can-be-saved-often"),
    ("free of a NULL state fails", "2.1.8", "free-of-null-state-is-ignored"),
    ("free of a NULL state is discarded", "2.1.8", "free-of-null-state-is-ignored"),
    ("free of a NULL state crashes", "2.1.8", "free-of-null-state-is-ignored"),
    ("the address of a state stays", "2.1.8", "freed-state-is-null"),
    ("another size each time", "2.1.8", "serialised-state-restores"),
    ("bytes behind the state", "2.1.8", "serialised-state-restores"),
    ("bytes without the state", "2.1.8", "serialised-state-restores"),
    ("bytes are not read", "2.1.8", "serialised-state-restores"),
    ("wrong directional derivatives", "2.1.9", "directional-derivatives"),
    ("the seed is ignored", "2.1.9", "directional-derivatives-are-linear"),
    ("directional derivatives that are not linear", "2.1.9", "directional-derivatives-are-linear"),
    ("derivatives without dependency", "2.1.9", "directional-derivatives-are-zero-without-dependency"),
    ("an item that is none", "2.2.3", "enumerations-are-items start-values-are-as-declared"),
    ("outputs of another range", "2.2.3", "values-are-in-range listed-inputs-move-outputs"),
    ("constants that are not", "2.2.7", "constants-have-their-value"),
    ("another constant", "2.2.7", "constants-have-their-value"),
    ("fixed values that move", "2.2.7", "fixed-values-stay"),
    ("inputs that are forgotten", "2.2.7", "fixed-values-stay"),
    ("time stands still", "2.2.7", "time-is-the-communication-point"),
    ("the start time is ignored", "2.2.7", "time-is-the-communication-point forbidden-calls-are-refused"),
    ("outputs follow what they do not declare", "2.2.8", "initial-dependencies-are-declared"),
    (
        "outputs that do not follow what they declare",
        "2.2.8",
        "initial-dependencies-exist directional-derivatives",
    ),
    (
        "inputs at communication points have no effect",
        "4.1.2",
        "inputs-that-are-set-are-read listed-inputs-move-outputs",
    ),
    ("tunable parameters have no effect", "4.1.2", "inputs-that-are-set-are-read"),
    ("tunable parameters cannot be set", "4.1.2", "allowed-calls-succeed"),
    ("setting loses the state", "4.1.2", "setting-the-same-changes-nothing"),
    ("half a step", "4.2.2", "two-steps-are-one-of-twice-the-size"),
    ("steps at random", "4.2.2", "runs-are-repeatable"),
    ("one step size", "4.3.1", "variable-step-size"),
    ("derivatives of inputs are refused", "4.2.1", "allowed-calls-succeed"),
    ("derivatives of inputs are refused at first", "4.2.1", "input-derivatives-when-instantiated"),
    ("zero derivatives count", "4.2.1", "input-derivatives"),
    ("derivatives of inputs have no effect", "4.2.1", "input-derivatives-have-an-effect"),
    ("derivatives of inputs backwards", "4.2.1", "input-derivatives-have-an-effect"),
    ("derivatives of outputs are refused", "4.2.1", "allowed-calls-succeed"),
    ("wrong derivatives of outputs", "4.2.1", "output-derivatives-are-right"),
    ("derivatives of outputs of 0", "4.2.1", "output-derivatives-are-not-zero"),
    (
        "infinite derivatives of outputs",
        "4.2.1",
        "output-derivatives-are-finite output-derivatives-are-right",
    ),
    ("steps crash", "4.2.2", "steps-and-terminates"),
    ("steps fail", "4.2.2", "steps-and-terminates"),
    ("communication points may not be rounded", "4.2.2", "communication-points-may-be-rounded"),
    ("the flag of no return is refused", "4.2.2", "no-set-state-flag-changes-nothing"),
    ("a discarded step that tells the future", "4.2.3", "variable-step-size"),
    ("another last successful time", "4.2.3", "last-successful-time-is-right"),
    ("terminated without a reason", "4.2.3", "last-successful-time-is-right"),
    ("statuses fail", "4.2.3", "unknown-statuses-are-discarded"),
    ("debug logging is refused when terminated", "4.2.4", "allowed-calls-succeed"),
    ("states cannot be saved when terminated", "4.2.4", "allowed-calls-succeed"),
    ("no state after the end", "4.2.4", "allowed-calls-succeed"),
    ("no reset when terminated", "4.2.4", "reset-in-every-state"),
    ("no reset in initialization mode", "4.2.4", "reset-in-every-state"),
    ("free crashes in initialization mode", "4.2.4", "frees-in-every-state"),
    ("forbidden calls succeed", "4.2.4", "forbidden-calls-are-refused"),
    ("fixed parameters can be set", "4.2.4", "forbidden-calls-are-refused"),
    ("steps of no size", "4.2.2", "forbidden-calls-are-refused"),
    ("calculated values can be set", "4.2.4", "calculated-values-cannot-be-set"),
]
_FLAGGED = [
    (
        "memory is not given back",
        "2.1.5",
        f"memory-is-freed memory-does-not-grow {_MALLOC}",
        "callbacks",
        _CALLBACK_MEMORY,
    ),
    (
        "memory that is not its own is freed",
        "2.1.5",
        f"memory-is-freed {_MALLOC}",
        "callbacks",
        _CALLBACK_MEMORY,
    ),
    (
        "memory that is not asked for",
        "2.1.5",
        f"failed-allocation-is-handled {_MALLOC}",
        "callbacks",
        _CALLBACK_MEMORY,
    ),
    (
        "initialising again leaks",
        "2.1.5",
        f"memory-is-freed {_MALLOC}",
        "callbacks",
        _CALLBACK_MEMORY,
    ),
    ("stepFinished is not called", "2.1.5", "step-finished-is-called", "asynchronous", ASYNCHRONOUS),
    (
        "a step cannot be cancelled",
        "4.2.2",
        "cancelled-step-can-be-left cancelled-step-ends-stepping",
        "asynchronous",
        ASYNCHRONOUS,
    ),
    (
        "categories without LogCategories",
        "2.1.5",
        "log-categories-are-declared log-category-of-a-refusal-is-declared",
        "",
        _NO_CATEGORIES,
    ),
]
BEHAVIOUR_MUTANTS = tuple(_mutant(*entry) for entry in [*_PLAIN, *_FLAGGED])
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_ONE_STEP_SIZE = ((f'{_ANY_STEP}="true"', f'{_ANY_STEP}="false"'),)
_STATES_NO_STEP_SIZE = (*_ONE_STEP_SIZE, (' stepSize="0.1"', ""))
_ALIAS_OF_THE_STATE = (
    (
        '<Unknown index="7" dependencies="4 5"/>\n      <Unknown index="13"',
        '<Unknown index="7" dependencies="4 19"/>\n      <Unknown index="13"',
    ),
    (
        "  </ModelVariables>",
        '<ScalarVariable name="x_alias" valueReference="4" initial="calculated"><Real/></ScalarVariable>\n'
        '<ScalarVariable name="der(x_alias)" valueReference="5" initial="calculated"><Real derivative="19"/>'
        "</ScalarVariable>\n  </ModelVariables>",
    ),
)
_UNUSUAL = (
    ('<Integer start="1"/>', '<Integer start="2147483647"/>'),
    ('<Real start="3.5"/>', '<Real start="0.1"/>'),
    ('initial="approx"><Real start="0.5"/>', 'initial="exact"><Real start="0.5"/>'),
)
_TOLD_OF_THE_UNUSUAL = (
    "constants-have-double-precision",
    "disabled-categories-alone-are-disabled",
    "exact-values-remain-after-initialization",
    "only-chosen-categories-are-logged",
)
LEGAL = (
    ("", (), ()),
    ("callbacks", _CALLBACK_MEMORY, (_MALLOC,)),
    ("asynchronous", ASYNCHRONOUS, ()),
    ("finishes all", ASYNCHRONOUS, ()),
    ("warns", _ALIAS_OF_THE_STATE, ()),
    ("once", ONLY_ONCE, ()),
    ("iterates", (), ()),
    ("internal steps", (), ()),
    ("needs a rate", (), ()),
    ("one step size", _STATES_NO_STEP_SIZE, ()),
    ("discards all", _ONE_STEP_SIZE, ()),
    ("discards late", _ONE_STEP_SIZE, ()),
    ("unusual", _UNUSUAL, _TOLD_OF_THE_UNUSUAL),
)
"""Flags, changes and warnings of the slaves that are legal."""
