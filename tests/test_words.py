"""Docstrings begin with a verb or a noun, and no text has a phrase at which a native reader stops."""

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from orchestration.cli.commands import command_function, command_names

from .page_text import blocks, own_pages, own_text

ROOT = Path(__file__).parents[1]
PACKAGES = ("fmus", "controller_fmu", "plant_fmu", "orchestration")
NO_SUBJECT = re.compile(r"(of|that|those|what|which|whose|why|how|so|as|where|the same)\b", re.IGNORECASE)
THIRD_PERSON = re.compile(r"(Whether|[A-Z][a-z]+s(?! of\b))\b")  # "Returns", but not "Names of"
FILES = [path.relative_to(ROOT) for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
COMMANDS = [command_function(name)[0] for name in command_names()]
HELP = {(f"{one.__module__.replace('.', '/')}.py", one.__name__) for one in COMMANDS}  # imperatives
HELP |= {("orchestration/cli/commands.py", "_l1_depth")}
PAGES = [path.relative_to(ROOT) for path in own_pages(ROOT / "docs")]
# Negation by "none", names without a noun ("those of", a clause that begins with "what"), inversions and
# personification. A heading such as "What is inside" is no clause: its "#" stands before the word.
DIALECT = re.compile(
    r"\b(is|are) none\b|\b(that|those) of\b|\bas of\b|\bbesides\b|\b(is|are) told\b|\btells\b"
    r"|\botherwise than\b|\bis otherwise\b|\bof its own\b|\bby itself\b|\bat which\b"
    r"|(^|[.;:,|(] ?)what (is|it|follows|has|lies|was|were|an?|the)\b"
    r"|\bno (\w+ ){1,4}but\b|\blets (\w+ ){1,4}be\b",
    re.IGNORECASE,
)


def documented(tree: ast.AST) -> Iterator[tuple[str, str, bool]]:
    """Yields the name and the docstring of each definition, and whether it must begin with a verb."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and (
            text := ast.get_docstring(node)
        ):
            decorators = [ast.unparse(one) for one in getattr(node, "decorator_list", ())]
            is_noun = any(
                re.search("property|rule|differential", name) for name in decorators
            )  # a rule's is its claim
            yield getattr(node, "name", "module"), text, isinstance(node, ast.FunctionDef) and not is_noun


def keeps_the_rule(text: str, begins_with_verb: bool) -> bool:
    return bool(THIRD_PERSON.match(text)) if begins_with_verb else not NO_SUBJECT.match(text)


def test_a_docstring_begins_with_a_verb_or_a_noun() -> None:
    assert not [
        f"{path}: {name}: {text.splitlines()[0]}"
        for path in FILES
        for name, text, begins_with_verb in documented(ast.parse((ROOT / path).read_text(encoding="utf-8")))
        if (path.as_posix(), name) not in HELP and not keeps_the_rule(text, begins_with_verb)
    ]


@pytest.mark.parametrize("text", ["Of a column.", "The unit.", "Write it.", "Names of columns.", "how far"])
def test_a_function_without_a_verb_breaks_the_rule(text: str) -> None:
    assert not keeps_the_rule(text, begins_with_verb=True)
    assert keeps_the_rule("Returns the unit.", begins_with_verb=True)
    assert keeps_the_rule("The unit.", begins_with_verb=False)
    assert not keeps_the_rule("Of a column.", begins_with_verb=False)


def phrases(texts: Iterable[str]) -> list[str]:
    """Returns each phrase of the dialect with the words around it."""
    found = [(text, match) for text in texts for match in DIALECT.finditer(text)]
    return [text[max(0, match.start() - 40) : match.end() + 40] for text, match in found]


def written(path: Path) -> Iterator[str]:
    """Yields the paragraphs of the docstrings, messages and comments of a Python file."""
    source = (ROOT / path).read_text(encoding="utf-8")
    nodes = ast.walk(ast.parse(source))
    texts = [x.value for x in nodes if isinstance(x, ast.Constant) and isinstance(x.value, str)]
    # comments of successive lines are one text: a sentence may go on in the next line
    texts += re.findall(r"(?:^ *#.*\n)+", source, re.M)
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    texts += [x.string for x in tokens if x.type == tokenize.COMMENT and x.line.strip() != x.string]
    for text in texts:
        for paragraph in re.split(r"\n\s*\n", re.sub(r"^ *# ?", "", text, flags=re.M)):
            yield " ".join(paragraph.split())


def test_a_file_of_the_product_has_no_phrase_of_the_dialect() -> None:
    found = {path: phrases(written(path)) for path in FILES}
    assert not {path: refused for path, refused in found.items() if refused}


def test_a_page_has_no_phrase_of_the_dialect() -> None:
    for page in PAGES:
        text = own_text(ROOT / page)
        assert not phrases(re.sub(r"`[^`]*`", "code", block) for block in blocks(text)), page


@pytest.mark.parametrize(
    "text",
    [
        "A number that is none.",
        "Those of a run are kept.",
        "The error names it; what is left runs.",
        "| what it is |",
        "What follows from parameters is calculated.",
        "The page tells why.",
        "No value but the last is kept.",
        "It lets the caller be quick.",
    ],
)
def test_a_phrase_of_the_dialect_is_found(text: str) -> None:
    assert phrases([text])


def test_plain_sentences_and_headings_have_no_phrase_of_the_dialect() -> None:
    assert not phrases(["## What is inside", "The table shows what is inside.", "No error, but a warning."])


def test_a_sentence_that_goes_on_in_the_next_comment_is_read_as_one(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text(
        '"""A module."""\n\n# the time is that\n# of the run\nx = 1  # it tells\ny = f"{x} is none"\n'
    )
    assert [DIALECT.findall(one) != [] for one in written(file)] == [False, True, True, True]
