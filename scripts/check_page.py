"""Opens pages of runs (report.html) in headless Chromium and tries what a reader would.

    apt-get install -y chromium chromium-driver python3-selenium
    python3 scripts/check_page.py runs/optimize-heated-channel/report.html --screenshots shots

A page renders without an error on the console, asks for nothing outside of itself, fits a phone, can be read in the
dark; its slider moves the wall, its box and its time change the particles, and nothing moves by itself.
"""

import argparse
import pathlib
import sys
import time

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

SIZES = {"desktop": (1280, 900), "phone": (390, 844)}
# Of text on its ground (WCAG 2, level AA).
CONTRAST = 4.5


def browser():
    options = webdriver.ChromeOptions()
    for option in ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--force-device-scale-factor=1"]:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = Service(executable_path="/usr/bin/chromedriver")
    return webdriver.Chrome(options=options, service=service)


def emulate(driver, scheme, size, motion="no-preference"):
    features = [{"name": "prefers-color-scheme", "value": scheme}, {"name": "prefers-reduced-motion", "value": motion}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    width, height = SIZES[size]
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": size == "phone"}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    time.sleep(0.4)


def shoot(driver, path):
    """The whole page, not only what the window shows."""
    import base64

    size = driver.execute_cdp_cmd("Page.getLayoutMetrics", {})["cssContentSize"]
    clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
    shot = driver.execute_cdp_cmd("Page.captureScreenshot", {"clip": clip, "captureBeyondViewport": True})
    path.write_bytes(base64.b64decode(shot["data"]))


def luminance(color):
    numbers = [float(part) for part in color[color.index("(") + 1 : -1].split(",")[:3]]
    linear = [n / 255 / 12.92 if n / 255 <= 0.04045 else ((n / 255 + 0.055) / 1.055) ** 2.4 for n in numbers]
    return sum(weight * part for weight, part in zip((0.2126, 0.7152, 0.0722), linear))


def contrast(one, other):
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


class Page:
    def __init__(self, driver, path):
        self.driver, self.path, self.faults, self.seen = driver, path, [], []
        driver.get_log("browser")
        driver.get(path.resolve().as_uri())
        time.sleep(0.6)

    def expect(self, holds, what):
        (self.seen if holds else self.faults).append(what)

    def one(self, selector):
        found = self.driver.find_elements(By.CSS_SELECTOR, selector)
        return found[0] if found else None

    def js(self, code, *arguments):
        return self.driver.execute_script(code, *arguments)

    def picture(self, selector):
        return self.js("return [...document.querySelectorAll(arguments[0])].map(c => c.toDataURL()).join()", selector)

    def wall(self):
        lines = self.js("return [...document.querySelectorAll('.wall-now')].map(p => p.getAttribute('d')).join()")
        return lines or self.picture("#wall canvas")

    def check(self):
        self.expect(self.js("return document.querySelector('h1').textContent.trim().length > 10"), "says its result")
        self.expect(self.js("return document.documentElement.lang") == "en", "has a language")
        plots = self.js("return [...document.querySelectorAll('[data-chart]')].map(e => e.querySelectorAll('svg path').length)")
        self.expect(all(plots), f"draws its {len(plots)} charts")
        outside = self.js("return performance.getEntriesByType('resource').map(e => e.name).filter(n => !n.startsWith('data:'))")
        self.expect(outside == [], f"asks for nothing outside ({outside})")
        bare = self.js("""return [...document.querySelectorAll('input, select, button')].filter(
            e => !(e.labels && e.labels.length) && !e.textContent.trim() && !e.getAttribute('aria-label')).length""")
        self.expect(bare == 0, "every control has a name")
        blind = self.js("""return [...document.querySelectorAll('img, .plot svg, canvas')].filter(
            e => !e.getAttribute('alt') && !e.getAttribute('aria-label') && !e.closest('[aria-hidden], .legend')).length""")
        self.expect(blind == 0, "every picture has a text")
        self.walls()
        self.particles()
        for scheme in ["light", "dark"]:
            for size in SIZES:
                emulate(self.driver, scheme, size)
                wide = self.js("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
                self.expect(wide <= 0, f"fits a {size} ({wide} too wide)")
                for selector in ["body", ".quiet", "a", "thead th", "h1"]:
                    pair = self.js("""const e = document.querySelector(arguments[0]); if (!e) return null;
                        const card = e.closest('.card') || document.body;
                        return [getComputedStyle(e).color, getComputedStyle(card).backgroundColor]""", selector)
                    if pair:
                        ratio = contrast(*pair)
                        self.expect(ratio >= CONTRAST, f"{scheme}: {selector} has contrast {ratio:.1f}")
        ground = self.js("return getComputedStyle(document.body).backgroundColor")
        self.expect(luminance(ground) < 0.1, "is dark in the dark")
        emulate(self.driver, "light", "desktop")
        errors = [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
        self.expect(errors == [], f"no error on the console {errors}")

    def walls(self):
        slider = self.one("#epoch")
        if slider is None:
            return
        last = int(slider.get_attribute("max"))
        before, said = self.wall(), self.one("#epoch-now").text
        self.expect(before, "draws the wall")
        if self.one("#wall canvas"):
            shades = self.js("""const c = document.querySelector('#wall canvas'), r = c.width / c.clientWidth, h = c.height;
                const d = c.getContext('2d').getImageData(Math.round(r * (c.clientWidth - 73)), 0, 1, h).data;
                return new Set(Array.from({ length: h }, (_, y) => d.slice(4 * y, 4 * y + 3).join())).size""")
            self.expect(shades > 50, f"a wall over x and z has a scale of colours ({shades})")
        # By the keyboard alone.
        slider.send_keys(Keys.HOME if int(slider.get_attribute("value")) > 1 else Keys.END)
        time.sleep(0.2)
        if last > 1:
            self.expect(self.wall() != before, "the slider moves the wall")
            self.expect(self.one("#epoch-now").text != said, "the slider says which epoch")
        self.one(f"button[data-epoch='{last}']").click()
        self.expect(int(slider.get_attribute("value")) == last, "a button moves the slider")

    def particles(self):
        choice = self.one("#quantity")
        if choice is None:
            return
        panels = "canvas[data-panel]"
        seen = set()
        options = choice.find_elements(By.TAG_NAME, "option")
        for option in options:
            option.click()
            time.sleep(0.1)
            seen.add(self.picture(panels))
        self.expect(len(seen) == len(options), f"{len(options)} quantities look different")
        options[0].click()
        time.sleep(0.1)
        still = self.picture(panels)
        time.sleep(0.6)
        self.expect(self.picture(panels) == still, "nothing moves by itself")
        if self.one("#time").get_attribute("max") == "0":
            return
        self.one("#time").send_keys(Keys.HOME)
        time.sleep(0.2)
        self.expect(self.picture(panels) != still, "time changes the particles")
        before = self.picture(panels)
        self.one("#play").click()
        time.sleep(0.8)
        self.expect(self.picture(panels) != before, "it plays")
        self.one("#play").click()
        time.sleep(0.1)
        before = self.picture(panels)
        time.sleep(0.5)
        self.expect(self.picture(panels) == before, "it stops")
        self.one("#time").send_keys(Keys.END)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("pages", nargs="+", type=pathlib.Path)
    arguments.add_argument("--screenshots", type=pathlib.Path, metavar="DIR")
    given = arguments.parse_args()
    failed = False
    with browser() as driver:
        for number, path in enumerate(given.pages):
            emulate(driver, "light", "desktop")
            page = Page(driver, path)
            page.check()
            failed |= bool(page.faults)
            print(f"{path}: {len(page.seen)} checks pass, {len(page.faults)} fail")
            for fault in page.faults:
                print(f"  FAILED: {fault}")
            if given.screenshots:
                given.screenshots.mkdir(parents=True, exist_ok=True)
                for scheme in ["light", "dark"]:
                    for size in SIZES:
                        emulate(driver, scheme, size)
                        shoot(driver, given.screenshots / f"{number}-{scheme}-{size}.png")
    sys.exit(failed)


main()
