"""Memory of a long recording, beside its raw size: a process of its own for each way in either state."""

from tests.speed import pair
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, Pair
from tests.speed.part import Goal, Options, Part, Table
from tests.speed.states import State

TARGETS = {"run": "", "parquet": "1.3 of the raw size", "csv": "constant extra memory"}
_NAMES = {"run": "a run", "parquet": "with its Parquet file", "csv": "with its CSV file"}
_POINTS = 10_000_000


def peak(state: State, two: Pair, points: int, way: str) -> tuple[float, float]:
    """(peak memory, raw size) [bytes] of a run of two small FMUs with one output each, written that way."""
    arguments = *two.fmus.values(), SIGNAL, LEVEL, STEP_SIZE, points, way, two.folder
    most, raw = map(float, state.output_of("recording.py", *arguments))
    return most, raw


def measure(options: Options) -> Part:
    """Each way, in each state."""
    folder = options.folder / "recording"
    folder.mkdir()
    two, rows, goals = pair.build(folder), [], []
    for way, target in TARGETS.items():
        points = 1_000_000 if options.quick else _POINTS
        most, raw = peak(options.now, two, points, way)
        now, before = f"{most / raw:.2f}", ""
        if options.before:
            most_before, raw_before = peak(options.before, two, points, way)
            before = f"{most_before / raw_before:.2f}"
        rows.append((_NAMES[way], before, now, f"{most / 1e6:.0f} MB of {raw / 1e6:.0f} MB"))
        if target:
            goals.append(Goal(f"memory of a long recording, {_NAMES[way]}", target, now, before))
    headings = ("peak memory as a multiple of the raw size", "before", "now", "in all")
    return Part([Table("memory", headings, rows)], goals)
