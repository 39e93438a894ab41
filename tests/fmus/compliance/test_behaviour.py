"""An FMU that behaves otherwise than it claims is caught: patched C of our own, and claims that are false."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from fmus import catalogue, files
from fmus.export import native as native_flavour

from .test_check import Members, broken_rules, members, write

NAME = "RovDepthPlant"  # its outputs move at the start values
Patch = dict[str, str]  # what stands in the sources -> what is to stand there


def patched(patch: Patch, folder: Path) -> Path:
    """The native FMU of these sources, compiled."""
    _, content = native_flavour.content(catalogue.load_block(NAME))
    for old, new in patch.items():
        (path,) = [
            path for path, text in content.items() if path.endswith((".c", ".h")) and old.encode() in text
        ]
        assert content[path].count(old.encode()) == 1
        content[path] = content[path].replace(old.encode(), new.encode())
    libraries = native_flavour.libraries(NAME, content, ())
    return files.write_archive(folder / "mutant.fmu", content | libraries)


STEP = 'if (!is_allowed(it, STEPPING, "fmi2DoStep")) return fmi2Error;'
GLOBALS = "static const char *const TYPE_NAMES[]"
LAST_OF_BECOME = "d->parameters_are_stale = d->outputs_are_stale = 0;"
RESET = "if (!it) return fmi2Error;\n    instance_reset(it);"
RESTORE = "((Instance *)c)->data = snapshot->data;"

C_MUTANTS: dict[str, tuple[str, Patch]] = {
    "another version": ("library-says-version", {"return fmi2Version;": 'return "2.1";'}),
    "no second instance": (
        "instantiates-and-frees",
        {
            "it = allocate(1, sizeof *it": (
                "static int count;\n    if (count++) return NULL;\n    it = allocate(1, sizeof *it"
            )
        },
    ),
    "any GUID": ("refuses-a-wrong-guid", {"!fmuGUID || strcmp(fmuGUID, MODEL_GUID)": "!fmuGUID"}),
    "another start value": (
        "start-values-are-as-declared",
        {"= VARIABLES[i].start;": "= VARIABLES[i].start * (i == INTERNAL_STEP ? 0.5 : 1);"},
    ),
    "an output that is no number": (
        "variables-can-be-read",
        {LAST_OF_BECOME: LAST_OF_BECOME + " d->value[FIRST_OUTPUT] = NAN;"},
    ),
    "no end": ("steps-and-terminates", {"it->data.mode = TERMINATED;": "return fmi2Error;"}),
    "a tool by the search path": (
        "needs-no-tool",
        {STEP: STEP + ' if (!*getenv("PATH")) return refuse(it, fmi2Error, "no tool");'},
    ),
    "a reset of the mode alone": (
        "reset-gives-the-start-values",
        {
            RESET: "if (!it) return fmi2Error;\n    it->data.mode = INSTANTIATED;",
            "DBL_MAX; /* infinity: no end */\n    it->data.outputs_are_stale = 1;": "DBL_MAX;",
        },
    ),
    "a reset that forgets a parameter": (
        "reset-gives-the-start-values",
        {RESET: RESET + " it->data.value[INTERNAL_STEP] *= 0.5;"},
    ),
    "one instance at a time": (
        "several-instances",
        {
            GLOBALS: "static int live;\n" + GLOBALS,
            "it = allocate(1, sizeof *it": "if (live++) return NULL;\n    it = allocate(1, sizeof *it",
            "if (it) it->release(it);": "live = 0;\n    if (it) it->release(it);",
        },
    ),
    "instances that share a count": (
        "several-instances",
        {LAST_OF_BECOME: LAST_OF_BECOME + " static int count; d->value[FIRST_OUTPUT] += 1e-9 * count++;"},
    ),
    "one step size": (
        "variable-step-size",
        {STEP: STEP + " static double first; if (!first) first = h; if (h != first) return fmi2Discard;"},
    ),
    "memory leaked": ("memory-is-given-back", {"if (it) it->release(it);": "(void)it;"}),
    "memory freed twice": (
        "memory-is-given-back",
        {
            "if (it) it->release(it);": (
                "const fmi2CallbackFreeMemory release = it->release;\n    release(it), release(it);"
            )
        },
    ),
    "inputs without derivatives": ("input-derivatives", {"if (!is_input(vr[i]))": "if (is_input(vr[i]))"}),
    "an infinite derivative": (
        "output-derivatives",
        {"value[i] = rate[vr[i] - FIRST_OUTPUT]": "value[i] = INFINITY"},
    ),
    "a wrong derivative": ("directional-derivatives", {"dvUnknown[i] = along[": "dvUnknown[i] = 1 + along["}),
    "a state that is not restored": (
        "state-restores",
        {RESTORE: "const Data old = ((Instance *)c)->data;\n    " + RESTORE
         + "\n    memcpy(((Instance *)c)->data.state, old.state, sizeof old.state);"},
    ),
    "a state freed but not forgotten": (
        "state-restores",
        {"*FMUstate = NULL;\n    return fmi2OK;": "return fmi2OK;"},
    ),
    "a single state": (
        "state-can-be-saved-often",
        {
            GLOBALS: "static Snapshot only;\n" + GLOBALS,
            "*FMUstate ? *FMUstate : it->allocate(1, sizeof *snapshot);": "&only;",
        },
    ),
    "a state that is not written over": (
        "state-can-be-saved-often",
        {"snapshot->data = it->data;": "if (!*FMUstate) snapshot->data = it->data;"},
    ),
    "a serialised state cut short": (
        "serialised-state-restores",
        {"*size = SERIALIZED_SIZE;": "*size = SERIALIZED_SIZE - 8;"},
    ),
    "a serialised state without its states": (
        "serialised-state-restores",
        {
            "*(Snapshot *)*FMUstate = restored;": (
                "memset(restored.data.state, 0, sizeof restored.data.state);\n"
                "    *(Snapshot *)*FMUstate = restored;"
            )
        },
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", C_MUTANTS)
def test_broken_behaviour_is_caught(tmp_path: Path, what: str) -> None:
    rule, patch = C_MUTANTS[what]
    broken = broken_rules(patched(patch, tmp_path))
    assert rule in broken, broken


def test_sources_without_a_patch_break_no_rule(tmp_path: Path) -> None:
    assert broken_rules(patched({}, tmp_path)) == {}


def test_a_crash_is_a_finding_of_each_rule_that_steps_and_of_no_other(tmp_path: Path) -> None:
    broken = broken_rules(patched({STEP: STEP + " *(volatile int *)0 = 1;"}, tmp_path))
    assert {"steps-and-terminates", "several-instances", "serialised-state-restores"} <= set(broken)
    assert not {"instantiates-and-frees", "start-values-are-as-declared", "directional-derivatives"} & set(
        broken
    )
    assert {message for (message,) in broken.values()} <= {
        "the FMU ended the process with SIGSEGV", "the FMU ended the process with SIGILL"
    }  # fmt: skip


def test_a_hang_is_a_finding_of_the_rule_that_it_stops(tmp_path: Path) -> None:
    hang = STEP + " for (volatile int go = h < 0.01; go;) {}"  # of the least step of variable-step-size alone
    broken = broken_rules(patched({STEP: hang}, tmp_path), timeout=2)
    assert broken == {"variable-step-size": ("the FMU took more than 2 s",)}


FALSE_CLAIMS = [
    ("input-derivatives", 'canInterpolateInputs="false"', 'canInterpolateInputs="true"'),
    ("output-derivatives", 'maxOutputDerivativeOrder="0"', 'maxOutputDerivativeOrder="1"'),
    (
        "directional-derivatives",
        'providesDirectionalDerivative="false"',
        'providesDirectionalDerivative="true"',
    ),
]


@pytest.mark.parametrize(("rule", "old", "new"), FALSE_CLAIMS)
def test_a_capability_that_is_claimed_but_not_there_is_caught(
    python_built: Mapping[str, Path], tmp_path: Path, rule: str, old: str, new: str
) -> None:
    content: Members = members(python_built["L1Controller"])
    xml = content["modelDescription.xml"].decode()
    assert old in xml
    content["modelDescription.xml"] = xml.replace(old, new).encode()
    assert rule not in broken_rules(python_built["L1Controller"])
    assert rule in broken_rules(write(content, tmp_path / "mutant.fmu"))
