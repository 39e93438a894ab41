"""Scalars of FMI 3.0 are set and read in any order, whole arrays and parts of them."""

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import fmi2EventInfo
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, FmuWarning
from fmus.fmi import fmi3
from fmus.fmi.description import describe, of_causality
from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import TRANSFER_TYPE
from fmus.native.toolchain import FMI_HEADERS
from tests.shared_builds import Build

PAIRS = {
    "matrix": ("Float64", "[1,1] 1.5 [1,2] 2.5 [1,3] 3.5 [2,1] 4.5 [2,2] 5.5 [2,3] 6.5"),
    "x": ("Float64", "7.5"),
    "row": ("Float64", "[1] 8.5 [2] 9.5"),
    "single": ("Float32", "[1] 0.25 [2] 0.5"),
    "byte": ("Int8", "[1] -3 [2] 3"),
    "short": ("UInt16", "60000"),
    "integer": ("Int32", "[1] -70000 [2] 70000 [3] 1"),
    "long": ("UInt64", "5"),
    "mode": ("Enumeration", "3"),
    "flag": ("Boolean", "[1] 1 [2] 0 [3] 1"),
    "text": ("String", "[1] one [2] two [3] three"),
    "word": ("String", "four"),
}
RANGES = {"byte": (-128, 127), "short": (0, 65535), "long": (0, 2**31 - 1)}


@pytest.fixture(scope="module")
def path(mirror: Build) -> Path:
    return mirror(PAIRS)


def array_of(variable: ScalarVariable) -> str:
    return re.sub(r"_in.*", "", variable.name)


def values_of(variable: ScalarVariable) -> st.SearchStrategy[Any]:
    name, kind = array_of(variable), variable.type
    if kind == "Real":
        return st.floats(allow_nan=False, width=32 if name == "single" else 64)
    if kind == "String":
        letters = st.characters(exclude_characters="\0", exclude_categories=["Cs"])
        return st.text(letters, max_size=12).map(str.encode)
    if kind == "Boolean":
        return st.booleans()
    return st.integers(*RANGES.get(name, (-(2**31), 2**31 - 1)))


@settings(max_examples=40)
@given(data=st.data())
def test_any_calls_agree_with_a_table(path: Path, data: st.DataObject) -> None:
    """A call may name a scalar twice: the last value stays."""
    description = describe(path)
    inputs = of_causality(description, "input")
    by_transfer: dict[str, list[list[ScalarVariable]]] = {}
    for variable in inputs:
        groups = by_transfer.setdefault(TRANSFER_TYPE[variable.type], [])
        if groups and array_of(groups[-1][-1]) == array_of(variable):
            groups[-1].append(variable)
        else:
            groups.append([variable])
    with FmuInstance("m", path, description) as instance:
        table: dict[int, Any] = {}
        for kind, groups in by_transfer.items():
            references = [v.valueReference for group in groups for v in group]
            table |= zip(references, instance.get_values(kind, references), strict=True)
        assert [table[v.valueReference] for v in inputs] == [start_of(v) for v in inputs]
        for _ in range(data.draw(st.integers(1, 6))):
            kind = data.draw(st.sampled_from([*by_transfer]))
            whole = st.sampled_from(by_transfer[kind])
            part = whole.flatmap(st.sampled_from).map(lambda variable: [variable])
            lists = st.lists(whole | part, min_size=1, max_size=8)
            chosen = [v for group in data.draw(lists) for v in group]
            references = [v.valueReference for v in chosen]
            if data.draw(st.booleans()):
                values = [data.draw(values_of(v)) for v in chosen]
                instance.set_values(kind, references, values)
                table |= zip(references, values, strict=True)
            assert instance.get_values(kind, references) == [table[r] for r in references]


def start_of(variable: ScalarVariable) -> Any:
    text = str(variable.start)
    if variable.type == "String":
        return text.encode()
    return {"true": 1, "false": 0}[text] if variable.type == "Boolean" else float(text)


