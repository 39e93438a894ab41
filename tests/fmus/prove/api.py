"""A program that calls one function of an FMU, whichever, on an instance with any contents, and Eva's alarms.

It asserts that each function but FreeInstance leaves the instance valid, and its pointers and indices as they
must be; a saved state is valid or NULL. So what Eva proves of one call holds for calls in any order.
"""

import re
import subprocess
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fmus.platforms import FMPY

HEADERS = FMPY / "c-code"
# Eva keeps NaN where a comparison excludes it, so that these of a double that becomes an integer are false;
# no access depends on such an integer
OF_NUMBERS = "non-finite double value", "overflow in conversion from floating-point", "invalid RHS operand"
OPTIONS = (
    "-machdep gcc_x86_64 -eva -eva-no-results -warn-special-float none -eva-precision 2 -eva-slevel 5000 "
    "-eva-slevel-function shortest:0,any_text:0,data_refresh:0,checked:0 "
    "-eva-split-return-function deserialize:0"
)
# arguments that the FMU may read; others have no contents, so that reading them is an alarm
READ = re.compile(
    r"[23][GS]et(Real|Integer|Boolean|Float64|Int32|Int64|RealInputDerivatives|DirectionalDerivative|AdjointDerivative)"
    r"\.(vr|valueRef|vUnk|vKn|known|unknown)|Set(Real|Integer|Boolean|Float64|Int32|Int64|RealInputDerivatives)\.|\.(seed|dvKnown)"
    r"|SetContinuousStates|SetDebugLogging|InstantiateCoSimulation"
)
# arguments whose number counts elements of array variables
NUMBERS = "Values", "Seed", "Sensitivity"
LONG_MESSAGE = "for (size_t i = 0; i < size - 1; i++) text[i] = Frama_C_interval(0, 127); text[size - 1] = 0;"
PROGRAM = """
#include "__fc_builtin.h"
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#define EITHER Frama_C_interval_split(0, 1)
#define SOME(pointer) (Frama_C_interval(0, 1) ? (pointer) : NULL)
double any_double(void);
static int any_text(char *text, size_t size) {
    MESSAGE
    return 0;
}
/* of the C library: bodies, which are more precise than Frama-C's specifications */
static char *copied(char *to, const char *from) {
    size_t i = 0;
    do to[i] = from[i]; while (from[i++]);
    return to;
}
static size_t span(const char *text, const char *set) {
    size_t i = 0;
    while (text[i] && strchr(set, text[i])) i++;
    return i;
}
#define vsnprintf(text, size, format, arguments) any_text(text, size)
#define snprintf(text, size, ...) any_text(text, size)
#define strtod(text, end) any_double()
#define strspn span
#define strcpy copied
#include "fmiFMI.c"
Data any_data(void);
StepCache any_cache(void);
typedef struct { char bytes[SERIALIZED_SIZE + 1]; } Bytes;
Bytes any_bytes(void);
static const size_t LIMITS[] = {
    0, WORDS_PLACE - 1, WORDS_PLACE, SERIALIZED_SIZE - 1, SERIALIZED_SIZE, SERIALIZED_SIZE + 1,
};
DECLARED
static const char *const names[] = {NULL, "", "a", "b", MODEL_GUID, "logAll"};
#define NAME_OF_INSTANCE names[Frama_C_interval_split(0, 2)]
#define ANY_NAME names[Frama_C_interval(0, 5)]
static Instance *c;
CALLBACKS
int main(void) {
    void *state = NULL;
    c = malloc(sizeof *c + 2);
    if (!c) return 0;
    c->data = any_data();
    c->data.face = Frama_C_interval(CO_SIMULATION, EXCHANGE);
    c->data.parameters_are_stale = Frama_C_interval(0, 1);
    c->data.n_steps = Frama_C_interval(0, 1000000000);
    c->step_cache = any_cache();
    c->step_cache.last = Frama_C_interval(0, N_STEP_SIZES - 1);
    c->stop_time = any_double();
    c->log.enabled = Frama_C_interval(0, LOG_ALL);
    c->log.instance = (const char *)(c + 1);
    ((char *)(c + 1))[0] = 'a';
    ((char *)(c + 1))[1] = 0;
    c->log.environment = NULL;
    c->log.logger = LOGGER;
    c->after_step = SOME(after_step);
    c->can_return_early = Frama_C_interval(0, 1);
    switch (Frama_C_interval_split(0, LAST)) {
CALLS
    }
    //@ check api: \\valid(c);
    //@ check api: CO_SIMULATION <= c->data.face <= EXCHANGE;
    //@ check api: 0 <= c->data.parameters_are_stale <= 1;
    //@ check api: 0 <= c->step_cache.last < N_STEP_SIZES;
    //@ check api: c->log.instance == (char *)(c + 1);
    //@ check api: state == \\null || \\valid((Snapshot *)state);
    return 0;
}
"""
SAVED = """if (EITHER) {
            Snapshot *saved = state = malloc(sizeof *saved);
            if (!saved) return 0;
            strcpy(saved->guid, MODEL_GUID);
            saved->data = any_data();
            saved->data.face = Frama_C_interval(CO_SIMULATION, EXCHANGE);
            saved->data.parameters_are_stale = Frama_C_interval(0, 1);
            saved->data.n_steps = Frama_C_interval(0, 1000000000);
        }
        """
