"""Runs zig for zig.exe, whose arguments are a file for the status and the output, and those of zig."""

import re
import subprocess
import sys
from pathlib import Path

DRIVE = next(folder for folder in Path(__file__).parents if folder.name == "drive_c")


def of_linux(argument: str) -> str:
    r"""Returns an argument with the path of Linux for C:\...; Wine's names do not depend on case."""

    def path(match: re.Match[str]) -> str:
        found = DRIVE
        for name in match[1].replace("\\", "/").split("/"):
            same = (entry for entry in found.iterdir() if entry.name.lower() == name.lower())
            found = next(same, found / name) if found.is_dir() else found / name
        return str(found)

    return re.sub(r"(?:\b|(?<=-I))[Cc]:[\\/](.*)", path, argument)


if __name__ == "__main__":
    done, written = Path(of_linux(sys.argv[1])), b"96."
    try:
        command, *options = map(of_linux, sys.argv[2:])
        # zig compiles for the machine where it runs
        target = [] if command != "cc" or "-target" in options else ["-target", "x86_64-windows-gnu"]
        zig = [sys.executable, "-m", "ziglang", command, *target, *options]
        ended = subprocess.run(zig, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
        written = b"%d." % ended.returncode + ended.stdout
    finally:
        beside = done.with_suffix(".part")
        beside.write_bytes(written)
        beside.replace(done)
