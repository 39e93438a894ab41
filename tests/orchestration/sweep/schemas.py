"""The JSON schemas of files of scenarios, parameters and vehicles, by which editors check and complete them.

`python -m tests.orchestration.sweep.schemas` writes them beside the shipped scenarios.
"""

import ast
import inspect
import json
import textwrap
from contextlib import suppress
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import Field, create_model
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from fmus.files import write_text_atomically
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.file_tables import Table
from orchestration.scenarios.scenario import SHIPPED
from orchestration.scenarios.vehicle import VehicleFile
from orchestration.sweep.varied import SweepTable

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _WithTexts(GenerateJsonSchema):
    """A schema whose properties have the texts that stand below their fields in the source."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        described = super().model_schema(schema)
        for cls in reversed(schema["cls"].__mro__):
            for name, text in _texts_of_fields(cls).items():
                described["properties"][name]["description"] = text
        return described


def _texts_of_fields(cls: type) -> dict[str, str]:
    texts: dict[str, str] = {}
    if issubclass(cls, Table):
        with suppress(OSError, TypeError):  # of a class without a source
            (definition,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
            for field, below in pairwise(getattr(definition, "body", ())):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                        texts[name] = inspect.cleandoc(text)
    return texts


@cache
def schemas() -> dict[str, str]:
    """File name -> schema as JSON."""
    optional: Any = Field(default=None)
    sweep: Any = (SweepTable, optional)
    scenario = create_model("Scenario", __base__=ScenarioFile, __doc__=ScenarioFile.__doc__, sweep=sweep)
    partial = scenario.model_json_schema(schema_generator=_WithTexts)
    for table in (partial, partial["$defs"]["ExperimentTable"], partial["$defs"]["SweepTable"]):
        del table["required"]  # a base may give these
    return {
        "scenario.schema.json": _written(partial),
        "parameters.schema.json": _written(ParameterFile.model_json_schema(schema_generator=_WithTexts)),
        "vehicle.schema.json": _written(VehicleFile.model_json_schema(schema_generator=_WithTexts)),
    }


def _written(schema: dict[str, Any]) -> str:
    return json.dumps({"$schema": _DIALECT, **_without_null_defaults(schema)}, indent=1) + "\n"


def _without_null_defaults(schema: Any) -> Any:
    """TOML has no null: such a default only says that the key may be absent."""
    if isinstance(schema, list):
        return [_without_null_defaults(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: _without_null_defaults(value)
        for key, value in schema.items()
        if not (key == "default" and value is None)
    }


def main() -> None:
    for name, text in schemas().items():
        write_text_atomically(SHIPPED / name, text)


if __name__ == "__main__":
    main()
