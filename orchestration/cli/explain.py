"""Command explain: keys, signals, faults and metrics of scenario files, from their schema; blocks."""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from fmus.errors import nearest
from fmus.registry import block_names
from orchestration.cli.shared import fail, print_table

SCHEMA = Path(__file__).parents[1] / "scenarios" / "scenario.schema.json"
Node = Mapping[str, Any]
_TOML = {"object": "table", "array": "list"}  # JSON's name of a type -> TOML's


@dataclass(frozen=True)
class Section:
    """Section: a table of entries, each with its meaning.

    rows: cells in Markdown; the first holds the name of the entry
    """

    title: str
    note: str
    headings: tuple[str, str, str]
    rows: tuple[tuple[str, str, str], ...]

    def names(self) -> list[str]:
        """Returns the name of the entry of each row: a key, or the kind or function of a table."""
        return [cell.strip("`").rpartition(' = "')[2].strip('"') for cell, *_ in self.rows]


_NOTES = {
    "Signals": "The values have the unit of the input; times are in s.",
    "Faults": 'A fault acts on `input`, "component.variable", from `start` to `end` [s]; else always.',
    "Metrics": '`signal` and `reference` are "component.variable". `window` is `[start, end]` in s, '
    "by default all. The unit follows from the signal; `unit` names another one, as with a `scale`.",
    "Distributions of a sweep": "The values have the unit of what is varied; with `relative` they are "
    "factors of its value. `truncate` draws within the range of the variable.",
}


def sections() -> dict[str, list[Section]]:
    """Returns the sections of each topic, in the order of the page on keys."""
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    tables, keys = schema["$defs"], schema["properties"]
    experiment, varied = (tables[name]["properties"] for name in ("ExperimentTable", "SweepTable"))
    kinds = {
        "Signals": keys["signals"]["additionalProperties"],
        "Faults": keys["faults"]["items"],
        "Metrics": keys["metrics"]["additionalProperties"],
        "Distributions of a sweep": varied["vary"]["additionalProperties"],
    }
    return {
        "keys": [_keys("Keys", keys, tables), _keys("Experiment", experiment, tables)],
        **{title.split()[0].lower(): [_kinds(title, node, tables)] for title, node in kinds.items()},
    }


def _keys(title: str, nodes: Node, tables: Node) -> Section:
    rows = []
    for name, node in nodes.items():
        reference = node.get("$ref") or node.get("items", {}).get("$ref")
        meant = tables[reference.rpartition("/")[2]] if reference else node
        kind = node.get("type") or meant.get("type", "list or table")
        items = [f"`{value}`" for value in meant.get("enum", ())]
        rows.append((f"`{name}`", _text(node) or _text(meant), ", ".join(items) or _TOML.get(kind, kind)))
    return Section(title, "", ("key", "meaning", "values"), tuple(rows))


def _kinds(title: str, node: Node, tables: Node) -> Section:
    rows = []
    for alternative in node["oneOf"]:
        definition = tables.get(alternative.get("$ref", "").rpartition("/")[2])
        if not definition:
            continue  # `false`, which removes an entry of the base
        names = definition["properties"]
        first = next((f'`{key} = "{one["const"]}"`' for key, one in names.items() if "const" in one), "")
        arguments = [_argument(key, one, definition) for key, one in names.items() if "const" not in one]
        required_first = ", ".join(sorted(arguments, key=lambda text: not text.startswith("**")))
        meanings: dict[str, list[str]] = {}
        for key, one in names.items():
            if "description" in one and f"`{key}`" not in _NOTES[title]:
                meanings.setdefault(_text(one), []).append(f"`{key}`")
        text = [_text(definition), *(f"{', '.join(keys)}: {text}" for text, keys in meanings.items())]
        rows.append((first, required_first, " ".join(text)))
    return Section(title, _NOTES[title], ("entry", "arguments", "meaning"), tuple(rows))


def _argument(name: str, node: Node, definition: Node) -> str:
    if name in definition.get("required", ()):
        return f"**`{name}`**"
    default = node.get("default", "")
    return f"`{name}`" + (f" = {json.dumps(default)}" if default not in ("", []) else "")


def _text(node: Node) -> str:
    """Returns the description in one line."""
    text = " ".join(node.get("description", "").split())
    return text[:1].upper() + text[1:]


def markdown_table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Returns a table in Markdown."""
    headings = list(headings)
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def explain(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TOPIC|NAME",
            help="One of keys, signals, faults, metrics, distributions; an entry of these; or a block.",
            autocompletion=lambda: [*sections(), *block_names()],
        ),
    ],
) -> None:
    """Explain keys, signals, faults, metrics or distributions of scenario files, one entry, or a block.

    The same tables are docs/reference/keys.md. For example, l1-depth explain rmse.
    """
    topics = sections()
    entries = topics.get(name) or [*_entries(name, topics)]
    if name in block_names():
        _print_block(name)
    elif entries:
        for section in entries:
            _print_section(section)
    else:
        names = {entry for group in topics.values() for section in group for entry in section.names()}
        fail(f"nothing is named {name!r}; {nearest(name, [*topics, *names, *block_names()])}", 2)


def _entries(name: str, topics: Mapping[str, list[Section]]) -> Iterator[Section]:
    """Yields the sections that have an entry of this name, with its row alone."""
    for group in topics.values():
        for section in group:
            rows = [row for row, entry in zip(section.rows, section.names(), strict=True) if entry == name]
            if rows:
                yield replace(section, rows=tuple(rows))


def _print_section(section: Section) -> None:
    from rich.markup import escape
    from rich.table import Table

    def plain(markdown: str) -> str:
        return escape(re.sub(r"`|\*\*", "", markdown))

    table = Table(*section.headings, title=section.title, caption=plain(section.note) or None)
    for row in section.rows:
        table.add_row(*map(plain, row))
    print_table(table)


def _print_block(name: str) -> None:
    from fmus.generate.builder import load_block

    block = load_block(name)
    guide = block.guide
    print(f"{name}: {block.description}.", guide.equations, sep="\n\n", end="\n\n")
    for line in (*guide.conventions, *guide.tuning, *guide.limits):
        print(f"- {line}")
    print(f"\nIts variables: l1-depth inspect {name}")
