"""FMUs as their members, and the rules that they break."""

import zipfile
from pathlib import Path

from fmus import files
from fmus.compliance.examine import examine
from fmus.generate import builder
from fmus.generate.archive import native_members
from fmus.generate.trace import trace
from tests.shared_builds import with_libraries

Members = dict[str, bytes]
# places in the sources of a native FMU
STEP = "if (!is_allowed(instance, STEPPING, NAME(DoStep))) return ERROR;"
GLOBALS = "static const char *const TYPE_TEXTS[]"
DIRECTIONAL = "providesDirectionalDerivative"
# rule, what our python FMUs declare, and what they might claim
FALSE_CLAIMS = [
    ("input-derivatives", 'canInterpolateInputs="false"', 'canInterpolateInputs="true"'),
    ("allowed-calls-succeed", 'maxOutputDerivativeOrder="0"', 'maxOutputDerivativeOrder="1"'),
    ("directional-derivatives", f'{DIRECTIONAL}="false"', f'{DIRECTIONAL}="true"'),
]
PATCHED = "ExamplePlant"  # the quickest to compile
PYTHONFMU_ERRORS = {"resource-locations-of-both-forms", "freed-state-is-null"}  # of its binary


def write(content: Members, path: Path) -> Path:
    """An archive as it is told to be, also with members that no tool should write."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def broken_rules(path: Path, timeout: float = 100) -> dict[str, tuple[str, ...]]:
    """Rule -> its messages, of the rules that the FMU breaks."""
    return {r.rule.name: r.messages for r in examine(path, timeout) if r.messages}


def patched(patch: dict[str, str], folder: Path) -> Path:
    """A native FMU; in its sources each key of the patch is replaced by its value."""
    _, content = native_members(trace(builder.load_block(PATCHED)))
    for old, new in patch.items():
        (path,) = [
            path
            for path, text in content.items()
            if path.endswith((".c", ".h", "modelDescription.xml")) and old.encode() in text
        ]
        assert content[path].count(old.encode()) == 1
        content[path] = content[path].replace(old.encode(), new.encode())
    return files.write_archive(folder / "mutant.fmu", with_libraries(PATCHED, content))
