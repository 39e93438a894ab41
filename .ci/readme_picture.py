"""Makes docs/images/depth.png, README's picture of the nominal experiment: python .ci/readme_picture.py."""

import io
import sys
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent))
from matplotlib.figure import Figure

from orchestration import load_scenario, simulate
from orchestration.results.figures import BLUE, ORANGE, draw_curve, figure_style
from orchestration.results.metrics import evaluate

_FILE = Path(__file__).parent.parent / "docs" / "images" / "depth.png"
_RUNS = {"nominal-l1": ("L1", BLUE, "--"), "nominal-extended": ("extended L1", ORANGE, "-")}
_DPI = 150
_SIZE_IN = (1100 / _DPI, 400 / _DPI)
_COLOURS = 64  # of lines and letters, smoothed


def picture() -> Figure:
    """Returns depth and tracking error of the nominal experiment side by side, with both laws."""
    figure = Figure(_SIZE_IN, dpi=_DPI, layout="constrained")
    depth, error = figure.subplots(1, 2)
    for name, (label, colour, dashes) in _RUNS.items():
        chosen = load_scenario(name)
        run = simulate(chosen.system, chosen.experiment)
        rmse = evaluate(run, chosen.metrics)["rmse"]
        line = {"color": colour, "linestyle": dashes}
        draw_curve(depth, run.time, run["plant.depth"], label=label, **line)
        difference = 100.0 * (run["plant.depth"] - run["controller.depth_reference"])
        draw_curve(error, run.time, difference, label=f"{label}: RMSE {rmse:.3g} cm", **line)
    reference = {"color": "black", "linewidth": 0.8, "label": "reference"}
    draw_curve(depth, run.time, run["controller.depth_reference"], **reference)
    depth.invert_yaxis()
    for panel, label in ((depth, "Depth [m]"), (error, "Depth minus reference [cm]")):
        panel.set(xlabel="Time [s]", ylabel=label)
        panel.margins(x=0.0)
        panel.legend()
    return figure


if __name__ == "__main__":
    stream = io.BytesIO()
    with figure_style():
        picture().savefig(stream, format="png", dpi=_DPI)
    Image.open(stream).convert("RGB").quantize(_COLOURS).save(_FILE, optimize=True)