def test_elements_of_an_array_in_another_order_are_read_by_one_call(path: Path) -> None:
    """A call for each element would transfer the whole array as often as it has elements."""
    description, calls = describe(path), list[int]()
    references = [v.valueReference for v in description.modelVariables if v.name.startswith("matrix_in")]
    kind = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t
    )
    with FmuInstance("m", path, description) as instance:
        addresses: Any = instance.library._addresses  # type: ignore[attr-defined]
        place = fmi3._FUNCTIONS.index("GetFloat64")
        get = kind(int(addresses[place]))
        counted = kind(lambda *arguments: calls.append(arguments[4]) or get(*arguments))
        addresses[place] = ctypes.cast(counted, ctypes.c_void_p).value
        values = instance.get_values("Real", references)
        assert instance.get_values("Real", references[::-1]) == values[::-1]
    assert calls == [6, 6]


def test_a_call_may_be_longer_than_the_variables_and_name_a_string_twice(path: Path) -> None:
    description = describe(path)
    references = {v.name: v.valueReference for v in description.modelVariables}
    matrix = [references[f"matrix_in[{i},{j}]"] for i in (1, 2) for j in (1, 2, 3)]
    texts = [references[f"text_in[{i}]"] for i in (1, 2, 3)]
    with FmuInstance("m", path, description) as instance:
        assert instance.get_values("Real", matrix * 500) == [1.5, 2.5, 3.5, 4.5, 5.5, 6.5] * 500
        read = instance.get_values("String", [*texts, texts[1], *texts, references["word_in"]])
        assert read == [b"one", b"two", b"three", b"two", b"one", b"two", b"three", b"four"]


@pytest.mark.parametrize(("name", "low", "high"), [("byte_in[1]", -128, 127), ("short_in", 0, 65535)])
def test_an_integer_is_set_within_the_range_of_its_type(path: Path, name: str, low: int, high: int) -> None:
    description = describe(path)
    (variable,) = (v for v in description.modelVariables if v.name == name)
    with FmuInstance("m", path, description) as instance:
        for value in (low, high):
            instance.set(variable, value)
            assert instance.get(variable) == value
        for value in (low - 1, high + 1):
            with pytest.raises(FmuError, match=f"fmi3SetU?Int.* {value}: expected {low}..{high}"):
                instance.set(variable, value)
        assert instance.get(variable) == high


def test_a_real_is_set_within_the_range_of_single_precision_or_infinite(path: Path) -> None:
    description = describe(path)
    (_, variable) = (v for v in description.modelVariables if v.name.startswith("single_in"))
    largest = float(np.finfo(np.float32).max)
    with FmuInstance("m", path, description) as instance:
        for value in (largest, -largest, float("inf"), -float("inf"), 1e-300):
            instance.set(variable, value)
            assert instance.get(variable) == np.float32(value)
        for value in (1e300, -1e300, np.nextafter(largest, np.inf), -np.nextafter(largest, np.inf)):
            with pytest.raises(FmuError, match=r"fmi3SetFloat32 .*: expected -3\.40.*e\+38\.\.3\.40.*e\+38"):
                instance.set(variable, float(value))
        assert instance.get(variable) == 0.0


@pytest.mark.parametrize(("macro", "part"), [("AFTER_SET", 1), ("AFTER_GET", 1), ("AFTER_SET", 2)])
def test_a_warning_and_a_discard_of_one_call_are_those_of_all(mirror: Build, macro: str, part: int) -> None:
    """part: how many of two scalars are set; a part of an array is read first, after initialization."""
    function = "fmi3SetFloat64" if macro == "AFTER_SET" else "fmi3GetFloat64"
    pairs = dict.fromkeys(("warned", "discarded"), ("Float64", "[1] 1.5 [2] 2.5"))
    path = mirror(pairs, {f"{macro}(status)": "((void)(status), vr[0] == 1000 ? fmi2Warning : fmi2Discard)"})
    description = describe(path)
    inputs = of_causality(description, "input")
    with FmuInstance("m", path, description) as instance:
        instance.initialise(0.0, None)
        with pytest.warns(FmuWarning, match=f"{function}: it logged nothing"):
            instance.set_all((v, 3.5) for v in inputs[:part])
        with pytest.raises(FmuError, match=f"{function} returned discard"):
            instance.set_all((v, 3.5) for v in inputs[2 : 2 + part])


