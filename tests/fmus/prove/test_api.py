"""What Eva proves of the functions of FMI in any order, and the faults that it finds."""

from pathlib import Path

import pytest

from fmus.generate.archive import native_members
from fmus.generate.trace import trace

from .api import analysed, functions
from .smallest import SMALLEST

# of the functions, which processes prove side by side
PARTS = 3
# version of FMI, file, its text, the fault in its place, the function that it concerns
MUTANTS = {
    "a value reference behind the last": (
        2, "values.h", "reference < N_VARIABLES &&", "reference <= N_VARIABLES &&", "GetReal",
    ),
    "a value too many": (2, "fmi2.c", "i < nvr; i++) value[i] =", "i <= nvr; i++) value[i] =", "GetReal"),
    "a reference that is not checked": (2, "fmi2.c", "data, vr[i], TYPE", "data, vr[0], TYPE", "SetReal"),
    "a rate of what is no input": (
        2, "derivatives.h", " && reference < INPUTS_FROM_TO[1]", "", "SetRealInputDerivatives",
    ),
    "a state that stays after it is freed": (2, "states.h", "    *FMUState = NULL;\n", "", "FreeFMUstate"),
    "an instance that is used after it is freed": (
        2, "lifecycle.h", "    instance_reset(instance);\n    return OK",
        "    free(instance);\n    instance_reset(instance);\n    return OK", "Reset",
    ),
    "a buffer that is too short by a byte": (
        2, "states.h", "size < SERIALIZED_SIZE", "size < SERIALIZED_SIZE - 1", "SerializeFMUstate",
    ),
    "bytes that end too early": (2, "snapshot.h", "size != SERIALIZED_SIZE", "0", "DeSerializeFMUstate"),
    "no memory for the end of a name": (2, "lifecycle.h", "strlen(name) + 1", "strlen(name)", "Instantiate"),
    "an array that counts as one number": (
        3, "fmi3.c", "expected += FIRST[vr[i] + 1] - first", "expected += 1", "GetFloat64",
    ),
    "a reference behind the last array": (
        3, "fmi3.c", " && reference <= N_REFERENCES", "", "GetFloat64",
    ),
    "numbers of a step behind the last": (
        2, "instance.h", "(cache->last + 1) % N_STEP_SIZES", "cache->last + 1", "DoStep",
    ),
    "inputs that move but are not computed": (
        2, "instance.h", "            data_inputs_at(d, (i + 0.5) * internal, moving);\n", "", "DoStep",
    ),
    "a state that does not fit": (
        2, "instance.h", "(reached, next, N_STATES *", "(reached, next, (N_STATES + 2) *", "DoStep",
    ),
    "a callback that is not given": (3, "updates.h", "instance->after_step ? do_", "1 ? do_", "DoStep"),
    "an instance that is freed in its step": (
        3, "lifecycle.h", "is_allowed(c, OUTSIDE_STEPS, NAME(FreeInstance))", "c", "DoStep",
    ),
    "internal steps that no number counts": (
        3, "updates.h", "count <= MOST_INTERNAL_STEPS ? DONE : TOO_MANY_STEPS;\n    for (double",
        "DONE;\n    for (int", "DoStep",
    ),
    "a result that is not given": (3, "updates.h", " || !lastSuccessfulTime", "", "DoStep"),
    "a seed too many": (
        3, "fmi3.c", "r < FIRST[from[i] + 1]; r++) along", "r <= FIRST[from[i] + 1]; r++) along",
        "GetDirectionalDerivative",
    ),
    "derivatives that do not fit": (
        2, "derivatives.h", "result[N_SEEDS]", "result[N_VALUES]", "GetDirectionalDerivative",
    ),
    "a long message": (2, "log.h", "escaped[2 * MESSAGE_SIZE]", "escaped[2 * MESSAGE_SIZE - 2]", "Terminate"),
}  # fmt: skip


def sources(fmi: int) -> dict[str, str]:
    members = native_members(trace(SMALLEST), fmi=fmi)[1]
    return {Path(path).name: text.decode() for path, text in members.items() if path.endswith((".c", ".h"))}


@pytest.mark.cross
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_call_in_any_order_is_out_of_bounds_or_uses_what_is_freed(
    fmi: int, part: int, tmp_path: Path
) -> None:
    names = [name for name, _ in functions(fmi)][part::PARTS]
    result = analysed(sources(fmi), fmi, tmp_path, names)
    assert not result.alarms
    assert result.reached == {*names}


@pytest.mark.cross
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_message_of_any_length_stays_in_its_memory(fmi: int, tmp_path: Path) -> None:
    """Of 32 characters in place of 1024, to take seconds."""
    assert not analysed(sources(fmi), fmi, tmp_path, {f"fmi{fmi}Terminate"}, is_long=True).alarms


@pytest.mark.cross
@pytest.mark.parametrize(("fmi", "file", "text", "fault", "function"), MUTANTS.values(), ids=MUTANTS)
def test_a_fault_of_the_layer_is_found(
    fmi: int, file: str, text: str, fault: str, function: str, tmp_path: Path
) -> None:
    right = sources(fmi)
    assert text in right[file]
    wrong = right | {file: right[file].replace(text, fault)}
    assert analysed(wrong, fmi, tmp_path, {f"fmi{fmi}{function}"}, is_long=file == "log.h").alarms
