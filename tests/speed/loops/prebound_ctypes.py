"""The FMUs' functions called from Python with arguments that are bound before the loop, nothing recorded."""

from ctypes import c_double, c_int, c_size_t, c_uint32, c_void_p

from tests.speed.loops.instances import loaded
from tests.speed.pair import STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    with loaded(pair) as (first, second, signal, level):
        a, b = (c_void_p(int(each.component or 0)) for each in (first, second))
        inputs, outputs, one = (c_uint32 * 1)(signal), (c_uint32 * 1)(level), c_size_t(1)
        of_a, of_b = (c_double * 1)(), (c_double * 1)()
        h, never_back = c_double(STEP_SIZE), c_int(1)
        set_a, set_b = first.dll.fmi2SetReal, second.dll.fmi2SetReal
        get_a, get_b = first.dll.fmi2GetReal, second.dll.fmi2GetReal
        step_a, step_b = first.dll.fmi2DoStep, second.dll.fmi2DoStep
        bad = get_a(a, outputs, one, of_a) | get_b(b, outputs, one, of_b)
        for i in range(steps):
            t = c_double(i * STEP_SIZE)
            bad |= set_a(a, inputs, one, of_b) | set_b(b, inputs, one, of_a)
            bad |= step_a(a, t, h, never_back) | step_b(b, t, h, never_back)
            bad |= get_a(a, outputs, one, of_a) | get_b(b, outputs, one, of_b)
        if bad:
            raise RuntimeError("a call was refused")
        return of_a[0]
