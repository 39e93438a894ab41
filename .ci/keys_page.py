"""Prints the site's page reference/keys.md, every key of a scenario file, from its JSON schema."""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

SCHEMA = Path(__file__).parent.parent / "orchestration" / "scenarios" / "scenario.schema.json"
Node = dict[str, Any]
TOML = {"object": "table", "array": "list"}  # JSON's name of a type -> TOML's

_HEAD = """\
# Keys of scenario files

Every key of a [scenario file](scenarios.md), from its
[JSON schema](../downloads/scenario.schema.json). `python .ci/keys_page.py` prints this page.
Arguments in bold are required; the others show their default value, if they have one."""

_NOTES = {
    "Signals": "The values have the unit of the input; times are in s.",
    "Faults": 'A fault acts on `input`, "component.variable", from `start` to `end` [s], by default always.',
    "Metrics": (
        '`signal` and `reference` are "component.variable". `window` is `[start, end]` in s, by default all. '
        "The unit follows from the signal; `unit` names another one, such as that of a `scale`."
    ),
    "Distributions of a sweep": (
        "The values have the unit of what is varied; with `relative` they are factors of its value. "
        "`truncate` draws within the range of the variable."
    ),
}


def page() -> str:
    """The whole page."""
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    tables, keys = schema["$defs"], schema["properties"]
    alternatives = {
        "Signals": keys["signals"]["additionalProperties"],
        "Faults": keys["faults"]["items"],
        "Metrics": keys["metrics"]["additionalProperties"],
        "Distributions of a sweep": tables["SweepTable"]["properties"]["vary"]["additionalProperties"],
    }
    parts = [
        _HEAD,
        f"## Keys\n\n{_keys(keys, tables)}",
        f"## Experiment\n\n{_keys(tables['ExperimentTable']['properties'], tables)}",
        *(f"## {title}\n\n{_NOTES[title]}\n\n{_kinds(node, tables)}" for title, node in alternatives.items()),
    ]
    return "\n\n".join(parts) + "\n"


def _keys(nodes: Node, tables: Node) -> str:
    rows = []
    for name, node in nodes.items():
        reference = node.get("$ref") or node.get("items", {}).get("$ref")
        meant = tables[reference.rpartition("/")[2]] if reference else node
        kind = node.get("type") or meant.get("type", "list or table")
        items = [f"`{value}`" for value in meant.get("enum", ())]
        rows.append((f"`{name}`", _text(node) or _text(meant), ", ".join(items) or TOML.get(kind, kind)))
    return table(("key", "meaning", "values"), rows)


def _kinds(node: Node, tables: Node) -> str:
    rows = []
    for alternative in node["oneOf"]:
        definition = tables.get(alternative.get("$ref", "").rpartition("/")[2])
        if not definition:
            continue  # `false`, which removes that of the base
        names = definition["properties"]
        first = next((f'`{key} = "{one["const"]}"`' for key, one in names.items() if "const" in one), "")
        arguments = [_argument(key, one, definition) for key, one in names.items() if "const" not in one]
        rows.append(
            (first, ", ".join(sorted(arguments, key=lambda a: not a.startswith("**"))), _text(definition))
        )
    return table(("entry", "arguments", "meaning"), rows)


def _argument(name: str, node: Node, definition: Node) -> str:
    if name in definition.get("required", ()):
        return f"**`{name}`**"
    return f"`{name}`" + (
        f" = {json.dumps(node['default'])}" if node.get("default", "") not in ("", []) else ""
    )


def _text(node: Node) -> str:
    """The description in one line, without what is raised."""
    arguments = "|".join(node.get("properties", ()))
    text = re.sub(r"\n\nRaises .*", "", node.get("description", ""), flags=re.DOTALL)
    text = re.sub(rf"(?<!\n)\n(?=(?:{arguments}): )", "; ", text)
    text = " ".join(re.sub(r"(?<!\.)\n\n", ". ", text).split())
    return text[:1].upper() + text[1:]


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    heads = list(heads)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


if __name__ == "__main__":
    print(page(), end="")
