"""Makes docs/images/live.png, the live page as Chromium shows it: python .ci/live_picture.py."""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent))
from tests.orchestration.results.opened import OpenedPage, chromium

_FILE = Path(__file__).parent.parent / "docs" / "images" / "live.png"
_SIZE = 1200, 860  # px
_COLOURS = 64  # of lines and letters, smoothed


def picture(folder: Path) -> Image.Image:
    """Returns the page of the nominal scenario as it opens, made in a folder."""
    page = folder / "live.html"
    subprocess.run(["l1-depth", "live", "nominal-extended", "--out", str(page)], check=True)
    programs = [
        shutil.which(name) or sys.exit(f"{name} is not installed") for name in ("chromium", "chromedriver")
    ]
    with chromium(*programs, folder / "browser") as driver:
        driver.set_window_size(*_SIZE)
        driver.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
        OpenedPage(driver, page)
        return Image.open(io.BytesIO(driver.get_screenshot_as_png()))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        image = picture(Path(name)).convert("RGB").quantize(_COLOURS)
    image.save(_FILE, optimize=True)
