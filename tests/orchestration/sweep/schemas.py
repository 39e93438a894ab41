"""The JSON schemas of scenario and parameter files, which editors use to check and complete them.

`python -m tests.orchestration.sweep.schemas` writes them beside the shipped scenarios.
"""

import json
from typing import Any

from pydantic import Field, create_model

from fmus.files import write_text_atomically
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.scenario import SHIPPED
from orchestration.sweep.varied import SweepTable

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """File name -> schema as JSON."""
    optional: Any = Field(default=None)
    sweep: Any = (SweepTable, optional)
    scenario = create_model("Scenario", __base__=ScenarioFile, __doc__=ScenarioFile.__doc__, sweep=sweep)
    partial = scenario.model_json_schema()
    for table in (partial, partial["$defs"]["ExperimentTable"], partial["$defs"]["SweepTable"]):
        del table["required"]  # a base may give these
    return {
        "scenario.schema.json": _written(partial),
        "parameters.schema.json": _written(ParameterFile.model_json_schema()),
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
