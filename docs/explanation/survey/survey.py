"""Check the FMUs of `fmus.toml`; CLONES are folders with clones of their repositories, bare or not.

survey.py check FINDINGS CLONES...    writes a line of JSON for each FMU, goes on where it stopped
survey.py tables FINDINGS             prints what the survey found, as tables of Markdown
survey.py compare BEFORE AFTER        prints the rules that find something else
survey.py agree FOLDER...             prints the findings about FMUs in folders that differ with --only
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

LIST = Path(__file__).with_name("fmus.toml")
PASSED = {"outcome": "passed", "why": ""}
BROKEN = ("error", "deviation", "advice")
OF_ONE_RUN = re.compile(r"fmu-check-\w+|b'.*?'|b\".*?\"|-?\d[\d.e+-]*")  # in messages
Fmu = dict[str, Any]


def listed() -> Iterator[Fmu]:
    """Yields repository, revision, path, tool, version and year of each FMU."""
    for repository in tomllib.loads(LIST.read_text(encoding="utf-8"))["repository"]:
        for fmu in repository["fmus"]:
            yield {"repository": repository["name"], "revision": repository["revision"], **fmu}


def content(fmu: Fmu, repositories: Sequence[Path]) -> bytes | None:
    """Returns the FMU out of the first repository that holds it."""
    name = f"{fmu['revision']}:{fmu['path']}"
    for folder in repositories:
        git = subprocess.run(
            ["git", "-C", folder, "cat-file", "blob", name], capture_output=True, check=False
        )
        if not git.returncode:
            return git.stdout
    return None


def checked(number: int, fmu: Fmu, repositories: Sequence[Path], folder: Path) -> Fmu:
    """Returns the FMU with the seconds that its check took, and the rules that did not pass."""
    if (octets := content(fmu, repositories)) is None:
        return {**fmu, "unchecked": "no clone holds it"}
    file = folder / f"{number:03d}" / Path(fmu["path"]).name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(octets)
    begin = time.monotonic()
    try:
        rules = judged(file)
    except (subprocess.TimeoutExpired, json.JSONDecodeError) as error:
        return {**fmu, "unchecked": str(error)}
    return {**fmu, "seconds": round(time.monotonic() - begin, 1), "rules": rules}


def judged(file: Path, *options: str) -> dict[str, Fmu]:
    """Returns rule -> outcome and reason, of the rules that an FMU does not pass."""
    command = [sys.executable, "-m", "fmus.compliance", "--format", "json", *options, str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    rules = {}
    for rule in json.loads(ended.stdout)["fmus"][0]["rules"]:
        why = rule["messages"] or rule["not_judged"] or rule["not_applicable"]
        rules |= {rule["rule"]: {"outcome": rule["outcome"], "why": why}} if why else {}
    return rules


def agree(folders: Sequence[Path]) -> int:
    """Prints each finding about the FMUs in folders that differs if its rule alone is judged, numbers and
    bytes aside; returns how many do.
    """
    count, files = 0, sorted(file for folder in folders for file in folder.rglob("*.fmu"))
    for file in files:
        for name, rule in judged(file).items():
            alone = judged(file, "--only", name).get(name, PASSED) if rule["outcome"] in BROKEN else rule
            count += told_apart(f"{file} {name}", rule, alone)
    print(f"{count} findings differ, {len(files)} FMUs")
    return count


def told_apart(name: str, was: Fmu, now: Fmu) -> bool:
    """Prints two results of one rule if they differ by more than numbers and bytes; returns whether."""
    differ = OF_ONE_RUN.sub("#", str(was)) != OF_ONE_RUN.sub("#", str(now))
    if differ:
        print(name, f"- {was}", f"+ {now}", sep="\n  ", flush=True)
    return differ


def check(findings: Path, clones: Sequence[Path], keep: Path | None) -> None:
    """Checks each listed FMU that the file of findings does not have yet, and appends its line."""
    folders = {git.parent for folder in clones for git in folder.glob("**/HEAD")}
    repositories = sorted(folder for folder in folders if (folder / "objects").is_dir())
    done = read(findings).keys() if findings.exists() else set()
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(2) as pool:
        left = [(number, fmu) for number, fmu in enumerate(listed()) if identity(fmu) not in done]
        tasks = [
            pool.submit(checked, number, fmu, repositories, keep or Path(temporary)) for number, fmu in left
        ]
        for fmu in (task.result() for task in as_completed(tasks)):
            with findings.open("a", encoding="utf-8") as file:
                file.write(json.dumps(fmu) + "\n")
            print(fmu["path"], fmu.get("unchecked", f"{fmu.get('seconds')} s"), flush=True)


def identity(fmu: Fmu) -> str:
    return f"{fmu['repository']} {fmu['revision'][:8]} {fmu['path']}"


def read(findings: Path) -> dict[str, Fmu]:
    """Returns identity -> FMU of a file of findings."""
    return {identity(fmu): fmu for fmu in map(json.loads, findings.read_text("utf-8").splitlines())}


def tables(findings: Path) -> None:
    """Prints how many FMUs of which tools and years break each rule, and why behaviour was not judged."""
    fmus = [fmu for fmu in read(findings).values() if "rules" in fmu]
    broken: dict[tuple[str, str], list[Fmu]] = {}
    for fmu in fmus:
        for name, rule in fmu["rules"].items():
            if rule["outcome"] in BROKEN:
                broken.setdefault((rule["outcome"], name), []).append(fmu)
    print("| outcome | rule | FMUs | of judged | tools and years |\n|---|---|---:|---:|---|")
    for (level, name), these in sorted(
        broken.items(), key=lambda item: (BROKEN.index(item[0][0]), -len(item[1]))
    ):
        judged = sum(fmu["rules"].get(name, PASSED)["outcome"] in ("passed", *BROKEN) for fmu in fmus)
        print(f"| {level} | `{name}` | {len(these)} | {judged} | {', '.join(by_tool(these))} |")
    steps = [fmu["rules"].get("steps-and-terminates", PASSED) for fmu in fmus]
    print("\n| no behaviour judged | FMUs |\n|---|---:|")
    for reason, count in Counter(r["why"] for r in steps if r["outcome"] == "not judged").most_common():
        print(f"| {reason} | {count} |")


def by_tool(fmus: Sequence[Fmu]) -> Iterator[str]:
    """Yields each tool with its years and the number of its FMUs, the most first."""
    for tool, count in Counter(fmu["tool"] for fmu in fmus).most_common():
        years = sorted({fmu["year"].lstrip("~") for fmu in fmus if fmu["tool"] == tool})
        yield f"{tool} {'-'.join(dict.fromkeys((years[0], years[-1])))} ({count})"


def compare(before: Path, after: Path) -> int:
    """Prints each rule whose outcome or messages differ, numbers and bytes aside; returns how many do."""
    old, new, count = read(before), read(after), 0
    for name in sorted(old.keys() & new.keys()):
        rules = [side[name].get("rules", {}) for side in (old, new)]
        for rule in sorted(rules[0].keys() | rules[1].keys()):
            was, now = (side.get(rule, PASSED) for side in rules)
            count += told_apart(f"{name} {rule}", was, now)
    print(f"{count} differences, {len(old.keys() & new.keys())} FMUs in both")
    return count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("action", choices=("check", "tables", "compare", "agree"))
    parser.add_argument("paths", type=Path, nargs="+", metavar="PATH")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the extracted FMUs stay")
    options = parser.parse_args()
    findings, *others = options.paths
    if options.action == "compare":
        return min(1, compare(findings, *others))
    if options.action == "agree":
        return min(1, agree(options.paths))
    if options.action == "check":
        check(findings, others, options.keep)
    tables(findings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
