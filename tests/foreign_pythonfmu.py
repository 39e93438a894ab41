"""FMUs that PythonFMU's own builder makes from classes that are independent of the blocks."""

import textwrap
from pathlib import Path
from typing import Any

from pythonfmu.builder import FmuBuilder

from fmus.generate.python import REMEDIES

_HEAD = """
    import ctypes
    import sys
    from pathlib import Path

    from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String

    from pythonfmu.enums import Fmi2Status

    INPUT, OUTPUT = Fmi2Causality.input, Fmi2Causality.output
"""

# steps until 0.45 s
_ENDING = """
        class {name}(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.y = 0.0
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                self.y = t + h
                if t > 0.45:
                    {after}
                return True
"""
_SOURCES = {
    # x' = -x + u, exact for held u; y = x
    "Lag": """
        import math

        class Lag(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.u, self.y = 0.0, 1.0
                self.register_variable(Real("u", causality=INPUT, start=0.0))
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                self.y = self.u + (self.y - self.u) * math.exp(-h)
                return True
    """,
    # passes every type through, at once
    "Types": """
        class Types(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.a, self.b = 0, False
                common = {"variability": Fmi2Variability.discrete}
                self.register_variable(Integer("a", causality=INPUT, start=0, **common))
                self.register_variable(Boolean("b", causality=INPUT, start=False, **common))
                self.register_variable(Integer("c", causality=OUTPUT, getter=lambda: self.a + 1, **common))
                self.register_variable(Boolean("d", causality=OUTPUT, getter=lambda: not self.b, **common))

            def do_step(self, t, h):
                return True
    """,
    # appends to the String that it is given; `length` is a local variable, `twice` a calculated parameter
    "Diary": """
        class Diary(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.entry, self.page, self.length, self.gain = "", "begun", 0.0, 2.0
                discrete = {"variability": Fmi2Variability.discrete}
                fixed = {"variability": Fmi2Variability.fixed}
                self.register_variable(String("entry", causality=INPUT, start="", **discrete))
                self.register_variable(String("page", causality=OUTPUT, **discrete))
                self.register_variable(Real("length", causality=Fmi2Causality.local))
                self.register_variable(Real("gain", causality=Fmi2Causality.parameter, start=2.0,
                                            variability=Fmi2Variability.tunable))
                self.register_variable(Real("twice", causality=Fmi2Causality.calculatedParameter,
                                            getter=lambda: 2.0 * self.gain, **fixed))

            def do_step(self, t, h):
                self.page = self.entry + "|"
                self.length = self.gain * len(self.page)
                return True
    """,
    **{name: _ENDING.format(name=name, after=after) for name, after in {
        "Discards": 'self.log("the battery is empty", Fmi2Status.discard); return False',
        "Fails": 'self.log("the rudder is stuck", Fmi2Status.error); return False',
        "Raises": 'raise RuntimeError("the hull is breached")',
    }.items()},
}  # fmt: skip

NAMES = tuple(_SOURCES)
SAVES_STATE = {"canGetAndSetFMUstate": True, "canSerializeFMUstate": True}


def build(name: str, folder: Path, **capabilities: Any) -> Path:
    """Builds `folder/NAME.fmu` from one of the classes above; capabilities: such as `SAVES_STATE`."""
    script = folder / f"{name.lower()}_slave.py"
    script.write_text(textwrap.dedent(_HEAD) + REMEDIES + textwrap.dedent(_SOURCES[name]))
    return FmuBuilder.build_FMU(script, folder, **capabilities)