CALLBACKS = {
    2: """
static void log_message(void *environment, const char *instance, fmi2Status status, const char *category,
                        const char *message, ...) {}
static void after_step(void *environment, fmi2Status status) {}
static const fmi2CallbackFunctions callbacks = {log_message, calloc, free, after_step, 0};
""",
    3: """
static void log_message(void *environment, fmi3Status status, const char *category, const char *message) {}
/* inside a step, calls change inputs and, by an error, the mode */
static void after_step(void *environment, double t, bool set, bool get, bool finished, bool can_return,
                       bool *early, double *until) {
    for (int i = FIRST_INPUT; i < FIRST_OUTPUT; i++) c->data.value[i] = any_double();
    if (Frama_C_interval(0, 1)) c->data.mode = UPDATE_IN_ERROR;
    *early = Frama_C_interval(0, 1);
    *until = any_double();
}
""",
}
# argument of a type -> expression; others are arrays and numbers
FIXED = {
    "Component": "c",
    "Instance": "c",
    "FMUState": "state",
    "FMUState*": "&state",
    "String": "ANY_NAME",
    "CallbackFunctions*": "SOME(&callbacks)",
    "InstanceEnvironment": "NULL",
    "LogMessageCallback": "SOME(log_message)",
    "IntermediateUpdateCallback": "SOME(after_step)",
    "ClockUpdateCallback": "NULL",
    "LockPreemptionCallback": "NULL",
    "UnlockPreemptionCallback": "NULL",
}


@dataclass(frozen=True)
class Argument:
    """An argument of a function: its type without the standard's prefix, and with `*` or `[]`."""

    kind: str
    name: str


def functions(fmi: int) -> Iterator[tuple[str, list[Argument]]]:
    """Yields each function of a standard with its arguments."""
    text = (HEADERS / f"fmi{fmi}FunctionTypes.h").read_text("utf-8")
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    for name, arguments in re.findall(r"typedef [\w *]+?(fmi\d\w+)TYPE\s*\(([^)]*)\);", text):
        found = re.findall(
            rf"(?:const\s+)?(?:fmi{fmi})?(\w+)\b\s*(\*?)\s*(\w*)\s*(\[\])?\s*(?:,|$)", f"{arguments},"
        )
        given = [Argument(m[0].replace("FMUstate", "FMUState") + m[1] + m[3], m[2]) for m in found]
        yield name, [one for one in given if one.kind != "void"]


def program(fmi: int, only: Collection[str] = (), is_long: bool = False) -> str:
    """Returns the C file, which calls these functions of a standard, or all."""
    called = [(name, given) for name, given in functions(fmi) if not only or name in only]
    kinds = {one.kind.rstrip("*[]") for _, given in called for one in given if one.kind not in FIXED}
    declared = (f"fmi{fmi}{kind} any_{kind}(void);" for kind in sorted(kinds) if kind != "size_t")
    texts = {
        "DECLARED": "\n".join(declared),
        "CALLBACKS": CALLBACKS[fmi],
        "LAST": str(len(called) - 1),
        "CALLS": "\n".join(f"    case {i}: {{{_call(fmi, *one)}    }}" for i, one in enumerate(called)),
        "fmiFMI.c": f"fmi{fmi}.c",
        "MESSAGE": LONG_MESSAGE if is_long else "text[0] = 0;",
        "LOGGER": "log_message" if is_long else "NULL",
    }
    return re.sub(
        r"\bDECLARED|CALLBACKS\b|MESSAGE\b|LOGGER\b|\bLAST|\bCALLS|fmiFMI.c",
        lambda found: texts[found[0]],
        PROGRAM,
    )


