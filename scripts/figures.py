#!/usr/bin/env python3
"""The figures in the pages, measured anew: runs hydrograd and writes the tables where they stand.

    python3 scripts/figures.py NAME...      measures, prints, and writes the README.md that has the place
    python3 scripts/figures.py --print NAME...      measures and prints
    python3 scripts/figures.py --check      measures nothing: whether each table has one place, and each place a table

Of the solver: accuracy gradient cfl starts gain drift shapes f32 (drift: after gain). Of speed: bench-kernels bench-gradient
bench-scaling bench-plan bench-surrogate. From what scripts/peers/run.sh has measured: peers peers-surrogate.

Needs no packages. Build first: cargo build --release. Results go to runs/figures/.
"""
import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys

sys.dont_write_bytecode = True
from pages import ROOT, check, table, write
from speed import FIGURES as SPEED
from speed import OUT, PROGRAM

SHAPES = os.path.join(ROOT, "data/reference/fem-shapes-H0.2.csv")
# Finite elements (data/reference/README.md): Q and u_max of the flat wall, dQ/d offset at nodes 0.26 ... 0.74.
FEM = {0.2: (0.0234764, 1.15, 0.153333), 0.26: (0.02860, 1.9435, 0.33687)}
FEM_GRADIENT = [8.2, 2.1, 0.1, -0.6, -1.0, -1.2, -1.3, -1.4, -1.5, -1.5, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6,
                -1.5, -1.3, -1.1, -0.6, 0.2, 2.3, 8.5]
NODES = [round(0.26 + 0.02 * k, 4) for k in range(25)]


def run(name, *arguments, allow_failure=False):
    """Runs hydrograd into runs/figures/NAME and returns the folder."""
    folder = os.path.join(OUT, name)
    shutil.rmtree(folder, ignore_errors=True)
    command = [PROGRAM, *arguments, "--out", folder]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    if result.returncode != 0 and not allow_failure:
        sys.exit(f"{' '.join(command)}\n{result.stderr}")
    return folder if result.returncode == 0 else None


def load(folder, name="summary.json"):
    with open(os.path.join(folder, name)) as file:
        return json.load(file)


def sets(**values):
    out = []
    for key, value in values.items():
        out += ["--set", f"{key.replace('__', '.')}={value}"]
    return out


def simulate(name, **values):
    folder = run(name, "simulate", *sets(output__frames=0, **values), allow_failure=True)
    return load(folder) if folder else None


def percent(ours, theirs):
    return f"{100 * (ours / theirs - 1):+.2f} %"


def accuracy():
    rows, others = [], []
    for height in (0.2, 0.26):
        for dx in (0.02, 0.01):
            s = simulate(f"accuracy-{height}-{dx}", channel__height=height, resolution__dx=dx, time__end=2.5)
            q, u, flow = FEM[height]
            rows.append([height, dx, f"{s['q']:.5f}", percent(s['q'], q), f"{s['u_max']:.4f}", percent(s['u_max'], u),
                         f"{s['flow_rate']:.4f}", percent(s['flow_rate'], flow), f"{s['mean_outlet_temperature']:.4f}",
                         f"{s['wall_heat_flux']:.5f}", f"{100 * s['energy_imbalance']:+.2f} %"])
    for label, values in [("hot isotherm in the dummy particles", {"wall__hot_isotherm": "dummy"}),
                          ("interpolation fluid-and-walls", {"objective__interpolation": "fluid-and-walls"}),
                          ("interpolation fluid", {"objective__interpolation": "fluid"}),
                          ("transport velocity 1", {"fluid__transport_velocity": 1})]:
        s = simulate("accuracy-other", time__end=2.5, **values)
        others.append(f"* {label}: Q {s['q']:.5f} ({percent(s['q'], FEM[0.2][0])}), u_max {percent(s['u_max'], 1.15)}, "
                      f"imbalance {100 * s['energy_imbalance']:+.2f} %")
    header = ["H", "dx", "Q", "against FEM", "u_max", "against FEM", "flow rate", "against FEM", "outlet T", "wall heat flux", "imbalance"]
    return "\n".join([table(header, rows), "", "The same at dx = 0.02, H = 0.2 with other conventions:", "", *others])


def gradient_of(name, *arguments):
    """The result of check-gradient, also where the differences do not agree."""
    run(name, "check-gradient", "--directions", "1", *arguments, allow_failure=True)
    return load(os.path.join(OUT, name), "gradient_check.json")


def norm(x):
    return math.sqrt(sum(a * a for a in x))


def gradient():
    lines = ["finite elements".ljust(32) + " ".join(f"{g:.1f}" for g in FEM_GRADIENT)]
    # Run length, window of the average and its samples: short windows see the phase of the particles' lattice.
    for dx, end, window, samples in ((0.02, 2, 1, 50), (0.02, 2, 0.5, 40), (0.02, 2, 0.5, 10), (0.02, 3, 0.5, 40), (0.01, 1.5, 0.5, 40), (0.01, 2, 0.5, 40)):
        steps = math.ceil(end / min(2 * dx / 11, 0.25 * dx * dx / 0.0239558))
        values = sets(objective__window=window, objective__samples=samples, resolution__dx=dx, design__nodes=NODES)
        g = gradient_of("gradient", "--steps", str(steps), *values)
        ours = [1e3 * x for x in g["gradient"]]
        cosine = sum(a * b for a, b in zip(ours, FEM_GRADIENT)) / norm(ours) / norm(FEM_GRADIENT)
        label = f"dx {dx}, t {end}, {samples} in {window}".ljust(32)
        lines.append(f"{label}{' '.join(f'{x:.1f}' for x in ours)}    cosine {cosine:.2f}")
    return "\n".join(["```text", *lines, "```"])


