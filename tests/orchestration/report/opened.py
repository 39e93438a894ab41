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
            "return [...document.querySelectorAll('#panels figure:not([hidden]) .plot')]"
            ".flatMap((plot) => plot.data)"
            ".filter((trace) => trace.visible !== false).map((trace) => trace.name)"
        )

    def line(self, name: str) -> dict[str, list[float]]:
        """The x and y that are drawn of a line."""
        return self.run(
            "const line = [...document.querySelectorAll('#panels figure:not([hidden]) .plot')]"
            ".flatMap((plot) => plot.data).find((trace) => trace.name === arguments[0]);"
            "return {x: [...line.x], y: [...line.y]}",
            name,
        )

    def time_ranges(self) -> list[list[float]]:
        """Of each panel."""
        return self.run(
            "return [...document.querySelectorAll('#panels figure:not([hidden]) .plot')]"
            ".map((plot) => plot._fullLayout.xaxis.range)"
        )

    def drag(self, plot: "WebElement", start: float, end: float) -> "OpenedPage":
        """Across a plot at half its height, from one share of its time axis to another."""
        self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", plot)
        area = plot.find_element(By.CSS_SELECTOR, ".nsewdrag")
        width, moves = area.size["width"], webdriver.ActionChains(self.driver)
        moves.move_to_element_with_offset(area, round((start - 0.5) * width), 0)
        moves.click_and_hold().move_by_offset(round((end - start) * width), 0).release().perform()
        return self.settled()

    def click_point(self, plot: "WebElement", trace: int, point: int) -> "OpenedPage":
        """The mouse on a marker of a plot."""

        def hovers() -> bool:
            """As a hand does it: looking where the point is, and moving until it answers."""
            self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", plot)
            x, y = self.run(
                "const [plot, trace, point] = arguments, {xaxis, yaxis} = plot._fullLayout;"
                "const {x, y} = plot.data[trace], box = plot.getBoundingClientRect();"
                "const [across, down] = [xaxis.d2p(x[point]), yaxis.d2p(y[point])];"
                "return [box.x + xaxis._offset + across, box.y + yaxis._offset + down]",
                plot,
                trace,
                point,
            )
            moves = webdriver.ActionChains(self.driver)
            for position in (x + 2.0, x):
                moves.w3c_actions.pointer_action.move_to_location(round(position), round(y)).pause(0.2)
            moves.perform()
            return bool(plot.find_elements(By.CSS_SELECTOR, ".hovertext"))

        self.until(hovers)
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
