#!/usr/bin/env python3
"""Draws scenes of one's own at random and runs them: what ends, what is refused or diverges, and where the first suggestion leads.

    python3 scripts/random_scenes.py                        1000 scenes (--count N) of --seed 0; --only 17 42 runs those alone
    python3 scripts/random_scenes.py --keep FOLDER          keeps the files of the scenes, of what they printed and of the table

One to four shapes of all kinds stand at random places in two dimensions (one scene in six: three): they overlap, are thin or tiny, touch sides
or reach out of the box. Spacings, viscosities, body forces, temperatures and velocities of walls are random too. A run may end (exit code 0),
be refused (2) or diverge (3). After a refusal or divergence the first suggestion of its `try:` line is applied once. The script fails if
a run ends in another way or takes longer than 120 s, if an error suggests nothing, if a divergence names no cause, or if less than
90 % of the suggestions lead to a run that ends. HYDROGRAD names another program than target/release/hydrograd. Needs no packages.
"""
import argparse
import collections
import concurrent.futures
import json
import math
import os
import random
import re
import subprocess
import sys
import tempfile

sys.dont_write_bytecode = True
from pages import table
from speed import PROGRAM

# Seconds after which a run counts as one that hangs.
LIMIT = 120
# A run with more particles is not what this script is for.
MOST_PARTICLES = 3000
# What a divergence says that knows no cause.
NO_CAUSE = "it is the arrangement of the particles"
ASSIGNMENT = re.compile(r"[a-z_]+(?:\[\d+\])?(?:\.[a-z_]+(?:\[\d+\])?)*=(?:\[[^\]]*\]|\"[^\"]*\"|[^\s,;)]+)")


