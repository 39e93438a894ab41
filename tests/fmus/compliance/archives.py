"""FMUs as their members, and the rules that they break."""

import zipfile
from pathlib import Path

from fmus import files
from fmus.build import builder
from fmus.build import native as native_flavour
from fmus.build.documentation import reference_results
from fmus.build.documentation.reference_results import reference_run
from fmus.compliance.examine import examine
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.registry import all_rules
from fmus.compliance.rule import Stage

Members = dict[str, bytes]
PATCHED = "RovDepthPlant"  # its outputs move at the start values
PYTHONFMU_ERRORS = {  # of its binary
    "resource-locations-of-both-forms", "freed-state-is-null", "step-beyond-the-stop-time-is-an-error",
    "wrong-references-are-refused",
}  # fmt: skip


def members(path: Path) -> Members:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(content: Members, path: Path) -> Path:
    """An archive as it is told to be, also with members that no tool should write."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def broken_rules(path: Path, timeout: float = 100) -> dict[str, tuple[str, ...]]:
    """Rule -> its messages, of the rules that the FMU breaks."""
    return {r.rule.name: r.messages for r in examine(path, timeout) if r.messages}


def errors(path: Path) -> set[str]:
    """Rules that the FMU breaks, of those whose level is error."""
    return {r.rule.name for r in examine(path) if r.outcome == "error"}


def breaks(path: Path, name: str) -> bool:
    """Whether an FMU breaks a rule; a rule that calls no FMU is judged alone, which is quicker."""
    (rule,) = [rule for rule in all_rules() if rule.name == name]
    if rule.stage is Stage.BEHAVIOUR:
        return name in broken_rules(path)
    fmu = FmuFile(path)
    return not rule.condition(fmu) and any(rule.check(fmu))


def patched(patch: dict[str, str], folder: Path, with_references: bool = False) -> Path:
    """A native FMU; in its sources each key of the patch is replaced by its value.

    with_references: with the reference results of the block, which take the check a while
    """
    block = builder.load_block(PATCHED)
    _, content = native_flavour.content(block)
    for old, new in patch.items():
        (path,) = [
            path
            for path, text in content.items()
            if path.endswith((".c", ".h", "modelDescription.xml")) and old.encode() in text
        ]
        assert content[path].count(old.encode()) == 1
        content[path] = content[path].replace(old.encode(), new.encode())
    libraries = native_flavour.libraries(PATCHED, content, ())
    references = reference_results.members(reference_run(block), PATCHED) if with_references else {}
    return files.write_archive(folder / "mutant.fmu", content | libraries | references)
