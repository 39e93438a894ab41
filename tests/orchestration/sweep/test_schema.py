"""Editors check scenario files by the schema that is derived from the types which load them."""

import json
import re
from pathlib import Path

import pytest

from orchestration.scenarios.scenario import SHIPPED

from .schemas import schemas

FILES = sorted(SHIPPED.rglob("*.toml"))


def test_the_shipped_schemas_are_the_generated_ones() -> None:
    for name, text in schemas().items():
        assert (SHIPPED / name).read_text(encoding="utf-8") == text, (
            "run python -m tests.orchestration.sweep.schemas"
        )


def test_an_argument_has_the_meaning_in_its_docstring_and_no_text_has_titles_of_sections() -> None:
    text = schemas()["scenario.schema.json"]
    spectrum = json.loads(text)["$defs"]["spectrum_table"]
    assert spectrum["properties"]["peak_period"]["description"] == "Period of the peak of the spectrum [s]."
    assert spectrum["description"].endswith("every seed gives the same variance.")
    assert "----" not in text


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_shipped_file_names_its_schema(path: Path) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    named = re.fullmatch(r"#:schema (\S+)", first)
    assert named
    assert (path.parent / named[1]).resolve().parent == SHIPPED.resolve()
    assert (path.parent / named[1]).name in schemas()


def test_the_schema_knows_every_kind_and_requires_nothing_that_a_base_may_give() -> None:
    schema = json.loads(schemas()["scenario.schema.json"])
    assert "required" not in schema
    assert set(schema["properties"]) >= {"base", "components", "experiment", "signals", "faults", "sweep"}
    assert {"ramps table", "delay table", "rmse table", "lognormal table"} <= {
        table["title"] for table in schema["$defs"].values()
    }
