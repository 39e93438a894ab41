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

from .instance_code import CALLBACKS, LONG_MESSAGE, PROGRAM, SAVED, STEP

HEADERS = FMPY / "c-code"
# these concern doubles that become integers: any double is more than a variable of that type has, and Eva
# keeps NaN where a comparison excludes it; no access depends on such an integer
OF_NUMBERS = "non-finite double value", "overflow in conversion from floating-point", "invalid RHS operand"
# of the loops over internal steps, which have no fixed end, eight states stay apart and others are joined;
# results are kept, as Eva then analyses no function twice from the same state
OPTIONS = (
    "-machdep gcc_x86_64 -eva -warn-special-float none -eva-precision 0 -eva-slevel 50000 "
    "-eva-slevel-function shortest:0,any_text:0,checked:0,data_step:8 "
    "-eva-split-return-function deserialize:0,is_consistent:0,is_flag:0,get_locals:0,data_calculated:full"
)
# arguments that the FMU may read; others have no contents, so that reading them is an alarm
READ = re.compile(
    r"[23][GS]et(Real|Integer|Boolean|Float64|Int32|Int64|RealInputDerivatives|DirectionalDerivative|AdjointDerivative)"
    r"\.(vr|valueRef|vUnk|vKn|known|unknown)|Set(Real|Integer|Boolean|Float64|Int32|Int64|RealInputDerivatives)\.|\.(seed|dvKnown)"
    r"|SetContinuousStates|SetDebugLogging|InstantiateCoSimulation"
)
# arguments whose number counts elements of array variables
NUMBERS = "Values", "Seed", "Sensitivity"
# argument of a type -> expression; others are arrays and numbers
FIXED = {
    "Component": "it",
    "Instance": "it",
    "FMUState": "state",
    "FMUState*": "SOME(&state)",
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
    places = [i for i, one in enumerate(given) if one.kind.endswith(("*", "[]")) and one.kind not in FIXED]
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
            if READ.search(f"{name}.{argument}"):
                fill = value.get(element, f"any_{element}()")
                read = " && ".join(["it", *(f"p_{j}" for j in _read_with(name, places, i))])
                contents += f"if ({read}) for (size_t i = 0; i < {count}; i++) p_{i}[i] = {fill};\n"
            values.append(f"p_{i}")
        else:
            values.append("Frama_C_interval(0, 1)" if kind == "Boolean" else f"any_{kind}()")
    if "eserialize" in name.replace("DeSerialize", "Deserialize"):
        contents = "*(Bytes *)a_1 = any_bytes();\n"
    call, end = f"{name}({', '.join(values)});", "c = NULL;\n" if name.endswith("FreeInstance") else ""
    if "Instantiate" in name:
        call, end = f"c = {call}", "if (c) callback = c->after_step;\n"
    begin = f"Instance *const it = {'c' if 'Instantiate' in name else 'SOME(c)'};\n"
    begin += SAVED if any(one.kind.startswith("FMUState") for one in given) else ""
    begin += STEP if name.endswith("DoStep") else ""
    return f"\n{begin}{sizes}{arrays}{contents}{call}\nFrama_C_show_each_{name}();\n{end}break;\n"


def _read_with(name: str, places: list[int], i: int) -> list[int]:
    """Returns the places of the arrays without which the array at place i is not read."""
    if len(places) <= 2:
        return places
    if len(places) == 4 and i in places[:2]:
        first = i == places[0]
        return [i, places[3 if first == name.endswith("DirectionalDerivative") else 2]]
    return [i]


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
    unrolled = ["-eva-slevel-function", "do_step_with_updates:8"] if fmi == 3 else []
    unrolled += ["-eva-min-loop-unroll", "32"] if is_long else []
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
