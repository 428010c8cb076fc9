#!/usr/bin/env python3
"""Fixed particles beside finite elements: the error of flow rate, drag and heat of a body in a channel against the time that a user waits.

    python3 -m venv ~/.cache/hydrograd/finite-elements
    ~/.cache/hydrograd/finite-elements/bin/pip install -r scripts/peers/requirements-finite-elements.txt
    ~/.cache/hydrograd/finite-elements/bin/python scripts/peers/finite_elements.py [--hydrograd target/release/hydrograd] [--turns 3]

Finite elements are Taylor-Hood triangles (P2, P1; P2 for heat) on meshes of gmsh, with Newton's method and SciPy's direct solver
(scripts/bodies_fem.py); both are whole commands on as many threads as they like. The time of starting Python and importing its
packages is given apart. The truth is data/reference/bodies-in-channel.csv: finite elements with 160 edges a body, right to about 0.02 %,
so smaller errors than that mean nothing. (gmsh needs libglu1-mesa, libxrender1, libxcursor1, libxft2 and libxinerama1.)

Writes runs/peers/finite_elements.json, finite_elements.png and a table.
"""
import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
OUT = os.path.join(ROOT, "runs/peers")
sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(ROOT, "scripts"))
GEOMETRIES = ("circle", "spline", "two-circles")
SPACINGS = (0.04, 0.02, 0.01, 0.005)
# Edges of a body, and size of the triangles far from it.
MESHES = ((20, 0.08), (40, 0.04), (80, 0.02), (120, 0.014))


def seconds(command, turns):
    """The shortest time of some turns, and the last output."""
    least, text = float("inf"), ""
    for _ in range(turns):
        clock = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        least = min(least, time.perf_counter() - clock)
        if done.returncode != 0:
            sys.exit(f"{' '.join(command)}\n{done.stderr}")
        text = done.stdout
    return least, text


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hydrograd", default=os.path.join(ROOT, "target/release/hydrograd"))
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    from figures import BODIES, bodies_in_channel

    os.makedirs(OUT, exist_ok=True)
    with open(BODIES) as file:
        reference = list(csv.DictReader(file))
    start, _ = seconds([sys.executable, "-c", "import gmsh, numpy, scipy.sparse.linalg, skfem"], options.turns)
    rows = []
    for name, bodies, scene in bodies_in_channel(reference):
        if name not in GEOMETRIES:
            continue
        truth = [float(bodies[0]["flow_rate"]), sum(float(b["force_x"]) for b in bodies), sum(float(b["heat"]) for b in bodies)]

        def row(code, size, time, figures):
            errors = [abs(found / true - 1) for found, true in zip(figures, truth)]
            rows.append({"code": code, "geometry": name, "resolution": size, "seconds": time, "flow_rate": errors[0], "drag": errors[1], "heat": errors[2]})
            print(f"{name:<12} {code:<26} {size:<12} {time:6.2f} s   " + "  ".join(f"{100 * e:.3f} %" for e in errors), flush=True)

        for dx in SPACINGS:
            with tempfile.TemporaryDirectory() as folder:
                command = [options.hydrograd, "simulate", scene, "--set", f"resolution.dx={dx}", "--out", os.path.join(folder, "run")]
                time, _ = seconds(command, options.turns)
                with open(os.path.join(folder, "run/summary.json")) as file:
                    found = json.load(file)
            shapes = found["shapes"][2:]
            row("fixed particles", f"dx {dx}", time, [found["flow_rate"], sum(s["force"][0] for s in shapes), sum(s["heat"] for s in shapes)])
        for points, far in MESHES:
            command = [sys.executable, os.path.join(ROOT, "scripts/bodies_fem.py"), scene, "--points", str(points), "--far", str(far)]
            time, text = seconds(command, options.turns)
            found = json.loads(text[text.index("{"):])
            row("finite elements", f"{points} edges", time,
                [found["flow_rate"], sum(s["force"][0] for s in found["shapes"]), sum(s["heat"] for s in found["shapes"])])
    with open(os.path.join(OUT, "finite_elements.json"), "w") as file:
        json.dump({"start_of_python": start, "rows": rows}, file, indent=1)
    draw(rows, start)
    print(f"\n{start:.2f} s of each finite-element run are the start of Python and its packages\n")
    print(summed_up(rows))


def summed_up(rows):
    """Of all geometries: the worst errors and the mean time."""
    from pages import table

    lines = []
    for code, size in dict.fromkeys((row["code"], row["resolution"]) for row in rows):
        some = [row for row in rows if (row["code"], row["resolution"]) == (code, size)]
        worst = [f"{100 * max(row[key] for row in some):.2f} %" for key in ("flow_rate", "drag", "heat")]
        lines.append([code, size, f"{sum(row['seconds'] for row in some) / len(some):.2f}", *worst])
    return table(["", "resolution", "seconds", "flow rate", "drag", "heat"], lines)


def draw(rows, start):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 3, figsize=(12, 4), sharey=True)
    for panel, key, name in zip(panels, ("flow_rate", "drag", "heat"), ("flow rate", "drag", "heat")):
        for code, marker in (("fixed particles", "o-"), ("finite elements", "s--")):
            sizes = list(dict.fromkeys(row["resolution"] for row in rows if row["code"] == code))
            some = [[row for row in rows if row["code"] == code and row["resolution"] == size] for size in sizes]
            panel.loglog([sum(row["seconds"] for row in all) / len(all) for all in some], [max(row[key] for row in all) for all in some], marker, label=code)
        panel.axhline(2e-4, color="grey", linewidth=0.8)
        panel.axvline(start, color="grey", linewidth=0.8, linestyle=":")
        panel.set(title=f"{name}: worst of {len(GEOMETRIES)} geometries", xlabel="seconds of the whole command")
    panels[0].set_ylabel("relative error (grey: of the reference)")
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(os.path.join(OUT, "finite_elements.png"), dpi=120)


if __name__ == "__main__":
    main()
