"""One importer in a process of its own: `python -m tests.importers.worker MODULE JOB.json RESULT.npz`."""

import json
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

from tests.importers.importer_job import ImporterJob


def main(module: str, job: str, result: str) -> None:
    declared = json.loads(Path(job).read_text(encoding="utf-8"))
    asked = ImporterJob(**{**declared, "package": Path(declared["package"])})
    answer = import_module(f"tests.importers.{module}").run(asked)
    np.savez(result, time=answer.time, values=answer.values)


if __name__ == "__main__":
    main(*sys.argv[1:])