def _call(fmi: int, name: str, given: list[Argument]) -> str:
    """Returns C of a call: sizes, pointers, contents of what is read, and the call."""
    is_state = "Serialize" in name or "Deserialize" in name
    n_lists = sum(one.kind == "ValueReference[]" for one in given)
    most = 1 if n_lists > 1 or "Instantiate" in name else 2
    n_arrays = sum(one.kind.endswith("[]") for one in given)
    sizes, arrays, contents, first, values = "", "", "", "", []
    for i, (kind, argument) in enumerate((one.kind, one.name) for one in given):
        if argument == "instanceName":
            values.append("NAME_OF_INSTANCE")
        elif kind in FIXED:
            values.append(FIXED[kind])
        elif kind == "size_t":
            any_size = f"Frama_C_interval_split(0, {most})"
            if is_state:
                any_size = "LIMITS[Frama_C_interval_split(0, 5)]"
            elif argument[1:] in NUMBERS:
                # an array variable has two numbers
                any_size = f"Frama_C_interval_split({first} - !!{first}, 2 * {first})"
            sizes += f"const size_t n_{i} = {any_size};\n"
            first = f"n_{i}" if n_lists == 1 else "1"
            values.append(f"n_{i}")
        elif kind.endswith(("*", "[]")):
            element = kind.rstrip("*[]")
            count = "1" if kind.endswith("*") else _size_of(given, i)
            longest = "sizeof(Bytes)" if is_state else "4"
            c_type = element if element == "size_t" else f"fmi{fmi}{element}"
            # the last element is the last of the memory
            arrays += (
                f"{c_type} a_{i}[{longest}], *const p_{i} = EITHER ? a_{i} + {longest} - {count} : NULL;\n"
            )
            value = {"String": "ANY_NAME", "ValueReference": "Frama_C_interval_split(-1, N_VARIABLES)"}
            value["Boolean"] = "Frama_C_interval(0, 1)"
            fill = (
                f"for (size_t i = 0; i < {count}; i++) p_{i}[i] = {value.get(element, f'any_{element}()')};"
            )
            if READ.search(f"{name}.{argument}"):
                # a call of two arrays refuses both if one is missing
                contents += f"if ({f'p_{i}' if n_arrays > 2 else 'GIVEN'}) {fill}\n"
            values.append(f"p_{i}")
        else:
            values.append("Frama_C_interval(0, 1)" if kind == "Boolean" else f"any_{kind}()")
    if "eserialize" in name.replace("DeSerialize", "Deserialize"):
        contents = "*(Bytes *)a_1 = any_bytes();\n"
    contents = contents.replace("GIVEN", " && ".join(value for value in values if value.startswith("p_")))
    call, end = f"{name}({', '.join(values)});", "return 0;" if name.endswith("FreeInstance") else "break;"
    if "Instantiate" in name:
        call, end = f"c = {call}", "if (!c) return 0;\nbreak;"
    saved = SAVED if any(one.kind.startswith("FMUState") for one in given) else ""
    return f"\n{saved}{sizes}{arrays}{contents}{call}\nFrama_C_show_each_{name}();\n{end}\n"


def _size_of(given: list[Argument], i: int) -> str:
    """Returns the number of elements of an array: the next argument, else the last size before it."""
    sizes = [j for j, one in enumerate(given) if one.kind == "size_t"]
    if given[i].name == "dvUnknown":
        return f"n_{sizes[0]}"
    return f"n_{i + 1 if i + 1 in sizes else max((j for j in sizes if j < i), default=sizes[-1])}"


@dataclass(frozen=True)
class Result:
    """What Eva says: its alarms, and the functions whose end it reaches."""

    alarms: list[str]
    reached: set[str]


def analysed(
    sources: Mapping[str, str], fmi: int, folder: Path, only: Collection[str] = (), is_long: bool = False
) -> Result:
    """Returns what Eva says of the sources of an FMU, by file name."""
    for name, text in sources.items():
        (folder / name).write_text(text.replace("MESSAGE_SIZE = 1024", "MESSAGE_SIZE = 32"))
    (folder / "api.c").write_text(program(fmi, only, is_long))
    include = f"-cpp-extra-args=-I{folder} -I{HEADERS}"
    unrolled = ["-eva-min-loop-unroll", "32"] if is_long else []
    command = ["frama-c", include, *unrolled, *OPTIONS.split(), str(folder / "api.c")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    alarms = (
        " ".join(text.split())
        for text in re.findall(r"\[eva:alarm\] (.+?)(?=\n\[|\n\S|\Z)", done.stdout, re.DOTALL)
    )
    return Result(
        [text for text in dict.fromkeys(alarms) if not any(kind in text for kind in OF_NUMBERS)],
        set(re.findall(r"Frama_C_show_each_(\w+):", done.stdout)),
    )
