"""One importer in a process of its own: `python -m tests.importers MODULE TASK.json RESULT.npz`."""

import json
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

from tests.importers.task import Task


def main(module: str, task: str, result: str) -> None:
    declared = json.loads(Path(task).read_text(encoding="utf-8"))
    asked = Task(**{**declared, "package": Path(declared["package"])})
    answer = import_module(f"tests.importers.{module}").run(asked)
    np.savez(result, time=answer.time, values=answer.values)


if __name__ == "__main__":
    main(*sys.argv[1:])
