"""Tests of the pages: links lead somewhere, marked examples run, named tests exist."""

import dis
import doctest
import enum
import inspect
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

from orchestration.cli.app import app

from .page_examples import examples
from .page_text import long_cells, long_sentences, own_pages, own_text

ROOT = Path(__file__).parent.parent
PAGES = own_pages(ROOT / "docs")
ROOMS = [ROOT / room / "README.md" for room in ("controller_fmu", "fmus", "plant_fmu")]
TEXTS = [*sorted((ROOT / "docs").rglob("*.md")), *ROOMS, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
# the list of names is directives for the site's program
MADE_WITH_THE_SITE = "docs/reference/api/orchestration.md"
TOOL_PAGES = [
    page for page in (ROOT / "docs" / "how-to" / "importing").glob("*.md") if page.name != "README.md"
]
TUTORIALS = [page for page in (ROOT / "docs" / "tutorials").glob("*.md") if page.name != "README.md"]

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "optional-dependencies"
]
FOR_DEVELOPERS = {"docs", "test"}

FOR_USERS = [page for page in PAGES if {"tutorials", "how-to"} & set(page.parts)]

QUICK = {"README.md"}  # the others build FMUs, or run the command line a dozen times each


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def _anchors(page: Path) -> set[str]:
    """Returns the anchors that GitHub makes from headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    links = [
        (page, link)
        for page in TEXTS
        for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
        if not link.startswith("http")
    ]
    assert links
    for page, link in links:
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if target.relative_to(ROOT).as_posix() != MADE_WITH_THE_SITE:
            assert target.exists(), (page, link)
            assert not anchor or anchor in _anchors(target), (page, link)


def test_every_file_named_exists() -> None:
    top = "fmus|controller_fmu|plant_fmu|orchestration|tests|docs|\\.ci"
    for page in TEXTS:
        named = re.findall(rf"`((?:{top})/[\w./-]*)`", page.read_text(encoding="utf-8"))
        assert not [path for path in named if not (ROOT / path).exists()], page


def test_the_picture_of_the_packages_shows_every_room() -> None:
    picture = (ROOT / "docs" / "images" / "packages.svg").read_text(encoding="utf-8")
    rooms = {path.parent.name for path in (ROOT / "orchestration").glob("*/__init__.py")}
    rooms |= {path.parent.name for path in (ROOT / "fmus").glob("*/__init__.py")}
    assert rooms | {"controller_fmu", "plant_fmu"} <= set(re.findall(r"\w+", picture))


def test_the_architecture_lists_every_file_of_a_run_in_ten_minutes() -> None:
    """Ten minutes are 2,000 words."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 2000
    table = text[
        text.index("| question | file of `orchestration/run/` |") : text.index("All exchanged values")
    ]
    files = {path.name for path in (ROOT / "orchestration" / "run").glob("*.py")}
    assert files | {"loop.c"} == set(re.findall(r"`(\w+\.(?:py|c))`", table))


SCRIPTS = sorted((ROOT / "docs").rglob("*.py"))
FRONT_DOOR = {
    "orchestration",
    "orchestration.fmpy_master",
    "orchestration.gym",
    "orchestration.studies",
    "fmus",
    "fmus.block",
    "fmus.numerics",
}


def test_what_users_import_stands_in_few_modules() -> None:
    """The others may move. `from fmus import numerics` is the one import from `fmus` itself."""
    for page in (*TEXTS, *SCRIPTS):
        text = page.read_text(encoding="utf-8")
        lines = re.findall(r"^\s*(?:from|import) ((?:fmus|orchestration)[\w.]*)(?: import (.*))?", text, re.M)
        assert {module for module, _ in lines} <= FRONT_DOOR, page
        assert {names for module, names in lines if module == "fmus"} <= {"numerics"}, page


PRODUCT = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
SHOWN = re.findall(r"^::: (\S+)", "\n".join(page.read_text(encoding="utf-8") for page in PAGES), re.M)


def public_names() -> dict[str, Any]:
    """Returns classes and functions that users import or that a page of the reference shows, by name."""
    names = {f"{room}.{name}" for room in FRONT_DOOR for name in getattr(import_module(room), "__all__", ())}
    names.add("orchestration.fmpy_master.simulate")
    for shown in SHOWN:
        members = vars(resolve_name(shown)) if inspect.ismodule(resolve_name(shown)) else {}
        own = {name for name, member in members.items() if getattr(member, "__module__", "") == shown}
        names |= {f"{shown}.{name}" for name in own if not name.startswith("_")} if members else {shown}
    known = {resolve_name(name): name for name in sorted(names) if callable(resolve_name(name))}
    return {name: one for one, name in known.items() if inspect.isclass(one) or inspect.isfunction(one)}


