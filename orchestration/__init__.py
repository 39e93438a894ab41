"""Everything that uses FMUs, through their model descriptions alone: the master algorithm and its tools.

Users import from here and from `orchestration.fmpy_master`, and from the rooms beside the core that say so.
The names stand in `__init__.pyi` alone, a line each. A name is imported when it is asked for: a command loads
nothing that it does not use.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
# a line reads: from MODULE import NAME as NAME
_MODULES = {words[3]: words[1] for words in map(str.split, _STUB.splitlines())}
__all__ = [*_MODULES]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