def test_a_part_of_an_array_is_set_before_initialization_where_no_value_can_be_read(mirror: Build) -> None:
    """2.3.3: the table has fmi3Get when instantiated, the list of allowed calls does not; FMUs refuse it."""
    pairs = {"row": ("Float64", "[1] 1.5 [2] 2.5 [3] 3.5"), "flag": ("Boolean", "[1] 1 [2] 0")}
    path = mirror(pairs, {"AFTER_GET(status)": "(f->slave->data.mode & INSTANTIATED ? fmi2Error : (status))"})
    description = describe(path)
    by_name = {v.name: v for v in description.modelVariables}
    with FmuInstance("m", path, description) as instance:
        for expected in ([1.5, 7.5, 8.5], [6.5, 2.5, 3.5]):
            starts = zip((1.5, 2.5, 3.5), expected, (1, 2, 3), strict=True)
            for number in [i for old, new, i in starts if old != new]:
                instance.set(by_name[f"row_in[{number}]"], expected[number - 1])
            instance.set(by_name["flag_in[2]"], True)
            instance.initialise(0.0, None)
            assert [instance.get(by_name[f"row_in[{i}]"]) for i in (1, 2, 3)] == expected
            assert [instance.get(by_name[f"flag_in[{i}]"]) for i in (1, 2)] == [1, 1]
            assert instance.reset()


def test_a_warning_of_the_first_of_two_calls_is_that_of_both(mirror: Build) -> None:
    pairs = {"double": ("Float64", "1.5"), "single": ("Float32", "2.5")}
    path = mirror(pairs, {"AFTER_SET(status)": "(vr[0] == 1000 ? fmi2Warning : (status))"})
    description = describe(path)
    with FmuInstance("m", path, description) as instance, pytest.warns(FmuWarning, match="fmi3SetFloat64"):
        instance.set_all((v, 3.5) for v in of_causality(description, "input"))


_NESTED = """
import ctypes, sys, pytest
from fmus.native import compiled_library
load, library = compiled_library.load, ctypes.CDLL(sys.argv[1])
compiled_library.load = lambda source, *more: library if "fmi3" in source.name else load(source, *more)
sys.exit(pytest.main(["-q", "-n0", "-p", "no:cacheprovider", sys.argv[2]]))
"""