def with_members(name: str, one: Any) -> Iterator[tuple[str, Any, str]]:
    """Yields a class or function and its public methods and properties, each with its docstring."""
    of_init = inspect.getdoc(vars(one).get("__init__")) if inspect.isclass(one) else ""
    yield name, one, f"{inspect.getdoc(one) or ''}\n\n{of_init or ''}".strip()
    bases = one.__mro__ if inspect.isclass(one) else ()
    members = [m for base in bases if base.__module__.startswith(PRODUCT) for m in vars(base).items()]
    for own, member in members:
        function = getattr(member, "__func__", member)
        is_field = own in getattr(one, "__annotations__", {})
        is_part = inspect.isfunction(function) or isinstance(function, property | cached_property)
        if is_part and not (is_field or own.startswith("_")):
            # a method may have the docstring of the base class
            yield f"{name}.{own}", function, inspect.getdoc(getattr(one, own)) or ""


def raises(function: Any) -> bool:
    """Whether a function has a statement that raises an error, other than of an abstract method."""
    code = inspect.unwrap(function).__code__
    is_abstract = "NotImplementedError" in code.co_names
    return not is_abstract and any(one.opname == "RAISE_VARARGS" for one in dis.get_instructions(code))


def lacking(one: Any, docstring: str) -> Iterator[str]:
    """Yields the parts that the docstring of a class, function or property lacks."""
    if not docstring:
        yield "a docstring"
    is_bare = inspect.isclass(one) and (issubclass(one, enum.Enum) or one.__init__ is Exception.__init__)
    if is_bare or isinstance(one, property | cached_property):
        return
    _, *parts = re.split(r"^(\w+)\n-+\n", docstring, flags=re.M)
    there, signature = dict(zip(parts[::2], parts[1::2], strict=True)), inspect.signature(one)
    listed = there.get("Parameters", "") + there.get("Attributes", "")
    named = re.findall(r"\w+", " ".join(re.findall(r"^[\w*][^:\n]*", listed, re.M)))
    # the declaration of a variable of a block has its description
    declared = [name for name, field in getattr(one, "__dataclass_fields__", {}).items() if field.metadata]
    yield from [name for name in signature.parameters if name not in (*named, *declared, "self", "cls", "_")]
    if not inspect.isclass(one) and signature.return_annotation not in (None, "None"):
        yield from {"Returns"} - {name.replace("Yields", "Returns") for name in there}
    made = [vars(one).get(name) for name in ("__init__", "__post_init__")] if inspect.isclass(one) else [one]
    if any(raises(function) for function in made if inspect.isfunction(function)):
        yield from {"Raises"} - there.keys()
    yield from re.findall(r"^Raises \w+Error.*|.*; \w+Error .*", docstring, re.M)


@pytest.mark.parametrize(("name", "one"), public_names().items())
def test_a_public_name_has_a_docstring_in_numpys_style(name: str, one: Any) -> None:
    """With all parameters, and with sections of what it returns and raises."""
    assert not {
        own: parts for own, part, text in with_members(name, one) if (parts := [*lacking(part, text)])
    }


def test_a_gap_in_a_docstring_is_found() -> None:
    def half(x: float) -> float:
        if x < 0.0:
            raise ValueError(x)
        return 0.5 * x

    sections = ("Parameters", "x : float", "Returns", "float", "Raises", "ValueError")
    assert [*lacking(half, "")] == ["a docstring", "x", "Returns", "Raises"]
    text = "".join(f"{one}\n------\n" if one.istitle() else f"{one}\n\n" for one in sections)
    assert not [*lacking(half, text)]


