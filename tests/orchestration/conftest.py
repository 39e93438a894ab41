"""Foreign FMUs, knowing nothing of this project: written by PythonFMU's own builder, or in C."""

import itertools
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pythonfmu.builder import FmuBuilder

from . import foreign_fmus

_HEAD = """
    import ctypes

    from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

    from pythonfmu.enums import Fmi2Status

    # PythonFMU 0.7 frees this dictionary at the second instance (docs/fidelity.md)
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))

    INPUT, OUTPUT = Fmi2Causality.input, Fmi2Causality.output
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
    "Discards": """
        class Discards(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.y = 0.0
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                self.y = t + h
                if t > 0.45:
                    self.log("the battery is empty", Fmi2Status.discard)
                    return False
                return True
    """,
    "Raises": """
        class Raises(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.y = 0.0
                self.register_variable(Real("y", causality=OUTPUT))

            def do_step(self, t, h):
                if t > 0.45:
                    raise RuntimeError("the hull is breached")
                self.y = t + h
                return True
    """,
}  # fmt: skip


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """PythonFMU's FMUs by name."""
    folder = tmp_path_factory.mktemp("foreign")
    made: dict[str, Any] = {}
    for name, source in _SOURCES.items():
        script = folder / f"{name.lower()}_slave.py"
        script.write_text(textwrap.dedent(_HEAD) + textwrap.dedent(source))
        made[name] = FmuBuilder.build_FMU(script, folder)
    return made


Build = Callable[..., Path]


def _built_once(build: Build, folder: Path) -> Build:
    """Builds an FMU for each set of options that is new."""
    found: dict[str, Path] = {}
    numbers = itertools.count()

    def built(*arguments: Any, **options: Any) -> Path:
        key = repr((arguments, sorted(options.items())))
        if key not in found:
            found[key] = build(folder / f"{next(numbers)}.fmu", *arguments, **options)
        return found[key]

    return built


@pytest.fixture(scope="session")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds linear FMUs: the options are those of `foreign_fmus.linear`."""
    return _built_once(foreign_fmus.linear, tmp_path_factory.mktemp("linear"))


@pytest.fixture(scope="session")
def function(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds FMUs that compute y = expression of u, in C: `foreign_fmus.function`."""
    return _built_once(foreign_fmus.function, tmp_path_factory.mktemp("function"))


@pytest.fixture(scope="session")
def rogue(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds FMUs that misbehave on demand: the options are those of `foreign_fmus.rogue`."""
    return _built_once(foreign_fmus.rogue, tmp_path_factory.mktemp("rogue"))
