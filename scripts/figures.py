#!/usr/bin/env python3
"""The figures of the README, measured anew: runs hydrograd and prints the tables.

    python3 scripts/figures.py accuracy | gradient | cfl | starts | gain | drift | shapes | f32     (one or more; needs no packages)

Build first: cargo build --release. Results go to runs/figures/.
"""
import csv
import json
import math
import os
import shutil
import subprocess
import sys
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PROGRAM = os.path.join(ROOT, "target/release/hydrograd")
OUT = os.path.join(ROOT, "runs/figures")
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
    print("| H | dx | Q | against FEM | u_max | against FEM | flow rate | against FEM | outlet T | wall heat flux | imbalance |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for height in (0.2, 0.26):
        for dx in (0.02, 0.01):
            s = simulate(f"accuracy-{height}-{dx}", channel__height=height, resolution__dx=dx, time__end=2.5)
            q, u, flow = FEM[height]
            print(f"| {height} | {dx} | {s['q']:.5f} | {percent(s['q'], q)} | {s['u_max']:.4f} | {percent(s['u_max'], u)} "
                  f"| {s['flow_rate']:.4f} | {percent(s['flow_rate'], flow)} | {s['mean_outlet_temperature']:.4f} "
                  f"| {s['wall_heat_flux']:.5f} | {100 * s['energy_imbalance']:+.2f} % |")
    print("\nthe same at dx = 0.02, H = 0.2 with the other conventions")
    for label, values in [("hot isotherm in the dummy particles", {"wall__hot_isotherm": "dummy"}),
                          ("interpolation fluid-and-walls", {"objective__interpolation": "fluid-and-walls"}),
                          ("interpolation fluid", {"objective__interpolation": "fluid"}),
                          ("transport velocity 1", {"fluid__transport_velocity": 1})]:
        s = simulate("accuracy-other", time__end=2.5, **values)
        print(f"* {label}: Q {s['q']:.5f} ({percent(s['q'], FEM[0.2][0])}), u_max {percent(s['u_max'], 1.15)}, "
              f"imbalance {100 * s['energy_imbalance']:+.2f} %")


def gradient_of(name, *arguments):
    folder = run(name, "check-gradient", "--directions", "1", *arguments, allow_failure=True)
    return load(os.path.join(OUT, name), "gradient_check.json") if folder or os.path.exists(os.path.join(OUT, name, "gradient_check.json")) else None


def norm(x):
    return math.sqrt(sum(a * a for a in x))


def gradient():
    print("dQ/d offset (1e-3) at the flat wall, nodes 0.26 ... 0.74")
    print("finite elements:", " ".join(f"{g:.1f}" for g in FEM_GRADIENT))
    # Run length, window of the average and its samples: short windows see the phase of the particles' lattice.
    for dx, end, window, samples in ((0.02, 2, 0.5, 10), (0.02, 2, 0.5, 40), (0.02, 2, 1, 50), (0.02, 3, 0.5, 40), (0.01, 1.5, 0.5, 40), (0.01, 2, 0.5, 40)):
        steps = math.ceil(end / min(2 * dx / 11, 0.25 * dx * dx / 0.0239558))
        values = sets(objective__window=window, objective__samples=samples, resolution__dx=dx, design__nodes=NODES)
        g = gradient_of("gradient", "--steps", str(steps), *values)
        ours = [1e3 * x for x in g["gradient"]]
        cosine = sum(a * b for a, b in zip(ours, FEM_GRADIENT)) / norm(ours) / norm(FEM_GRADIENT)
        print(f"dx = {dx}, run to t = {end}, average over the last {window} in {samples} samples:", " ".join(f"{x:.1f}" for x in ours))
        print(f"   cosine {cosine:.3f}, norm {norm(ours):.1f} against {norm(FEM_GRADIENT):.1f}, "
              f"sum {sum(ours):.1f} against {sum(FEM_GRADIENT):.1f}, Q {g['q']:.6f}, differences agree to {g['worst_relative_error']:.1e}")


def cfl():
    print("| CFL | dt | steps | seconds | Q | change | u_max | |gradient| | change of the gradient |")
    print("|---|---|---|---|---|---|---|---|---|")
    base = None
    for value in (0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0):
        s = simulate(f"cfl-{value}", time__cfl=value)
        if s is None:
            print(f"| {value} | | | | diverges | | | | |")
            continue
        g = gradient_of(f"cfl-gradient-{value}", "--steps", str(s["steps"]), *sets(time__cfl=value, objective__window=0.5, objective__samples=40))
        vector = g["gradient"]
        base = base or (s["q"], vector)
        gap = norm([a - b for a, b in zip(vector, base[1])]) / norm(base[1])
        print(f"| {value} | {s['time_step']:.2e} | {s['steps']} | {s['wall_seconds']:.2f} | {s['q']:.6f} | {percent(s['q'], base[0])} "
              f"| {s['u_max']:.4f} | {norm(vector):.3e} | {100 * gap:.1f} % |")


def starts():
    begun = time.time()
    folder = run("starts", "optimize", "--preset", "report", "--start", "all")
    print("| start | Q first | Q best | gain | epoch | Q last | seconds |")
    print("|---|---|---|---|---|---|---|")
    for name, s in load(folder).items():
        q = s["q_per_epoch"]
        print(f"| {name} | {q[0]:.6f} | {s['q']:.6f} | {percent(s['q'], q[0])} | {s['best_epoch']} | {q[-1]:.6f} | {s['wall_seconds']:.1f} |")
    print(f"{time.time() - begun:.0f} s in all")


def drift():
    """The default optimum and the flat wall, run longer: needs the run of `gain`."""
    shape = os.path.join(OUT, "gain", "shape.csv")
    print("| dx | t | flat | optimum | change |")
    print("|---|---|---|---|---|")
    for dx in (0.02, 0.01):
        for end in (2, 2.5, 3, 4):
            flat = simulate("drift-flat", resolution__dx=dx, time__end=end)
            best = simulate("drift-best", resolution__dx=dx, time__end=end, design__file=shape)
            print(f"| {dx} | {end} | {flat['q']:.6f} | {best['q']:.6f} | {percent(best['q'], flat['q'])} |")


def gain():
    folder = run("gain", "optimize")
    s = load(folder)
    print(f"default run: Q {s['q_first']:.6f} -> {s['q']:.6f} ({percent(s['q'], s['q_first'])}), epoch {s['best_epoch']}, "
          f"{s['wall_seconds']:.1f} s, peak memory {s['peak_memory_bytes'] / 1e6:.0f} MB")
    shape = os.path.join(folder, "shape.csv")
    flat = simulate("gain-flat", resolution__dx=0.01)
    best = simulate("gain-best", resolution__dx=0.01, design__file=shape)
    print(f"at dx = 0.01: flat {flat['q']:.6f}, the same wall {best['q']:.6f} ({percent(best['q'], flat['q'])})")


def shapes():
    with open(SHAPES) as file:
        rows = list(csv.DictReader(file))
    for label, extra in (("default", {}), ("transport velocity 1, no background pressure, cfl 1",
                                           {"fluid__transport_velocity": 1, "fluid__background_pressure_factor": 0, "time__cfl": 1})):
        ratios, flows = [], []
        for row in rows:
            offsets = "[" + ",".join(row[f"o{k}"] for k in range(25)) + "]"
            s = simulate("shape", design__offsets=offsets, design__nodes=NODES, **extra)
            if s is None:
                print(f"  {row['shape']} {row['A']}: diverges")
                continue
            ratios.append((s["q"] / float(row["Q"]), f"{row['shape']} {row['A']}"))
            flows.append(s["flow_rate"] / float(row["flow_rate"]))
        ratios.sort()
        mean = sum(r for r, _ in ratios) / len(ratios)
        print(f"{label}: {len(ratios)} shapes, Q / Q_fem mean {mean:.3f}, lowest {ratios[0][0]:.3f} ({ratios[0][1]}), "
              f"highest {ratios[-1][0]:.3f} ({ratios[-1][1]}); flow rate mean {sum(flows) / len(flows):.3f}")


def f32():
    print("| steps | |gradient| f64 | f32 differs by |")
    print("|---|---|---|")
    for steps in (100, 500, 2000):
        vectors = []
        for precision in ("f64", "f32"):
            g = gradient_of(f"f32-{precision}-{steps}", "--steps", str(steps), "--precision", precision, *sets(time__cfl=0.25))
            vectors.append(g["gradient"])
        exact, single = vectors
        gap = norm([a - b for a, b in zip(exact, single)]) / norm(exact)
        print(f"| {steps} | {norm(exact):.3e} | {gap:.1e} |")


if __name__ == "__main__":
    known = {f.__name__: f for f in (accuracy, gradient, cfl, starts, gain, drift, shapes, f32)}
    wanted = sys.argv[1:]
    if not wanted or any(name not in known for name in wanted):
        sys.exit(__doc__)
    for name in wanted:
        print(f"\n## {name}")
        known[name]()
