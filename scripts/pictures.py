"""The pictures of the pages, made anew: each is a smaller copy of a file that a command leaves, or a part of its page.

    python3 scripts/figures.py pictures             those that take seconds (and one of some minutes)
    python3 scripts/figures.py pictures-slow        maps of stability and comparisons with other codes: an hour, and runs/peers/accuracy.json
    HYDROGRAD=path/to/hydrograd python3 ...         with another program than target/release/hydrograd

Others are made where they are measured: time-error-a.png, time-error-b.png, time-error-c.png, time-error-d.png and time-error-e.png by
scripts/peers/time_error.py.

A picture carries the words of the drawing from which it was made (its SVG's, as a text chunk "words" of the PNG); the test `tutorial` compares
them with those of a run. A browser makes the smaller copies: chromium, chromium-driver and python3-selenium of Debian
(/usr/bin/python3 scripts/figures.py pictures).
"""
import base64
import html
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib

from pages import ROOT
from speed import OUT, PROGRAM

PICTURES = os.path.join(ROOT, "data/pictures")
EXAMPLES = os.path.join(ROOT, "data/scenes/examples")
MODEL = os.path.join(ROOT, "models/heated-channel")
# What a page shows before it is photographed: an epoch in the middle; the middle of the run.
EPOCH = "const e = document.getElementById('epoch'); e.value = 6; e.dispatchEvent(new Event('input'));"
MIDDLE = "const t = document.getElementById('time'); t.value = Math.round(t.max / 2); t.dispatchEvent(new Event('input'));"

# A command, and its pictures: where each goes, the file in the run's folder, the width in pixels; of a page what is done to it first
# and which part of it is taken.
QUICK = [
    (["optimize"], [
        ("optimize-temperature.png", "temperature.png", 900), ("optimize-shapes.png", "shapes.png", 900),
        ("page.png", "report.html", 1120, EPOCH)]),
    (["optimize", "pin.toml", "--epochs", "5", "--no-verify"], [("pin.png", "temperature.png", 640)]),
    (["optimize", f"{EXAMPLES}/three-pins.toml", "--no-verify"], [("three-pins.png", "temperature.png", 720)]),
    (["optimize", f"{EXAMPLES}/fins.toml", "--no-verify"], [("fins.png", "temperature.png", 720)]),
    (["simulate", f"{EXAMPLES}/three-pins.toml", "--error"], [("error-of-heat.png", "error.png", 720)]),
    (["optimize", "shaped-floor", "--no-verify"], [("shaped-floor.png", "temperature.png", 520)]),
    (["simulate", f"{EXAMPLES}/cylinder.toml"], [("cylinder.png", "temperature.png", 720)]),
    (["simulate", f"{EXAMPLES}/rolls.toml"], [("rolls.png", "flow.png", 520)]),
    (["simulate", f"{EXAMPLES}/hot-block.toml"], [("hot-block.png", "temperature.png", 520)]),
    (["simulate", "dam-break"], [("dam-break.png", "report.html", 800, MIDDLE, "canvas[data-panel]")]),
    (["check-gradient"], [("check-gradient.png", "gradient_check.png", 720)]),
    (["optimize", "heated-channel-3d", "--no-verify"], [("heated-channel-3d-wall.png", "shapes.png", 900)]),
]
# (surrogate-compare.png and surrogate-horizons.png are of `figures.py surrogate-compare`.)
SLOW = [
    (["stress", "--filter", "step"], [
        ("stress-heated-channel.png", "heated-channel-step.png", 1438), ("stress-taylor-green.png", "taylor-green-step.png", 1438),
        ("stress-lid-driven-cavity.png", "lid-driven-cavity-step.png", 1438), ("stress-dam-break.png", "dam-break-step.png", 1438),
        ("stress-taylor-green-3d.png", "taylor-green-3d-step.png", 1438)]),
    (["bench", "accuracy", "--peers", os.path.join(ROOT, "runs/peers/accuracy.json")], [
        ("accuracy-taylor-green.png", "accuracy-taylor-green.png", 1157),
        ("accuracy-heated-channel.png", "accuracy-heated-channel.png", 1157)]),
]


def words(svg):
    """The texts of a drawing, one a line."""
    with open(svg, encoding="utf-8") as file:
        found = re.findall(r"<text[^>]*>\s*(.*?)\s*</text>", file.read(), re.DOTALL)
    return "\n".join(html.unescape(text) for text in found)


def with_words(png, text):
    """The bytes of a PNG with a text chunk before its data."""
    body = b"iTXt" + b"words\0\0\0\0\0" + text.encode()
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    at = png.index(b"IDAT") - 4
    return png[:at] + chunk + png[at:]


def photograph(file, width, to, script="", part="body"):
    """A picture at this width, or a part of a page; of the whole page its upper end."""
    from selenium import webdriver
    if file.endswith(".png"):
        part, alone = "img", f"{to}.html"
        with open(alone, "w", encoding="utf-8") as page:
            page.write(f"<body style='margin: 0'><img src='file://{file}' style='display: block; width: {width}px'>")
        file = alone
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--hide-scrollbars", f"--window-size={width},1200"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options)
    try:
        driver.get(f"file://{file}")
        driver.execute_async_script(f"{script} const done = arguments[0]; requestAnimationFrame(() => setTimeout(done, 300));")
        clip = driver.execute_script(
            "const r = document.querySelector(arguments[0]).getBoundingClientRect(); return {x: r.x, y: r.y, width: r.width, height: r.height}", part)
        clip["height"] = min(clip["height"], 1.35 * clip["width"]) if part == "body" else clip["height"]
        shot = driver.execute_cdp_cmd("Page.captureScreenshot", {"clip": {**clip, "scale": 1}, "captureBeyondViewport": True})
    finally:
        driver.quit()
    with open(to, "wb") as file:
        file.write(base64.b64decode(shot["data"]))


def tutorial_scene(to):
    """pin.toml, as the tutorial writes it."""
    with open(os.path.join(ROOT, "src/cli/TUTORIAL.md"), encoding="utf-8") as file:
        parts = re.findall(r"```toml (?:>> )?pin\.toml\n(.*?)```", file.read(), re.DOTALL)
    with open(to, "w", encoding="utf-8") as file:
        file.write("".join(parts))


def remake(jobs):
    """Runs each command and makes its pictures; returns what was made."""
    made = []
    os.makedirs(OUT, exist_ok=True)
    tutorial_scene(os.path.join(OUT, "pin.toml"))
    for command, pictures in jobs:
        # The name that the run would have by itself: it stands on its page.
        scene = command[1] if command[1:] and not command[1].startswith("--") else "heated-channel"
        folder = os.path.join(OUT, f"{command[0]}-{os.path.basename(scene).removesuffix('.toml')}")
        shutil.rmtree(folder, ignore_errors=True)
        done = subprocess.run([PROGRAM, *command, "--out", folder], capture_output=True, text=True, cwd=OUT)
        if done.returncode != 0:
            sys.exit(f"{' '.join(command)}\n{done.stderr}")
        for name, source, width, *page in pictures:
            source, small = os.path.join(folder, source), os.path.join(OUT, name)
            photograph(source, width, small, *page)
            with open(small, "rb") as file:
                png = file.read()
            with open(os.path.join(PICTURES, name), "wb") as file:
                file.write(png if page else with_words(png, words(source.removesuffix(".png") + ".svg")))
            made.append(f"{name}: hydrograd {' '.join(command)}")
    return "\n".join(made)
