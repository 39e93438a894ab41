"""A page that is open in a browser, in words of what is done to it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from selenium import webdriver  # whose names are loaded when they are used
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

if TYPE_CHECKING:
    from selenium.webdriver.remote.webelement import WebElement

_PATIENCE_S = 30.0
_OWN = ("file:", "data:", "blob:", "about:", "chrome:")  # the last of the browser's first tab

_PANELS = "[...document.querySelectorAll('#panels figure:not([hidden]) .plot')]"

_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--window-size=1280,1000",
)


def chromium(program: str, driver: str, data: Path) -> "webdriver.Chrome":
    """Starts a browser that keeps what it needs in a folder."""
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*_FLAGS, f"--user-data-dir={data}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options, webdriver.ChromeService(driver))


class OpenedPage:
    """A page in a browser, with what its console and its network have said since it was opened."""

    def __init__(self, driver: "webdriver.Chrome", file: Path) -> None:
        self.driver = driver
        for log in ("browser", "performance"):
            driver.get_log(log)  # what earlier pages have said
        driver.get(file.as_uri())
        self.settled()

    def settled(self) -> "OpenedPage":
        """Once every figure is drawn."""
        self.until(lambda: self.run("return document.body.dataset.drawing === '0'"))
        return self

    def until(self, true: Callable[[], Any]) -> None:
        from selenium.webdriver.support.ui import WebDriverWait

        WebDriverWait(self.driver, _PATIENCE_S, poll_frequency=0.05).until(lambda driver: true())

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def all(self, selector: str) -> list["WebElement"]:
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def one(self, selector: str) -> "WebElement":
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def click(self, element: "WebElement") -> "OpenedPage":
        self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", element)
        element.click()
        return self.settled()

    def tick(self, name: str) -> "OpenedPage":
        """Press the tick box of a run or signal."""
        return self.click(self.one(f"input[type=checkbox][value='{name}']"))

    def write(self, selector: str, text: str) -> "OpenedPage":
        """Give an input field a value, as who types it and goes on."""
        self.one(selector).send_keys(Keys.CONTROL, "a", Keys.NULL, text, Keys.TAB)
        return self.settled()

    def choose(self, selector: str, label: str) -> "OpenedPage":
        """An option of a select, by its text."""
        options = self.one(selector).find_elements(By.TAG_NAME, "option")
        (option,) = [option for option in options if option.text.strip() == label]
        option.click()
        return self.settled()

    def shown(self) -> list[str]:
        """Names of the lines that are drawn, in any panel."""
        return self.run(
            f"return {_PANELS}.flatMap((plot) => plot.chart.series.slice(1)).map((line) => line.label)"
        )

    def line(self, name: str) -> dict[str, list[float]]:
        """The x and y that are drawn of a line; None where it has a gap."""
        return self.run(
            f"for (const {{chart}} of {_PANELS}) {{"
            "  const i = chart.series.findIndex((line) => line.label === arguments[0]);"
            "  const has = (y, at) => chart.data[i][at] !== undefined;"
            "  if (i > 0) return {x: chart.data[0].filter(has), y: chart.data[i].filter(has)};"
            "}",
            name,
        )

    def ranges(self, axis: str = "x") -> list[list[float]]:
        """From and to of an axis of each panel."""
        return self.run(
            f"return {_PANELS}.map(({{chart}}) => [chart.scales.{axis}.min, chart.scales.{axis}.max])"
        )

    def has_ink(self, plot: "WebElement", x: float, y: float, colour: str) -> bool:
        """Whether a chart has a colour, "#rrggbb", within 2 px of a point of its axes."""
        pixels = self.run(
            "const {chart} = arguments[0], at = [];"
            "for (const [axis, value] of [['x', arguments[1]], ['y', arguments[2]]])"
            "  at.push(Math.round(chart.valToPos(value, axis, true)) - 2);"
            "const copy = document.createElement('canvas').getContext('2d', {willReadFrequently: true});"
            "copy.drawImage(chart.ctx.canvas, ...at, 5, 5, 0, 0, 5, 5);"
            "const {data} = copy.getImageData(0, 0, 5, 5);"
            "return Array.from({length: 25}, (_, i) => [...data.slice(4 * i, 4 * i + 4)])",
            plot,
            x,
            y,
        )
        wanted = (*bytes.fromhex(colour[1:]), 255)
        rounding = 8  # of the edge of a line, which is mixed with what is behind
        return any(
            all(abs(a - b) <= rounding for a, b in zip(pixel, wanted, strict=True)) for pixel in pixels
        )

    def drag(self, plot: "WebElement", start: float, end: float, down: int = 0) -> "OpenedPage":
        """Across a plot from half its height, between two shares of its x axis, and so many px down."""
        self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", plot)
        area = plot.find_element(By.CSS_SELECTOR, ".u-over")
        width, moves = area.size["width"], webdriver.ActionChains(self.driver)
        moves.move_to_element_with_offset(area, round((start - 0.5) * width), 0)
        moves.click_and_hold().move_by_offset(round((end - start) * width), down).release().perform()
        return self.settled()

    def point_at(self, plot: "WebElement", x: float, y: float) -> "OpenedPage":
        """The mouse to a point of the axes of a plot."""

        def is_there() -> bool:
            """As a hand does it: moving until the chart, which a scroll has moved, follows."""
            self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", plot)
            across, down, left, top = self.run(
                "const {chart} = arguments[0], box = chart.over.getBoundingClientRect();"
                "return [chart.valToPos(arguments[1], 'x'), chart.valToPos(arguments[2], 'y'), box.x, box.y]",
                plot,
                x,
                y,
            )
            moves = webdriver.ActionChains(self.driver)
            for beside in (2, 0):
                moves.w3c_actions.pointer_action.move_to_location(
                    round(left + across) + beside, round(top + down)
                ).pause(0.1)
            moves.perform()
            cursor = self.run("const {left, top} = arguments[0].chart.cursor; return [left, top]", plot)
            return max(abs(cursor[0] - across), abs(cursor[1] - down)) <= 1.0

        self.until(is_there)
        return self

    def click_point(self, plot: "WebElement", x: float, y: float) -> "OpenedPage":
        """The mouse on a point of a plot."""
        self.point_at(plot, x, y)
        webdriver.ActionChains(self.driver).click().perform()
        return self.settled()

    def emulate(self, **media: str) -> "OpenedPage":
        """The medium (media=) and features such as prefers_color_scheme=."""
        medium = media.pop("media", "")
        features = [{"name": name.replace("_", "-"), "value": value} for name, value in media.items()]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": medium, "features": features})
        return self.settled()

    def at_width(self, width: int) -> "OpenedPage":
        """On a screen of that many px; a narrow one is that of a phone."""
        metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        return self.settled()

    def broken_words(self, selector: str) -> list[str]:
        """Words of these elements that stand on several lines; a name may be broken at a hyphen."""
        return self.run(
            "const broken = [];"
            "for (const element of document.querySelectorAll(arguments[0])) {"
            "  const texts = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);"
            "  for (let text = texts.nextNode(); text; text = texts.nextNode())"
            "    for (const word of text.data.matchAll(/[^\\s-]+-?/g)) {"
            "      const range = document.createRange();"
            "      range.setStart(text, word.index);"
            "      range.setEnd(text, word.index + word[0].length);"
            "      const tops = [...range.getClientRects()].map((box) => box.top);"
            "      if (new Set(tops).size > 1) broken.push(word[0]);"
            "    }"
            "}"
            "return broken",
            selector,
        )

    def squeezed_labels(self) -> list[str]:
        """Labels of the cells of a phone's tables that stand beside a value of several lines."""
        return self.run(
            "return [...document.querySelectorAll('.cards tbody td')].filter((cell) => {"
            "  const values = document.createRange();"
            "  values.selectNodeContents(cell);"
            "  const top = Math.min(...[...values.getClientRects()].map((box) => box.top));"
            "  const box = cell.getBoundingClientRect();"
            "  const line = parseFloat(getComputedStyle(cell).lineHeight);"
            "  return box.height >= 2 * line && top < box.top + 0.9 * line;"
            "}).map((cell) => cell.dataset.label)"
        )

    def complaints(self) -> list[str]:
        """What the console reports."""
        return [entry["message"] for entry in self.driver.get_log("browser")]  # type: ignore[no-untyped-call]

    def fetched(self) -> list[str]:
        """Addresses of everything that was asked for and is not part of the page."""
        messages = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        asked = [
            message["params"] for message in messages if message["method"] == "Network.requestWillBeSent"
        ]
        return [
            request["request"]["url"] for request in asked if not request["request"]["url"].startswith(_OWN)
        ]