def test_any_calls_are_clean_under_sanitizers(tool: Callable[[str], str], tmp_path: Path) -> None:
    """The test above, in a process of its own; a report of gcc's sanitizers ends it."""
    source, library = Path(fmi3.__file__).with_name("fmi3_calls.c"), tmp_path / "calls.so"
    sanitizers = "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"
    options = ["-std=c99", "-g", "-O1", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror", *sanitizers]
    gcc = [tool("gcc"), *options, "-Wno-missing-field-initializers", "-Wno-missing-braces"]
    subprocess.run([*gcc, "-I", str(FMI_HEADERS), "-o", str(library), str(source)], check=True)
    find = [tool("gcc"), "-print-file-name=libasan.so"]
    runtime = subprocess.run(find, capture_output=True, text=True, check=True).stdout.strip()
    environment = {"LD_PRELOAD": runtime, "ASAN_OPTIONS": "detect_leaks=0"}
    test = f"{__file__}::test_any_calls_agree_with_a_table"
    command = [sys.executable, "-c", _NESTED, str(library), test]
    done = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout


def test_events_of_model_exchange_have_the_flags_of_fmi_2() -> None:
    """Each flag alone, from functions of FMI 3.0 that stand in for those of an FMU."""
    flag, pointer, number = ctypes.c_bool, ctypes.POINTER(ctypes.c_bool), ctypes.POINTER(ctypes.c_double)
    told: list[bool] = []

    def completed(_: Any, is_final: bool, *flags: Any) -> int:
        return write(flags) if is_final else 3

    def update(_: Any, *results: Any) -> int:
        results[-1][0] = 2.5
        return write(results[:-1])

    def write(flags: Any) -> int:
        for place, value in zip(flags, told, strict=True):
            place[0] = value
        return 0

    of_instance = partial(ctypes.CFUNCTYPE, ctypes.c_int, ctypes.c_void_p)
    functions = {
        "CompletedIntegratorStep": of_instance(flag, pointer, pointer)(completed),
        "UpdateDiscreteStates": of_instance(*[pointer] * 5, number)(update),
    }
    addresses = [ctypes.cast(functions.get(name, 0), ctypes.c_void_p).value or 0 for name in fmi3._FUNCTIONS]
    table, calls = np.array(addresses, np.int64), fmi3._calls()
    assert isinstance(calls, ctypes.CDLL)
    instance = calls.fmi3_behind(None, table.ctypes.data, table.ctypes.data, 0, None, None, 0)
    enters, ends, info = ctypes.c_int(), ctypes.c_int(), fmi2EventInfo()
    both = ctypes.byref(enters), ctypes.byref(ends)
    for told in ([True, False], [False, True]):
        assert calls.fmi2CompletedIntegratorStep(instance, 1, *both) == 0
        assert [enters.value, ends.value] == told
    for i in range(5):
        told = [i == j for j in range(5)]
        assert calls.fmi2NewDiscreteStates(instance, ctypes.byref(info)) == 0
        assert [getattr(info, field[0]) for field in info._fields_] == [*told, 2.5]
    assert calls.fmi2CompletedIntegratorStep(instance, 0, *both) == 3
    assert calls.fmi3_refused(instance) == b"fmi3CompletedIntegratorStep"


def test_a_part_of_an_array_follows_from_its_start_in_states_that_were_saved_when_instantiated() -> None:
    """Functions of FMI 3.0 stand in for those of an FMU, with one array of two elements."""
    size, pointer = ctypes.c_size_t, ctypes.c_void_p
    reals, states = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_void_p)
    read, held = list[bool](), [0.0, 0.0]

    def get(_: Any, __: Any, ___: int, values: Any, count: int) -> int:
        read.append(True)
        values[0], values[1] = held[:count]
        return 0

    def set_values(_: Any, __: Any, ___: int, values: Any, count: int) -> int:
        held[:] = values[:count]
        return 0

    def save(_: Any, state: Any) -> int:
        state[0] = 8
        return 0

    of_instance = partial(ctypes.CFUNCTYPE, ctypes.c_int, pointer)
    transfer = of_instance(pointer, size, reals, size)
    functions = {
        "GetFloat64": transfer(get),
        "SetFloat64": transfer(set_values),
        "GetFMUState": of_instance(states)(save),
        "SetFMUState": of_instance(pointer)(lambda *_: 0),
        "FreeFMUState": of_instance(states)(lambda *_: 0),
        "Reset": of_instance()(lambda *_: 0),
        "EnterInitializationMode": of_instance()(lambda *_: 0),
    }
    addresses = [ctypes.cast(functions.get(name, 0), pointer).value or 0 for name in fmi3._FUNCTIONS]
    elements = np.array([(0, 7, 0, 2, 1.5), (0, 7, 0, 2, 2.5)], fmi3._ELEMENT)
    table, calls, state = np.array(addresses, np.int64), fmi3._calls(), pointer()
    assert isinstance(calls, ctypes.CDLL)
    instance = calls.fmi3_behind(None, table.ctypes.data, elements.ctypes.data, 2, None, None, 0)

    def is_read(number: int) -> bool:
        read.clear()
        assert calls.fmi2SetReal(instance, (ctypes.c_uint32 * 1)(number), 1, (ctypes.c_double * 1)(9.5)) == 0
        return bool(read)

    assert not calls.fmi2GetFMUstate(instance, ctypes.byref(state))
    assert not calls.fmi2SetFMUstate(instance, state)
    assert (is_read(0), held) == (False, [9.5, 2.5])
    assert not calls.fmi2SetFMUstate(instance, state)
    assert is_read(1)  # the state may hold the start of the other one
    for call in (calls.fmi2Reset, calls.fmi2EnterInitializationMode):
        assert not call(instance)
    assert not calls.fmi2SetFMUstate(instance, state)
    assert not is_read(0)
    assert not calls.fmi2FreeFMUstate(instance, ctypes.byref(state))
    assert not calls.fmi2SetFMUstate(instance, state)
    assert is_read(0)