def drawn(seed, number):
    """The text of a scene."""
    draw = random.Random(f"{seed}-{number}")
    dimension = 3 if draw.random() < 1 / 6 else 2
    # The box is a whole number of spacings long, but for one scene in twelve.
    dx = draw.choice([0.02, 0.025, 0.04, 0.05] if dimension == 2 else [0.05, 0.0625, 0.1])
    cells = [draw.randrange(*(10, 45) if dimension == 2 else (8, 14)) for _ in range(dimension)]
    size = [round(count * dx, 6) for count in cells]
    if draw.random() < 1 / 12:
        dx = draw.choice([0.03, 0.037, 0.045])
    heat = draw.random() < 0.4
    speed = draw.choice([0.0, 0.0, 0.3, 1.0])
    periodic = [draw.random() < 0.6 if d == 0 else draw.random() < 0.25 for d in range(dimension)]
    near = lambda d: draw.uniform(-0.1, 1.1) * size[d]
    # Lengths from a third of a spacing to half of the box.
    length = lambda: dx * math.exp(draw.uniform(math.log(0.3), math.log(0.5 * min(cells))))
    vector = lambda numbers: "[" + ", ".join(f"{x:.5g}" for x in numbers) + "]"

    def shape():
        kinds = ["box", "disc", "polygon", "polyline", "where"] + ["cylinder"] * (dimension == 3)
        kind = draw.choice(kinds)
        lines = ["[[shapes]]", f'kind = "{kind}"']
        centre = [near(d) for d in range(dimension)]
        if kind == "box":
            half = [0.5 * length() for _ in range(dimension)]
            lower, upper = [c - h for c, h in zip(centre, half)], [c + h for c, h in zip(centre, half)]
            side = draw.randrange(dimension)
            # Along a side, from one end of the box to the other, or at a side.
            if draw.random() < 0.3:
                lower[side], upper[side] = -size[side], 2 * size[side]
            elif draw.random() < 0.3:
                lower[side] = 0.0
                upper[side] = max(upper[side] - centre[side], 0.3 * dx)
            lines += [f"lower = {vector(lower)}", f"upper = {vector(upper)}"]
        elif kind in ("disc", "cylinder"):
            lines += [f"centre = {vector(centre)}", f"radius = {length():.5g}"]
            lines += [f'axis = "{draw.choice("xyz")}"'] if kind == "cylinder" else []
        elif kind == "polygon":
            if draw.random() < 0.3:
                points = wing(centre, 2 * length(), draw.uniform(-0.3, 0.3), draw.choice([0.06, 0.12, 0.2]))
            else:
                turns = sorted(draw.uniform(0, 2 * math.pi) for _ in range(draw.randrange(3, 7)))
                points = [(centre[0] + length() * math.cos(a), centre[1] + length() * math.sin(a)) for a in turns]
            lines += ["points = [" + ", ".join(vector(point) for point in points) + "]"]
        elif kind == "polyline":
            points = [(near(0), near(1)) for _ in range(draw.randrange(2, 5))]
            lines += ["points = [" + ", ".join(vector(point) for point in points) + "]"]
            lines += [f"thickness = {dx * draw.choice([0.3, 0.8, 1.5, 3.0, 5.0]):.5g}"]
        else:
            along, a = draw.randrange(dimension), draw.uniform(0.05, 0.3) * size[1]
            wave = f"{a:.4g}*(1 + 0.5*sin({draw.choice([1, 2])}*2*PI*x/{size[0]:g}))"
            lines += [
                draw.choice(
                    [
                        f'positive = "{wave} - y"',
                        f'positive = "y - {size[1]:g} + {wave}"',
                        f'positive = "{length():.4g} - abs({"xyz"[along]} - {centre[along]:.4g})"',
                        f'positive = "1 - ((x - {centre[0]:.4g})/{length():.4g})^2 - ((y - {centre[1]:.4g})/{length():.4g})^2"',
                    ]
                )
            ]
        if draw.random() < 0.1:
            return lines + ['fill = "fluid"']
        if speed and draw.random() < 0.4:
            moves = [draw.uniform(-1, 1) * speed for _ in range(dimension)]
            if kind == "disc" and draw.random() < 0.5:
                turns = [f'"{speed:g}*({centre[1]:.4g} - y)/{size[1]:g}"', f'"{speed:g}*(x - {centre[0]:.4g})/{size[1]:g}"', "0.0"]
                lines.append("velocity = [" + ", ".join(turns[:dimension]) + "]")
            else:
                lines.append(f"velocity = {vector(moves)}")
        if draw.random() < (0.6 if heat else 0.02):
            lines.append(draw.choice([f"temperature = {draw.uniform(0, 3):.3g}", 'temperature = "1 + x"']))
        return lines

    force = [draw.choice([0.0, 0.1, 1.0, 5.0]) if p else draw.choice([0.0, 0.0, -1.0]) for p in periodic]
    lines = ['scene = "custom"', "[region]", f"size = {vector(size)}", f"periodic = {json.dumps(periodic)}"]
    lines += [f"acceleration = {vector(force)}", "[resolution]", f"dx = {dx}", "[time]", f"steps = {draw.choice([50, 100, 200, 300])}"]
    lines += ["[fluid]", f"viscosity = {draw.choice([0.001, 0.005, 0.02, 0.1])}", f"conductivity = {draw.choice([0.002, 0.02, 0.1])}"]
    lines += [f"reference_velocity = {draw.choice([0.3, 1.0, 1.0, 2.0])}"]
    starts = ["[]", "[]", vector([draw.uniform(-1, 1) * speed for _ in periodic])]
    lines += ["[initial]", f"velocity = {draw.choice(starts)}"]
    lines += ["temperature = " + draw.choice(["1.0", '"1 + 0.3*sin(2*PI*x)"'])] if heat else []
    if draw.random() < 0.15:
        lines += ["[method]", 'name = "standard"', "background_pressure_factor = 0.05"]
    for _ in range(draw.randrange(1, 5)):
        lines += shape()
    return "\n".join(lines) + "\n"


def wing(nose, chord, angle, thickness):
    """The outline of a NACA four-digit wing section, from the tail around the nose."""
    half = lambda x: 5 * thickness * (0.2969 * math.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    along = [0.5 * (1 + math.cos(math.pi * k / 10)) for k in range(11)]
    outline = [(x, half(x)) for x in along] + [(x, -half(x)) for x in along[-2:0:-1]]
    turned = lambda x, y: (x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle))
    return [(nose[0] + chord * a, nose[1] + chord * b) for a, b in (turned(*point) for point in outline)]


