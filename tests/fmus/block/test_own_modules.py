"""Modules of an instance: imported for it alone, found under two names, and out of the way between calls."""

import pickle
import sys
import threading
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from fmus.block.own_modules import OwnModules

FILES = {
    "main.py": "from own_package.helper import LOG, Model\n",
    "helper.py": "LOG = []\nclass Model:\n    def __init__(self, k):\n        self.k = k\n",
    "late.py": "from own_package.helper import LOG\nNAMES = [__name__]\n",
    "parts/__init__.py": "",
    "parts/wing.py": "SPAN = 2.5\n",
    "json.py": "OFFSET = -3.0\n",
    "fmus/__init__.py": "",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "own_package" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "own_package"


def made(folder: Path) -> OwnModules:
    return OwnModules("own_package", folder)


def test_each_object_has_modules_of_its_own_also_those_that_a_call_imports_late(folder: Path) -> None:
    first, second = made(folder), made(folder)
    for modules in (first, second):
        with modules.present():
            import_module("own_package.main").LOG.append(1)
    for modules, count in ((first, 2), (second, 3), (first, 4)):
        with modules.present():
            log = import_module("own_package.late").LOG
            assert log is import_module("own_package.helper").LOG
            log.extend([1] * (count - len(log)))
    with second.present():
        assert len(import_module("own_package.main").LOG) == 3


def test_a_module_is_found_under_its_own_name_as_the_same_one(folder: Path) -> None:
    with made(folder).present():
        for name in ("helper", "late", "parts.wing", "parts"):
            assert import_module(name) is import_module(f"own_package.{name}")
        assert import_module("helper").__spec__.name == "own_package.helper"  # type: ignore[union-attr]
        assert import_module("late").NAMES == ["own_package.late"]


def test_a_pickle_of_a_class_of_a_helper_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "helper", raising=False)  # of another test
    content = b"\x80\x04chelper\nModel\n)\x81}\x8c\x01kG@\x12\x00\x00\x00\x00\x00\x00sb."
    with pytest.raises(ModuleNotFoundError):
        pickle.loads(content)
    modules = made(folder)
    for _ in range(2):
        with modules.present():
            model = pickle.loads(content)
            assert (model.k, type(model)) == (4.5, import_module("own_package.main").Model)


def test_between_calls_nothing_of_it_is_left_and_modules_of_its_names_are_back(folder: Path) -> None:
    other = ModuleType("helper")
    before, finders = {**sys.modules, "helper": other}, list(sys.meta_path)
    sys.modules["helper"] = other
    try:
        with pytest.raises(ModuleNotFoundError), made(folder).present():
            import_module("main.missing" if import_module("helper") is not other else "helper")
        assert sys.modules == before
        assert sys.meta_path == finders
    finally:
        del sys.modules["helper"]


def test_a_module_that_hides_one_of_python_has_no_second_name(folder: Path) -> None:
    import json

    with made(folder).present():
        assert import_module("json") is json
        assert import_module("own_package.json").OFFSET == -3.0


def test_the_loaded_modules_are_its_own_alone(folder: Path) -> None:
    modules = made(folder)
    with modules.present():
        import_module("own_package.fmus")
        import_module("parts.wing")
        names = [module.__name__ for module in modules.loaded()]
    sys.modules.pop("own_package.fmus")
    assert sorted(names) == ["own_package.parts", "own_package.parts.wing"]


def test_calls_of_two_objects_on_threads_do_not_meet(folder: Path) -> None:
    first, second, entered = made(folder), made(folder), threading.Event()

    def other() -> None:
        entered.set()
        with second.present():
            import_module("own_package.helper").LOG.append(2)

    thread = threading.Thread(target=other)
    with first.present():
        log = import_module("own_package.helper").LOG
        thread.start()
        entered.wait()
        thread.join(0.05)  # it waits for the end of this call
        assert import_module("helper").LOG is log
        assert thread.is_alive()
    thread.join()
    assert log == []