EXAMPLES = [
    path.relative_to(ROOT)
    for package in PRODUCT
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
# a score runs all cases, an ensemble compiles
LONG = ("score.py", "ensemble.py")


@pytest.mark.parametrize(
    "path",
    [pytest.param(x, id=str(x), marks=pytest.mark.slow if x.name in LONG else []) for x in EXAMPLES],
)
def test_the_examples_of_docstrings_run_and_print_what_they_show(
    path: Path, request: pytest.FixtureRequest
) -> None:
    if "load_scenario(" in (ROOT / path).read_text(encoding="utf-8"):
        request.getfixturevalue("scenario_fmus")
    module = import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
    ran = doctest.testmod(module, extraglobs={"dataclass": dataclass})
    assert (ran.failed, ran.attempted > 0) == (0, True)


@pytest.mark.parametrize("page", TOOL_PAGES, ids=_name)
def test_a_page_says_what_was_tested_and_what_was_not(page: Path) -> None:
    """Every claim of a test names a file that exists, or says that nothing was tested."""
    text = page.read_text(encoding="utf-8")
    (tested,) = re.findall(r"^## Tested here\n(.*?)^## Not tested\n", text, re.M | re.DOTALL)
    claims = [claim for claim in re.split(r"^- ", tested, flags=re.M)[1:] if not claim.startswith("Nothing")]
    for claim in claims:
        named = re.findall(r"`(tests/\S+?\.py)`", claim)
        assert named, claim
        assert all((ROOT / path).is_file() for path in named), claim
    assert re.search(r"^## Not tested\n\n- \S", text, re.M)


def test_the_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "how-to" / "importing" / "README.md").read_text(encoding="utf-8")
    assert {page.name for page in TOOL_PAGES} == set(re.findall(r"\]\((\w[\w-]+\.md)\)", index))


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=_name(page), marks=[] if page.name in QUICK else pytest.mark.slow)
        for page in (*PAGES, *ROOMS)
        if examples(page)
    ],
)
def test_the_examples_run_and_print_what_the_page_shows(page: Path, tmp_path: Path) -> None:
    """They run in an empty folder, with the programs of this environment."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "page_examples.py"), str(page)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_table_of_extras_lists_every_extra_of_users() -> None:
    page = (ROOT / "docs" / "how-to" / "run-without-building.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.M)) == EXTRAS.keys() - FOR_DEVELOPERS


def test_what_builds_the_site_is_fixed_to_versions() -> None:
    """A newer version may give more warnings, and the strict build then fails."""
    assert EXTRAS["docs"]
    assert not [requirement for requirement in EXTRAS["docs"] if "==" not in requirement]


def test_the_tutorials_install_the_pytest_that_they_run() -> None:
    runs_pytest = [
        page for page in TUTORIALS if re.search(r"^pytest ", page.read_text(encoding="utf-8"), re.M)
    ]
    assert runs_pytest
    index = (ROOT / "docs" / "tutorials" / "README.md").read_text(encoding="utf-8")
    assert "pip install -e '.[all]' pytest" in index
    assert not [extra for extra in EXTRAS["all"] if "pytest" in extra]


@pytest.mark.parametrize("page", TUTORIALS, ids=_name)
def test_a_tutorial_shows_output_and_stands_in_their_index(page: Path) -> None:
    assert any(example.language == "text" for example in examples(page))
    assert f"({page.name})" in (ROOT / "docs" / "tutorials" / "README.md").read_text(encoding="utf-8")


def test_the_workflow_shown_runs_what_the_page_runs() -> None:
    """Each command of the workflow, except installations, is a command of this page's examples."""
    shown = examples(ROOT / "docs" / "tutorials" / "continuous-integration.md")
    (workflow,) = [example.code for example in shown if example.language == "yaml"]
    ran = {
        line.strip() for example in shown if example.language == "sh" for line in example.code.splitlines()
    }
    commands = [c for c in re.findall(r"- run: (.*)", workflow) if not c.startswith("pip ")]
    assert len(commands) == 2
    assert set(commands) <= ran


def test_every_command_shown_exists() -> None:
    commands = {info.callback.__name__ for info in app.registered_commands if info.callback}
    for page in TEXTS:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r"(?:^ {4}|^|`)l1-depth (\w+)", text, re.MULTILINE)) <= commands, page


def test_sentences_and_cells_are_short() -> None:
    for page in (*PAGES, *ROOMS):
        text = own_text(page)
        assert not long_sentences(text), page
        assert not long_cells(text), page


def words(pages: Sequence[Path]) -> int:
    return sum(len(own_text(page).split()) for page in pages)


def test_pages_have_at_most_45_500_words_and_tutorials_and_how_tos_20_500() -> None:
    """Pages made by the site's build do not count. 500 words are of firmware, proofs and the certificate."""
    assert 0 < words(FOR_USERS) <= 20_500
    assert words(FOR_USERS) < words(PAGES) <= 45_500


_WORDS = "one " * 24


@pytest.mark.parametrize(
    ("text", "sentences", "cells"),
    [
        (f"{_WORDS}end. {_WORDS}end.", 0, 0),
        (f"A list:\n\n- {_WORDS}two words.\n- Two.", 1, 0),
        (f"{_WORDS}\n`code of words` [link](page.md).\n", 1, 0),
        (f"```sh\n{_WORDS}two words\n```\n\n    {_WORDS}two words\n", 0, 0),
        (f"| {'x' * 120} | [{'x' * 118}](page.md) |\n| {_WORDS}two words |\n", 0, 0),
        (f"| a | {'x' * 121} |\n", 0, 1),
    ],
)
def test_a_long_sentence_or_cell_is_found(text: str, sentences: int, cells: int) -> None:
    assert (len(long_sentences(text)), len(long_cells(text))) == (sentences, cells)