def ran(file, sets):
    """Exit code (none: it did not end) and what was said of a run."""
    with tempfile.TemporaryDirectory() as folder:
        command = [PROGRAM, "simulate", file, "--threads", "1", "--set", "output.frames=0", "--out", os.path.join(folder, "run")]
        command += [word for one in sets for word in ("--set", one)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
        except subprocess.TimeoutExpired:
            return None, "it did not end"
    return done.returncode, done.stderr


def after(label, text):
    found = re.search(rf"^ *{label}: (.*)$", text, re.MULTILINE)
    return found.group(1) if found else ""


def first_of(advice):
    """The assignments of the first alternative that has any; none if the advice is in words."""
    # Commas in brackets do not separate alternatives.
    for one in re.split(r", or | or |, (?![^\[]*\])", advice):
        found = ASSIGNMENT.findall(one)
        if found:
            return found
    return []


Outcome = collections.namedtuple("Outcome", "number kind cause advice then problem said")


def tried(seed, number, folder):
    file = os.path.join(folder, f"{number}.toml")
    with open(file, "w", encoding="utf-8") as out:
        out.write(drawn(seed, number))
    code, said = ran(file, [])
    kind = {0: "ended", 2: "refused", 3: "diverged"}.get(code, "failed")
    said = said.replace(folder + os.sep, "")
    problem, cause, then, advice = "", "", "", after("try", said)
    if kind == "failed":
        problem = f"exit code {code}"
    elif kind != "ended":
        error = said[said.find("error:") :]
        cause = after("likely cause", said) if kind == "diverged" else error.split("\n")[0]
        if said.count("error:") != 1 or not advice:
            problem = "not one error with a suggestion"
        elif not cause or NO_CAUSE in cause:
            problem = "no cause"
        sets = first_of(advice)
        then = "in words"
        if sets:
            code, more = ran(file, sets)
            then = {0: "ended", 2: "refused", 3: "diverged"}.get(code, "failed")
            said += f"\n--set {' '.join(sets)}:\n{more}"
            if then == "failed":
                problem = f"exit code {code} after the suggestion"
    with open(os.path.join(folder, f"{number}.txt"), "w", encoding="utf-8") as out:
        out.write(said)
    return Outcome(number, kind, cause, advice, then, problem, said)


def sort_of(text):
    """A cause or a suggestion without its numbers and places, so that alike ones are counted together."""
    text = re.sub(r"^error: (\S+\.toml, line \d+: )?", "", text)
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text)[:110].replace("|", "/")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="+")
    parser.add_argument("--keep")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as bare:
        folder = asked.keep or bare
        os.makedirs(folder, exist_ok=True)
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            numbers = asked.only or range(asked.count)
            outcomes = []
            for one in pool.map(lambda number: tried(asked.seed, number, folder), numbers):
                outcomes.append(one)
                print(f"scene {one.number}: {one.kind} {one.then}", file=sys.stderr, flush=True)
    kinds = collections.Counter(one.kind for one in outcomes)
    print(f"{len(outcomes)} scenes of seed {asked.seed}: " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) + "\n")
    rows = collections.defaultdict(list)
    for one in outcomes:
        if one.kind not in ("ended", "failed"):
            rows[one.kind, sort_of(one.cause), sort_of(one.advice)].append(one)
    lines = []
    for (kind, cause, advice), alike in sorted(rows.items(), key=lambda row: -len(row[1])):
        then = collections.Counter(one.then for one in alike)
        examples = " ".join(str(one.number) for one in sorted(alike, key=lambda one: one.then == "ended")[:4])
        shown = ", ".join(f"{count} {what}" for what, count in then.most_common())
        lines.append([kind, len(alike), cause, advice, shown, examples])
    print(table(["", "scenes", "cause", "suggestion", "then", "for example"], lines))
    unhappy = [one for one in outcomes if one.kind in ("refused", "diverged")]
    led = sum(one.then == "ended" for one in unhappy)
    words = sum(one.then == "in words" for one in unhappy)
    share = led / max(len(unhappy), 1)
    print(f"\nThe first suggestion led to a run that ends in {led} of {len(unhappy)} cases ({100 * share:.0f} %); in {words} it is in words.")
    wrong = [one for one in outcomes if one.problem]
    for one in wrong:
        print(f"scene {one.number}: {one.problem}: {' / '.join(one.said.strip().split(chr(10))[:6])[:600]}")
    if wrong or share < 0.9:
        sys.exit(1)


if __name__ == "__main__":
    main()
