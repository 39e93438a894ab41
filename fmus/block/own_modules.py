"""The modules of one instance of a policy, shared with no other instance."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from pathlib import Path
from threading import RLock
from types import ModuleType

# packages of the FMU that read none of its files
_NOT_OWN = ("__init__", "fmus", "pythonfmu")
# Components may step on several threads. Each FMU has a copy of this file, so that the lock that all of them
# share cannot be a variable of this module.
_LOCK = sys.__dict__.setdefault("l1_depth_own_modules", RLock())


class OwnModules(Loader):
    """The Python files of a folder as modules of a package, imported anew for each of these objects.

    While `present` lasts, `sys.modules` holds them, also under their names without the package: a pickle
    finds its classes by these. Names of Python's own modules keep their meaning.
    """

    def __init__(self, package: str = "", folder: Path = Path()) -> None:
        files = folder.rglob("*.py") if package else ()
        parts = [file.relative_to(folder).with_suffix("").parts for file in files]
        own = [part for part in parts if part[0] not in _NOT_OWN]
        # with the folders between, which need no __init__.py
        folders = (".".join(part[: n + 1]) for part in own for n in range(len(part)))
        names = [*dict.fromkeys(name.removesuffix(".__init__") for name in folders)]
        self._package, top = package, ModuleType(package)
        top.__path__ = [str(folder)]
        self._plain = [name for name in names if name.partition(".")[0] not in sys.stdlib_module_names]
        self._names = [package, *(f"{package}.{name}" for name in names), *self._plain]
        self._exchanged = {package: top} if package else {}

    @contextmanager
    def present(self) -> Iterator[None]:
        """Puts the modules into `sys.modules` in place of others of their names, until the context ends."""
        with _LOCK:
            self._exchange()
            sys.meta_path.insert(0, self)
            try:
                yield
            finally:
                sys.meta_path.remove(self)
                self._exchange()

    def _exchange(self) -> None:
        others = {name: sys.modules.pop(name) for name in self._names if name in sys.modules}
        sys.modules.update(self._exchanged)
        self._exchanged = others

    def loaded(self) -> list[ModuleType]:
        """Returns the modules that are loaded; while they are present."""
        own = [name for name in self._names if name.startswith(f"{self._package}.")]
        return [sys.modules[name] for name in own if name in sys.modules]

    # the finder and the loader of a module under its name without the package

    def find_spec(self, name: str, path: Sequence[str] | None, target: object = None) -> ModuleSpec | None:
        """Finds a module of the package by its name alone."""
        return ModuleSpec(name, self) if name in self._plain else None

    def exec_module(self, module: ModuleType) -> None:
        """Puts the module of the package in the place of the new one."""
        sys.modules[module.__name__] = import_module(f"{self._package}.{module.__name__}")
