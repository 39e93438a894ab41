"""One session with an FMU: the functions that it supports, in the states instantiated to terminated that
allow them, with a tolerance and a stop time; after fmi2Reset a run with neither.
"""

from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    continuous_reals,
    readable_in_initialization,
    references_of,
    set_input_derivatives,
    settable_before,
    settable_in_initialization,
    settable_while_stepping,
    start_values,
)  # fmt: skip
from fmus.compliance.variable import Variable

NAME = "instance of the session"
TOLERANCE, LARGE_TOLERANCE = 1e-5, 1e-3


class Session:
    """The played session with its replies and readings."""

    def __init__(self, probe: Probe, **options: object) -> None:
        self.probe, self.fmu = probe, probe.fmu
        self.readings: list[Reading] = []
        self.script = probe.script(name=NAME, **options)
        self._write()
        self.script.play(keep_going=True)

    def _write(self) -> None:
        script = self.script
        self._log()
        self._states(0)
        self._set(settable_before(self.fmu))
        tolerance = TOLERANCE if run_with_tolerance(self.probe).succeeded else None
        script.set_up(stop=self.probe.point(1000), tolerance=tolerance)
        script.enter_initialization_mode()
        self._log()
        self._states(1)
        self._set(settable_in_initialization(self.fmu))
        self._input_derivatives()
        self.readings.append(script.read(readable_in_initialization(self.fmu)))
        self._derivatives("InitialUnknowns")
        script.exit_initialization_mode()
        for _ in range(2):
            self._set(settable_while_stepping(self.fmu))
            self._input_derivatives()
            script.step()
            self.readings.append(script.read(self.fmu.variables))
            self._output_derivatives()
        self._derivatives("Outputs")
        self._states(2)
        self._log()
        script.terminate()
        self._log()
        self.readings.append(script.read(self.fmu.variables))
        self._output_derivatives()
        self._derivatives("Outputs")
        self._states(3)
        if _resets(self.probe):
            script.reset()
            script.begin().step()
            self.readings.append(script.read(self.fmu.variables))

    def _set(self, variables: list[Variable]) -> None:
        for v, value in start_values(variables):
            self.script.set(v, value)

    def _log(self) -> None:
        categories = [c.get("name", "") for c in self.fmu.root.iterfind("LogCategories/Category")]
        self.script.call("set_debug_logging", False, [])
        if categories:
            self.script.call("set_debug_logging", True, categories)
        self.script.call("set_debug_logging", True, [])

    def _input_derivatives(self) -> None:
        set_input_derivatives(self.probe, self.script, 0.0)

    def _output_derivatives(self) -> None:
        outputs = references_of(continuous_reals(self.probe, "output"))
        for order in range(1, self.fmu.output_derivative_order + 1) if outputs else ():
            self.script.call("output_derivatives", outputs, order)

    def _derivatives(self, section: str) -> None:
        if not self.fmu.claims("providesDirectionalDerivative"):
            return
        unknowns = [self.fmu.variables[(index or 1) - 1] for index, _ in self.fmu.unknowns(section)]
        references = references_of(v for v in unknowns if v.kind == "Real")
        inputs = references_of(continuous_reals(self.probe, "input"))
        if references and inputs:
            self.script.call("directional_derivatives", references, inputs, [1.0] * len(inputs))

    def _states(self, slot: int) -> None:
        script = self.script
        if self.fmu.claims("canGetAndSetFMUstate"):
            script.call("get_fmu_state", slot)
            if self.fmu.claims("canSerializeFMUstate"):
                script.call("serialized_fmu_state_size", slot)
                script.call("serialize_fmu_state", slot)
            script.call("set_fmu_state", slot)
            script.call("free_fmu_state", slot)


def _resets(probe: Probe) -> bool:
    """Whether fmi2Reset brings a terminated instance back: `reset-in-every-state` tells what is wrong."""

    def played() -> bool:
        script = probe.script().begin().step()
        script.terminate()
        script.reset()
        return script.begin().step().play(keep_going=True).succeeded

    try:
        return probe.once("run after fmi2Terminate and fmi2Reset", played)
    except NotJudgedError:  # it has ended the process before
        return False


def run_with_tolerance(probe: Probe) -> Script:
    """Returns a run in which tolerance and stop time are defined, played once for all rules."""

    def played() -> Script:
        script = probe.script(logging=True).set_up(stop=probe.point(1000), tolerance=TOLERANCE)
        return script.enter_initialization_mode().exit_initialization_mode().step(2).play(keep_going=True)

    return probe.once("run with a tolerance", played)


def session(probe: Probe) -> Session:
    """Returns the session, played once for all rules, with logging and settings of the process watched."""
    return probe.once("complete session", lambda: Session(probe, logging=True, watched=True))