def cfl():
    rows, base = [], None
    for value in (0.25, 0.5, 1.0, 1.5, 2.0, 2.5):
        s = simulate(f"cfl-{value}", time__cfl=value)
        if s is None:
            rows.append([value, *[""] * 2, "diverges", *[""] * 5])
            continue
        g = gradient_of(f"cfl-gradient-{value}", "--steps", str(s["steps"]), *sets(time__cfl=value, objective__window=0.5, objective__samples=40))
        vector = g["gradient"]
        first = base is None
        base = base or (s["q"], vector)
        gap = norm([a - b for a, b in zip(vector, base[1])]) / norm(base[1])
        rows.append([f"{value:g}", f"{s['time_step']:.2e}", s["steps"], f"{s['wall_seconds']:.2f}", f"{s['q']:.6f}",
                     "" if first else percent(s["q"], base[0]), f"{s['u_max']:.4f}", f"{norm(vector):.2e}", "" if first else f"{100 * gap:.1f} %"])
    return table(["CFL", "dt", "steps", "seconds", "Q", "change", "u_max", "norm of the gradient", "change of the gradient"], rows)


def starts():
    folder = run("starts", "optimize", "--preset", "report", "--start", "all")
    rows = []
    for name, s in load(folder).items():
        q = s["q_per_epoch"]
        rows.append([name, f"{q[0]:.6f}", f"{s['q']:.6f}", percent(s["q"], q[0]), s["best_epoch"], f"{q[-1]:.6f}", f"{s['wall_seconds']:.1f}"])
    return table(["start", "Q first", "Q best", "gain", "epoch", "Q last", "seconds"], rows)


def drift():
    """The default optimum and the flat wall, run longer: needs the run of `gain`."""
    shape = os.path.join(OUT, "gain", "shape.csv")
    ends, rows = (2, 2.5, 3, 4), []
    for dx in (0.02, 0.01):
        cells = []
        for end in ends:
            flat = simulate("drift-flat", resolution__dx=dx, time__end=end)
            best = simulate("drift-best", resolution__dx=dx, time__end=end, design__file=shape)
            cells.append(percent(best["q"], flat["q"]))
        rows.append([dx, *cells])
    return table(["dx", *(f"t = {end}" for end in ends)], rows)


def gain():
    folder = run("gain", "optimize")
    s = load(folder)
    shape = os.path.join(folder, "shape.csv")
    flat = simulate("gain-flat", resolution__dx=0.01)
    best = simulate("gain-best", resolution__dx=0.01, design__file=shape)
    return (f"Q {s['q_first']:.6f} -> {s['q']:.6f} ({percent(s['q'], s['q_first'])}) in epoch {s['best_epoch']}, {s['wall_seconds']:.0f} s on two "
            f"cores, {s['peak_memory_bytes'] / 1e6:.0f} MB. The same wall at half the spacing: {flat['q']:.6f} -> {best['q']:.6f} "
            f"({percent(best['q'], flat['q'])}).")


def shapes():
    with open(SHAPES) as file:
        reference = list(csv.DictReader(file))
    rows = []
    rough = {"fluid__transport_velocity": 1, "fluid__background_pressure_factor": 0, "time__cfl": 1}
    for label, extra in (("default", {}), ("`fluid.transport_velocity=1 fluid.background_pressure_factor=0 time.cfl=1`", rough)):
        ratios, flows, diverged = [], [], 0
        for row in reference:
            offsets = "[" + ",".join(row[f"o{k}"] for k in range(25)) + "]"
            s = simulate("shape", design__offsets=offsets, design__nodes=NODES, **extra)
            if s is None:
                diverged += 1
                continue
            ratios.append((s["q"] / float(row["Q"]), f"{row['shape']} {row['A']}"))
            flows.append(s["flow_rate"] / float(row["flow_rate"]))
        ratios.sort()
        mean = sum(r for r, _ in ratios) / len(ratios)
        rows.append([label, f"{mean:.3f}", f"{ratios[0][0]:.3f} ({ratios[0][1]})", f"{ratios[-1][0]:.3f} ({ratios[-1][1]})",
                     f"{sum(flows) / len(flows):.3f}", diverged])
    return table(["", "Q / Q of finite elements, mean", "lowest", "highest", "flow rate, mean", "diverged"], rows)


def f32():
    rows = []
    for steps in (100, 500, 2000):
        exact, single = (gradient_of(f"f32-{precision}-{steps}", "--steps", str(steps), "--precision", precision, *sets(time__cfl=0.25))["gradient"]
                         for precision in ("f64", "f32"))
        gap = norm([a - b for a, b in zip(exact, single)]) / norm(exact)
        rows.append([steps, f"{norm(exact):.2e}", f"{gap:.1e}"])
    return table(["steps", "norm of the gradient", "f32 differs by"], rows)


FIGURES = {**{f.__name__: f for f in (accuracy, gradient, cfl, starts, gain, drift, shapes, f32)}, **SPEED}


def main():
    wanted, only_print = [name for name in sys.argv[1:] if name != "--print"], "--print" in sys.argv
    if wanted == ["--check"]:
        sys.exit("\n".join(check(FIGURES)) or 0)
    if not wanted or any(name not in FIGURES for name in wanted):
        sys.exit(__doc__)
    for name in wanted:
        text = re.sub(r"e([+-])0(\d)\b", lambda m: "e" + m[1].strip("+") + m[2], FIGURES[name]())
        print(f"\n## {name}\n\n{text}\n")
        if not only_print and not write(name, text):
            sys.exit(f"no page has the place of {name}: <!-- figures: {name} --> and <!-- end -->")


if __name__ == "__main__":
    main()
