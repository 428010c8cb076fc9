#!/usr/bin/env python3
"""The figures in the pages, measured anew: runs hydrograd and writes the tables where they stand.

    python3 scripts/figures.py NAME...      measures, prints, and writes the page that has the place
    python3 scripts/figures.py --print NAME...      measures and prints
    python3 scripts/figures.py --check      measures nothing: whether each table has one place, and each place a table

Of the solver: accuracy validation switches gradient growth cfl starts gain constraints drift shapes rough f32 inverse cloud around errors errors_around front; summary writes the
fields of summary.json from data/summary.toml; busy is busy.py. Of designs by the surrogate:
surrogate-rank surrogate-starts surrogate-compare; of starts: surrogate-inverse. Of speed: bench-kernels bench-gradient bench-formulations
bench-scaling bench-plan bench-surrogate. From what scripts/peers/run.sh has measured: peers peers-surrogate; from scripts/peers/time_error.py: time-error. `pictures` and `pictures-slow` make the pictures (pictures.py).

The tables need no packages. Build first: cargo build --release (or HYDROGRAD=PROGRAM). Results go to runs/figures/.
"""
import array
import csv
import hashlib
import json
import math
import os
import random
import re
import shutil
import subprocess
import sys
import time

sys.dont_write_bytecode = True
from pages import ROOT, check, table, write
from pictures import QUICK, SLOW, remake
from speed import FIGURES as SPEED
from speed import OUT, PROGRAM

SHAPES = os.path.join(ROOT, "data/reference/fem-shapes-H0.2.csv")
SHARP = os.path.join(ROOT, "data/reference/fem-sharp.csv")
GRADIENT = os.path.join(ROOT, "data/reference/fem-sharp-gradient.csv")
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


def reference(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def finite_elements(shape="flat", amplitude="0", height=0.2):
    """Q and flow rate over a wall (data/reference/README.md)."""
    row = next(row for row in reference(SHARP) if (row["shape"], row["A"], float(row["H"])) == (shape, amplitude, height))
    return float(row["Q"]), float(row["flow_rate"])


def percent(ours, theirs):
    return f"{100 * (ours / theirs - 1):+.2f} %"


def accuracy():
    rows, others = [], []
    for height in (0.2, 0.26):
        for dx in (0.02, 0.01):
            s = simulate(f"accuracy-{height}-{dx}", channel__height=height, resolution__dx=dx, time__end=2.5)
            (q, flow), u = finite_elements(height=height), 2.3 * height ** 2 / (8 * 0.01)
            rows.append([height, dx, f"{s['q']:.5f}", percent(s['q'], q), f"{s['u_max']:.4f}", percent(s['u_max'], u),
                         f"{s['flow_rate']:.4f}", percent(s['flow_rate'], flow), f"{s['mean_outlet_temperature']:.4f}",
                         f"{s['wall_heat_flux']:.5f}", f"{100 * s['energy_imbalance']:+.2f} %"])
    standard = {"method__name": "standard"}
    for label, values in [("fixed particles", {"method__name": "fixed"}),
                          ("standard formulation", standard),
                          ("standard formulation, hot isotherm in the dummy particles", {**standard, "wall__hot_isotherm": "dummy"}),
                          ("standard formulation, interpolation fluid-and-walls", {**standard, "objective__interpolation": "fluid-and-walls"}),
                          ("standard formulation, transport velocity 1", {**standard, "method__transport_velocity": 1})]:
        s = simulate("accuracy-other", time__end=2.5, **values)
        others.append(f"* {label}: Q {s['q']:.5f} ({percent(s['q'], finite_elements()[0])}), u_max {percent(s['u_max'], 1.15)}, "
                      f"imbalance {100 * s['energy_imbalance']:+.2f} %")
    header = ["H", "dx", "Q", "against FEM", "u_max", "against FEM", "flow rate", "against FEM", "outlet T", "wall heat flux", "imbalance"]
    return "\n".join([table(header, rows), "", "The same at dx = 0.02, H = 0.2 with other conventions:", "", *others])


def validation():
    """Every scene with a known answer: the finest run of each case."""
    rows = load(run("validate", "validate", allow_failure=True) or os.path.join(OUT, "validate"), "validation.json")["rows"]
    out = []
    for k, row in enumerate(rows):
        if k + 1 == len(rows) or rows[k + 1]["case"] != row["case"]:
            error = lambda key: "-" if row[key] is None else f"{row[key]:.1e}"
            order = "" if row["order"] is None else f"{row['order']:.1f}"
            out.append([row["case"], row["quantity"], row["reference"], f"{row['dx']:.3g}", error("error"), error("error_f32"), order, f"{row['tolerance']:.1e}", f"{row['seconds']:.0f}"])
    return table(["case", "error of", "against", "dx", "f64", "f32", "order", "tolerance", "seconds"], out)


def switches():
    """Taylor-Green, 50 x 50, to t = 1: what each choice costs and what it is worth."""
    standard = dict(method__name="standard")
    variants = [
        ("default", {}),
        ("method.integrator symplectic-euler", dict(method__integrator="symplectic-euler")),
        ("resolution.smoothing_length 1", dict(resolution__smoothing_length=1)),
        ("resolution.kernel wendland-c2, smoothing_length 1.3", dict(resolution__kernel="wendland-c2", resolution__smoothing_length=1.3)),
        ("method.pressure_diffusion 0.05", dict(method__pressure_diffusion=0.05)),
        ("method.pressure_diffusion 0.2", dict(method__pressure_diffusion=0.2)),
        ("method.shift_strength 0.5", dict(method__shift_strength=0.5)),
        ("method.shift none", dict(method__shift="none")),
        ("fluid.sound_speed_factor 20", dict(fluid__sound_speed_factor=20)),
        ("time.cfl 0.5", dict(time__cfl=0.5)),
        ("time.jitter 0 (an exact lattice)", dict(time__jitter=0)),
        ("run.precision f32", dict(run__precision="f32")),
        ("standard", standard),
        ("standard, method.transport_velocity 0", {**standard, "method__transport_velocity": 0}),
        ("standard, method.artificial_viscosity 0.1", {**standard, "method__artificial_viscosity": 0.1}),
    ]
    rows = []
    for label, values in variants:
        folder = run("switches", "simulate", "taylor-green", *sets(output__frames=0, time__end=1, run__threads=1, **values), allow_failure=True)
        s = load(folder) if folder else None
        if s is None:
            rows.append([label, "diverged", "", ""])
            continue
        # The mean square of the exact velocity is half the square of its amplitude.
        rows.append([label, f"{math.sqrt(2) * s['velocity_error']:.4f}", f"{1e9 * s['wall_seconds'] / s['steps'] / s['particles']:.0f}", f"{s['wall_seconds']:.2f}"])
    return table(["", "relative L2 error at t = 1", "ns per particle and step", "seconds"], rows)


def gradient_of(name, *arguments):
    """The result of check-gradient, also where the differences do not agree."""
    run(name, "check-gradient", "--directions", "1", *arguments, allow_failure=True)
    return load(os.path.join(OUT, name), "gradient_check.json")


def norm(x):
    return math.sqrt(sum(a * a for a in x))


def pairs(g):
    """The two nodes at each end summed: kernels smear the edge of the hot wall between them."""
    return [g[0] + g[1], *g[2:-2], g[-2] + g[-1]]


def cosine(a, b):
    return sum(x * y for x, y in zip(a, b)) / norm(a) / norm(b)


def gradient():
    FEM_GRADIENT = [1e3 * float(row["dQ_d_offset"]) for row in reference(GRADIENT)]
    lines = ["finite elements".ljust(32) + " ".join(f"{g:.1f}" for g in FEM_GRADIENT)]
    for motion, dx in (("moving", 0.02), ("moving", 0.01), ("fixed", 0.02), ("fixed", 0.01)):
        method, how = ("fixed", ["--gradient", "steady"]) if motion == "fixed" else ("consistent", [])
        steps = math.ceil(2.5 / min(1.5 * dx / 11, 0.25 * dx * dx / 0.0239558))
        values = sets(method__name=method, resolution__dx=dx, design__nodes=NODES, objective__window=0.5, objective__samples=40, optimise__memory="2GB")
        g = gradient_of("gradient", "--steps", str(steps), *how, *values)
        ours = [1e3 * x for x in g["gradient"]]
        found = f"cosine {cosine(ours, FEM_GRADIENT):.3f}, with the end nodes summed in pairs {cosine(pairs(ours), pairs(FEM_GRADIENT)):.3f}"
        lines.append(f"{f'{motion} particles, dx {dx}'.ljust(32)}{' '.join(f'{x:.1f}' for x in ours)}    {found}")
    return "\n".join(["```text", *lines, "```"])


def growth():
    """The gradient of ever longer runs: one that exploded would grow with them."""
    rows = []
    for name, wall in [("flat", {}), ("sine 0.01", {"design__shape": "sine", "design__amplitude": 0.01}), ("sine 0.02", {"design__shape": "sine", "design__amplitude": 0.02}),
                       ("cosine, two periods, 0.02", {"design__shape": "cosine", "design__amplitude": 0.02, "design__periods": 2}),
                       ("up 0.02", {"design__shape": "uniform", "design__amplitude": 0.02}), ("down 0.02", {"design__shape": "uniform", "design__amplitude": -0.02}),
                       ("linear 0.02", {"design__shape": "linear", "design__amplitude": 0.02}), ("random 0.01", {"design__shape": "random", "design__amplitude": 0.01})]:
        norms = []
        for end in (2, 4, 8, 16):
            folder = run("growth", "optimize", "--no-verify", "--epochs", "1", *sets(optimise__search="scene", time__end=end, output__frames=0, **wall))
            norms.append(f"{load(folder)['gradient_norm_per_epoch'][0]:.4f}")
        rows.append([name, *norms])
    return table(["norm of the gradient at", "t = 2", "t = 4", "t = 8", "t = 16"], rows)


def cfl():
    rows, base = [], None
    for value in (0.25, 0.5, 1.0, 1.5, 1.75, 2.0):
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
    rows = []
    for preset in ("report", "report-jax-sph"):
        folder = run(preset, "optimize", "--preset", preset, "--start", "all")
        every = load(folder)
        for name, s in every.items():
            if not isinstance(s, dict) or "q_per_epoch" not in s:
                continue
            q = s["q_per_epoch"]
            kept = f"{100 * every['gain_survives']:+.2f} %" if every["verified_start"] == name else ""
            rows.append([preset, name, f"{q[0]:.6f}", f"{max(q):.6f}", percent(max(q), q[0]), s["best_epoch"], f"{q[-1]:.6f}", kept,
                         f"{sum(s['seconds_per_epoch']):.1f}"])
    return table(["preset", "start", "Q first", "Q best", "gain", "epoch", "Q last", "survives its checks, against flat", "seconds"], rows)


def drift():
    """Q over ever longer runs."""
    walls = [("flat", {}), ("sine 0.02", {"design__shape": "sine", "design__amplitude": 0.02}),
             ("random 0.02", {"design__shape": "random", "design__amplitude": 0.02, "run__seed": 1}),
             ("cosine, two periods, 0.02", {"design__shape": "cosine", "design__amplitude": 0.02, "design__periods": 2}),
             ("random 0.01", {"design__shape": "random", "design__amplitude": 0.01})]
    rows = []
    for name, wall in walls:
        q = [simulate("drift", time__end=end, **wall)["q"] for end in (3, 10, 30)]
        rows.append([name, *(f"{x:.6f}" for x in q), percent(q[2], q[0])])
    return table(["wall", "t = 3", "t = 10", "t = 30", "change"], rows)


def gain():
    clock = time.monotonic()
    folder = run("gain", "optimize")
    seconds = time.monotonic() - clock
    s = load(folder)
    found = s["verification"]
    rows = [[check["check"], "failed" if check["gain"] is None else f"{check['q_reference']:.6f}",
             "" if check["gain"] is None else f"{check['q_best']:.6f}", "" if check["gain"] is None else f"{100 * check['gain']:+.2f} %"]
            for check in found]
    return "\n".join([f"Q {s['q_first']:.6f} -> {max(s['q_per_epoch']):.6f} ({percent(max(s['q_per_epoch']), s['q_first'])}) in epoch {s['best_epoch'] + 1}, "
                      f"{sum(s['seconds_per_epoch']):.1f} s; the checks take {s['verification_seconds']:.1f} s, and the whole command {seconds:.1f} s.", "", table(["check", "Q flat", "Q best", "gain"], rows)])


def constraints():
    rows = []
    for drive in ("body-force", "flow-rate", "pumping-power"):
        for walls in ("bottom", "both"):
            s = load(run(f"constraints-{drive}-{walls}", "optimize", *sets(fluid__drive=drive, design__walls=walls)))
            before = s["before"]
            rows.append([drive, walls, f"{s['q_first']:.6f}", percent(s["q"], s["q_first"]), f"{100 * s['gain_survives']:+.2f} %",
                         percent(s["flow_rate"], before["flow_rate"]), percent(s["pumping_power"], before["pumping_power"]),
                         f"{sum(s['seconds_per_epoch']):.1f}"])
    return table(["held", "walls", "Q flat", "Q best", "survives its checks", "flow rate", "pumping power", "seconds of search"], rows)


def shapes():
    rows = []
    rough = {"method__name": "standard", "method__transport_velocity": 1, "method__background_pressure_factor": 0, "time__cfl": 1, "time__end": 2}
    for label, extra, some in (("moving particles (default), dx 0.02", {}, 1), ("moving particles, dx 0.01", {"resolution__dx": 0.01}, 1),
                               ("moving particles, method.shift rows, dx 0.02", {"method__shift": "rows"}, 1),
                               ("fixed particles, dx 0.02", {"method__name": "fixed"}, 1),
                               ("fixed particles, dx 0.01", {"method__name": "fixed", "resolution__dx": 0.01}, 1),
                               ("standard formulation, dx 0.02", {"method__name": "standard", "time__end": 2}, 1),
                               ("standard, transport velocity 1, no background pressure, CFL 1", rough, 1)):
        errors, flows, diverged = [], [], 0
        for row in reference(SHAPES)[::some]:
            offsets = "[" + ",".join(row[f"o{k}"] for k in range(25)) + "]"
            s = simulate("shape", design__offsets=offsets, design__nodes=NODES, **extra)
            if s is None:
                diverged += 1
                continue
            q, flow = finite_elements(row["shape"], row["A"])
            errors.append((s["q"] / q, f"{row['shape']} {row['A']}"))
            flows.append(s["flow_rate"] / flow)
        flat = errors[0][0]
        worst = max(errors, key=lambda e: abs(e[0] - 1))
        mean = sum(abs(r - 1) for r, _ in errors) / len(errors)
        rows.append([label, len(errors), f"{100 * mean:.2f} %", f"{100 * abs(worst[0] - 1):.2f} % ({worst[1]})",
                     f"{max(abs(r / flat - 1) for r, _ in errors):.4f}", f"{sum(flows) / len(flows):.3f}", diverged])
    return table(["", "walls", "error of Q, mean", "worst", "worst error of Q / Q flat", "flow rate / that of FEM, mean", "diverged"], rows)


class Kept:
    """Results of commands that take long, in runs/figures/NAME.json: what the same program has measured already is not measured again."""

    def __init__(self, name):
        self.path = os.path.join(OUT, f"{name}.json")
        with open(PROGRAM, "rb") as file:
            program = hashlib.file_digest(file, "sha256").hexdigest()
        self.all = load(OUT, f"{name}.json") if os.path.exists(self.path) else {}
        if self.all.get("program") != program:
            self.all = {"program": program}

    def of(self, key, measure):
        if key not in self.all:
            self.all[key] = measure()
            os.makedirs(OUT, exist_ok=True)
            with open(self.path + ".part", "w") as file:
                json.dump(self.all, file, indent=1)
            os.replace(self.path + ".part", self.path)
        return self.all[key]


def errors():
    """Errors that `simulate --error` finds beside the true ones: how many are larger, and how much too large they are in the middle.

    Takes an hour or more. It goes on where it was stopped; with FIGURES_MINUTES=40 no more walls are measured after 40 minutes.
    """
    clock, limit = time.monotonic(), 60 * float(os.environ.get("FIGURES_MINUTES", "inf"))
    kept, groups = Kept("errors"), {}

    def of(*arguments):
        """The errors of a run; None where there is no time left for it."""
        def measure():
            folder = run("error", "simulate", *arguments, "--error", *sets(output__frames=0), allow_failure=True)
            s = load(folder) if folder else {"errors": []}
            return {"errors": s["errors"], **{key: value for key, value in s.items() if key.startswith("exact_")}}
        key = " ".join(os.path.basename(word) for word in arguments)
        return None if key not in kept.all and time.monotonic() - clock > limit else kept.of(key, measure)

    def add(group, s, name, truth):
        if s is not None:
            judge(groups, group, s, name, truth)

    exact = "scenes with exact solutions: kinetic energy, heat flux of the wall"
    for method in ("consistent", "standard"):
        for dx in (0.04, 0.02):
            s = of("taylor-green", *sets(method__name=method, resolution__dx=dx))
            add(exact, s, "kinetic_energy", s and s.get("exact_kinetic_energy"))
        for rows in (20, 40):
            for scene in ("poiseuille", "couette"):
                s = of(scene, *sets(method__name=method, resolution__dx=1 / rows))
                add(exact, s, "kinetic_energy", s and s.get("exact_kinetic_energy"))
            s = of("slab", *sets(method__name=method, resolution__dx=1 / rows, time__end=0.05))
            add(exact, s, "wall_flux[0]", s and s.get("exact_wall_flux", [math.nan])[0])

    # In an order that leaves some of each kind of wall where the time ends.
    walls = reference(SHAPES)
    for row in walls[::3] + walls[1::3] + walls[2::3]:
        q, flow = finite_elements(row["shape"], row["A"])
        for method, name in (("fixed", "fixed"), ("consistent", "moving")):
            s = of(*sets(method__name=method, design__offsets="[" + ",".join(row[f"o{k}"] for k in range(25)) + "]", design__nodes=NODES))
            label = f"walls of the heated channel, {name} particles, dx 0.02: "
            add(label + "Q", s, "q", q)
            add(label + "flow rate", s, "flow_rate", flow)
    return held(groups)


def errors_around():
    """The same of steady flows around the bodies of data/reference, whose errors follow from one solution: at three spacings, without and with a deferred correction."""
    groups = {}
    for corrected, dx in [(with_it, dx) for with_it in (False, True) for dx in (0.03, 0.02, 0.01)]:
        for _, bodies, scene in bodies_in_channel(reference(BODIES)):
            s = load(run("error-around", "simulate", scene, "--error", *sets(resolution__dx=dx, method__deferred_correction=str(corrected).lower())))
            label = f"dx {dx}{', corrected' if corrected else ''}: "
            drag = abs(float(bodies[0]["force_x"]))
            figures = [("flow rate", "flow_rate", bodies[0]["flow_rate"], None)]
            for k, body in enumerate(bodies):
                at = f"shapes[{k + 2}]"
                figures += [("drag", f"{at}.force[0]", body["force_x"], None), ("transverse force, in the drag", f"{at}.force[1]", body["force_y"], drag),
                            ("heat", f"{at}.heat", body["heat"], None)]
            for name, figure, truth, unit in figures:
                judge(groups, label + name, s, figure, float(truth), unit)
    return held(groups)


def judge(groups, group, s, name, truth, unit=None):
    """Adds to a group the error of a figure over the true one, and both in a unit, without one that of the figure."""
    # A figure without an error counts as one outside of it.
    one = next((one for one in s["errors"] if one["name"] == name), {"error": 0.0, "value": math.nan})
    off, unit = abs(one["value"] - truth), unit or abs(truth)
    ratio = one["error"] / max(off, 1e-12) if one["error"] else 0.0
    groups.setdefault(group, []).append((ratio, off / unit, one["error"] / unit))


def held(groups):
    """A table of groups of figures, each with its error over the true one, the true one and the error: how many errors hold."""
    middle = lambda all: sorted(all)[len(all) // 2]
    rows = [[label, len(all), f"{100 * sum(ratio >= 1 for ratio, _, _ in all) / len(all):.0f} %", f"{middle([ratio for ratio, _, _ in all]):.1f}",
             f"{100 * middle([true for _, true, _ in all]):.2f} %", f"{100 * middle([error for _, _, error in all]):.2f} %"]
            for label, all in [*groups.items(), ("all", [one for group in groups.values() for one in group])]]
    return table(["", "figures", "true error inside", "error over true error, median", "true error, median", "error, median"], rows)


def rough():
    """Walls at the limit of steepness, twice as deep as those of `shapes`: which particles run over them."""
    def wave(periods, f):
        return [0.04 * f(2 * math.pi * periods * (x - 0.25) / 0.5) for x in NODES]
    gentle = lambda offsets: [max(-0.04, min(0.04, o)) for o in offsets]
    named = [wave(3, math.sin), wave(2, math.sin), wave(3, math.cos), wave(2, math.cos), [0.04] * 25, [-0.04] * 25,
             [0.04 * max(0, 1 - abs(x - 0.5) / 0.04) for x in NODES], [0.02 * (-1) ** k for k in range(25)],
             [0.04 if 8 <= k < 17 else 0.0 for k in range(25)]]
    random_walls = []
    for seed in range(10):
        source, wall = random.Random(seed), [0.0]
        while len(wall) < 25:
            wall.append(max(wall[-1] - 0.0399, min(wall[-1] + 0.0399, 0.04 * (2 * source.random() - 1))))
        random_walls.append(gentle(wall))
    fixed = {"method__name": "fixed"}
    usual = {"resolution__smoothing_length": 0.8}
    kinds = [("moving particles (default)", {}), ("moving, resolution.smoothing_length 0.8", usual), ("the same, time.cfl 0.5", {"time__cfl": 0.5, **usual}),
             ("the same, method.shift isotropic", {"method__shift": "isotropic", **usual}), ("fixed particles", fixed)]
    rows = [[label] for label, _ in kinds]
    for walls in (named, random_walls):
        keys = [dict(design__offsets="[" + ",".join(f"{o:.6f}" for o in wall) + "]", design__nodes=NODES, design__bound=0.04, time__end=3) for wall in walls]
        exact = [simulate("rough", resolution__dx=0.01, time__cfl=0.6, **key, **fixed)["q"] for key in keys]
        for row, (_, extra) in zip(rows, kinds):
            runs = [simulate("rough", **{**key, **extra}) for key in keys]
            errors = [abs(s["q"] / q - 1) for s, q in zip(runs, exact) if s]
            row += [f"{len(errors)} of {len(walls)}", f"{100 * sum(errors) / len(errors):.1f}, {100 * max(errors):.1f} %" if errors else ""]
    return table(["", "named walls: ran", "error of Q against fixed particles at dx 0.01, mean, worst", "random walls: ran", "error, mean, worst"], rows)


def f32():
    rows = []
    for steps in (100, 500, 2000):
        exact, single = (gradient_of(f"f32-{precision}-{steps}", "--steps", str(steps), "--precision", precision, *sets(method__shift_strength=2))["gradient"]
                         for precision in ("f64", "f32"))
        gap = norm([a - b for a, b in zip(exact, single)]) / norm(exact)
        rows.append([steps, f"{norm(exact):.2e}", f"{gap:.1e}"])
    return table(["steps", "norm of the gradient", "f32 differs by"], rows)


def smooth_walls(count, seed):
    """Random sums of six waves within 0.02."""
    draw = random.Random(seed)
    for _ in range(count):
        waves = [(draw.gauss(0, 1) / k, draw.gauss(0, 1) / k) for k in range(1, 7)]
        level, amplitude = draw.gauss(0, 1), 0.02 * draw.uniform(0.2, 1.0)
        height = []
        for x in NODES:
            s = 2 * math.pi * (x - 0.25)
            height.append(level + sum(a * math.sin(s * k) + b * math.cos(s * k) for k, (a, b) in enumerate(waves, 1)))
        highest = max(abs(h) for h in height)
        yield [round(amplitude * h / highest, 6) for h in height]


def ranks(values):
    order = sorted(range(len(values)), key=values.__getitem__)
    place = [0] * len(values)
    for k, i in enumerate(order):
        place[i] = k
    return place


def correlation(a, b):
    ma, mb = sum(a) / len(a), sum(b) / len(b)
    return sum((x - ma) * (y - mb) for x, y in zip(a, b)) / norm([x - ma for x in a]) / norm([y - mb for y in b])


def surrogate_rank():
    """What the surrogate predicts for 50 random walls, and what the solver says of them."""
    rows = []
    cases = [("2500, 20 (the default)", 2500, 20, 0.9), ("300, 20 (the report's)", 300, 20, 0.9)]
    for label, settle, steps, window in cases:
        predicted, truth = [], []
        for offsets in smooth_walls(50, 7):
            values = sets(surrogate__settle=settle, surrogate__steps=steps, surrogate__window=window, output__frames=0,
                          design__parametrisation="nodes", design__offsets=offsets)
            folder = run("surrogate-rank", "optimize", "--dynamics", "surrogate", "--trust", "check=1", "--epochs", "1", "--no-verify",
                         "--threads", "1", *values)
            s = load(folder)
            predicted.append(s["q_predicted_per_epoch"][0])
            truth.append(s["q_solver_per_epoch"][0])
        ratio = [p / t for p, t in zip(predicted, truth)]
        bias = sum(ratio) / len(ratio)
        spread = norm([r / bias - 1 for r in ratio]) / math.sqrt(len(ratio))
        mean = sum(truth) / len(truth)
        own = norm([t / mean - 1 for t in truth]) / math.sqrt(len(truth))
        rows.append([label, f"{100 * (bias - 1):+.2f} %", f"{100 * spread:.2f} %", f"{100 * own:.2f} %", f"{correlation(predicted, truth):.3f}",
                     f"{correlation(ranks(predicted), ranks(truth)):.3f}"])
    return table(["reference steps of the solver, frames of the surrogate", "bias of Q", "what is left", "spread of the true Q", "correlation",
                  "of ranks"], rows)


def surrogate_starts():
    """The surrogate's optimum in the solver, as a share of what the solver's own search gains."""
    rows = []
    for start in ("flat", "random", "linear", "sine"):
        own = load(run("surrogate-own", "optimize", "--start", start, "--no-verify", *sets(output__frames=0)))
        found = {}
        for trust in ("none", "check=4"):
            s = load(run("surrogate-start", "optimize", "--dynamics", "surrogate", "--trust", trust, "--start", start, "--no-verify",
                         *sets(output__frames=0)))
            found[trust] = s
        gain = own["q"] / own["q_first"] - 1
        row = [start, f"{100 * gain:+.2f} %"]
        for s in found.values():
            ours = (s["q"] - own["q_first"]) / own["q_first"]
            row += [f"{100 * ours:+.2f} %", f"{100 * ours / gain:.0f} %"]
        rows.append(row)
    return table(["start", "solver", "surrogate", "of it", "checked every 4 epochs", "of it"], rows)


def surrogate_compare():
    folder = os.path.join(OUT, "surrogate-compare")
    shutil.rmtree(folder, ignore_errors=True)
    command = [PROGRAM, "optimize", "--compare", "--out", folder, *sets(output__frames=0)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    if result.returncode != 0:
        sys.exit(result.stderr)
    lines = [line for line in result.stdout.splitlines() if not line.startswith("files in") and ": epoch " not in line]
    for name in ("compare.png", "horizons.png"):
        shutil.copy(os.path.join(folder, name), os.path.join(ROOT, "data/pictures", f"surrogate-{name}"))
    return "```text\n" + "\n".join(lines).strip() + "\n```"


def inverse():
    """Initial velocities of the vortices, and viscosity and conductivity of a channel."""
    rows = []
    for steps in (50, 100, 200):
        s = load(run(f"recover-{steps}", "recover", "taylor-green", *sets(time__steps=steps, method__name="standard")))
        rows.append([f"velocities, {s['unknowns']} unknowns, {steps} steps", f"{s['distance_before']:.4f} -> {s['distance']:.6f}",
                     f"{100 * s['velocity_error']:.1f} %", s["epochs"], f"{s['seconds']:.1f}"])
    # JAX-SPH's notebook: its viscosity, disorder and time step.
    block = ["recover", "falling-block", *sets(fluid__viscosity=0.02, time__jitter=0.02, time__cfl=1.1, time__steps=100)]
    floor = ["--set", "water.y=0.3", "--guess", "water.x=0.05", "--guess", "water.y=0.5"]
    for label, more in (("a falling block's places", []), ("the same, from a guess at the wall", ["--guess", "water.x=0.05"]),
                        ("those of one that hits the floor", floor), ("its offset", [*floor, "--unknown", "offset"])):
        s = load(run("recover-block", *block, *more))
        rows.append([f"{label}, {s['unknowns']} unknowns, {s['steps']} steps", f"{s['distance_before']:.4f} -> {s['distance']:.2g}",
                     f"{s['place_error']:.2g} (before: {s['place_error_before']:.3f})", s["epochs"], f"{s['seconds']:.1f}"])
    data = run("seen", "generate", "heated-channel", "--trajectories", "1/1/1", "--frames", "12", *sets(time__start="rest"))
    for viscosity, conductivity in ((0.016, 5.0), (0.006, 12.0)):
        s = load(run("calibrate", "calibrate", "--data", data, *sets(fluid__viscosity=viscosity, fluid__conductivity=conductivity)))
        worst = max(abs(s[key]["error"]) for key in ("fluid.viscosity", "fluid.conductivity"))
        rows.append([f"viscosity and conductivity, from {viscosity} and {conductivity} ({s['steps']} steps)",
                     f"{s['loss_before']:.2g} -> {s['loss']:.1g} (loss)", f"{100 * worst:.4f} %", s["epochs"], f"{s['seconds']:.1f}"])
    return table(["unknown", "distance at the end", "error of what is found", "epochs", "seconds"], rows)


def surrogate_inverse():
    """The vortices' velocities by a learned model, judged in the solver, beside the solver's own find."""
    s = load(run("recover-surrogate", "recover", "taylor-green", "--dynamics", "surrogate"))
    rows = [[name, f"{of['distance']:.4f}", f"{100 * of['velocity_error']:.0f} %", of["epochs"], f"{of['seconds']:.1f}"]
            for name, of in (("the surrogate", s), ("the solver", s["solver"]))]
    model = [s[f"distance_in_the_surrogate{of}"] for of in ("_before", "", "_from_the_true_start")]
    return "\n".join([table(["found by", "distance at the end, in the solver", "velocities wrong", "epochs", "seconds"], rows), "",
                      f"From rest it is {s['distance_before']:.4f}. {s['unknowns']} unknowns, {s['frames']} frames, {s['steps']} steps. In the surrogate: {model[0]:.4f} -> "
                      f"{model[1]:.4f}, and the true start ends {model[2]:.4f} away."])


BODIES = os.path.join(ROOT, "data/reference/bodies-in-channel.csv")
CHANNEL = """scene = "custom"
region = { size = [1.0, 0.4], periodic = [true, false], acceleration = [1.0, 0.0] }
fluid = { viscosity = 0.006, conductivity = 0.006, inlet_temperature = 0.0 }
initial.temperature = 0.0
method.name = "fixed"
[[shapes]]
kind = "box"
lower = [-1.0, -0.2]
upper = [2.0, 0.0]
temperature = 0.0
[[shapes]]
kind = "box"
lower = [-1.0, 0.4]
upper = [2.0, 0.6]
temperature = 0.0
"""


def bodies_in_channel(all_bodies):
    """Name, rows of the reference, and a scene of each geometry."""
    os.makedirs(OUT, exist_ok=True)
    for name in dict.fromkeys(row["geometry"] for row in all_bodies):
        bodies = [row for row in all_bodies if row["geometry"] == name]
        text = CHANNEL
        for body in bodies:
            s = [float(x) for x in body["numbers"].split()]
            own = {"disc": f"radius = {s[2]}", "ellipse": f"axes = {s[2:4]}\nangle = {s[-1]}", "spline": f"radii = {s[2:]}"}[body["kind"]]
            text += f'[[shapes]]\nkind = "{body["kind"]}"\ncentre = {s[:2]}\n{own}\ntemperature = 1.0\n'
        scene = os.path.join(OUT, f"cloud-{name}.toml")
        with open(scene, "w") as file:
            file.write(text)
        yield name, bodies, scene


def cloud():
    """Fixed particles around bodies beside finite elements: errors, particles, seconds."""
    rows = []
    for name, bodies, scene in bodies_in_channel(reference(BODIES)):
        total = lambda key: sum(float(body[key]) for body in bodies)
        row = [name]
        for dx in (0.02, 0.01):
            s = load(run(f"cloud-{name}", "simulate", scene, *sets(resolution__dx=dx)))
            found = s["shapes"][2:]
            row += [f"{s['particles']}", percent(s["flow_rate"], float(bodies[0]["flow_rate"]))[:-2], percent(sum(f["force"][0] for f in found), total("force_x"))[:-2],
                    percent(sum(f["heat"] for f in found), total("heat"))[:-2], f"{s['wall_seconds']:.2f}"]
        rows.append(row)
    return table(["geometry", "dx 0.02: particles", "flow", "drag", "heat", "s", "dx 0.01: particles", "flow", "drag", "heat", "s"], rows)


def around():
    """The four examples with fixed particles: what a search finds, and what finite elements say of it (python3 with their packages: FEM_PYTHON)."""
    rows = []
    for name in ("heated-cylinder", "least-drag", "three-pins", "airfoil"):
        clock = time.monotonic()
        folder = run(f"around-{name}", "optimize", f"data/scenes/examples/{name}.toml")
        seconds = time.monotonic() - clock
        s = load(folder)
        key = next(key[:-6] for key in s if key.endswith("_first"))
        command = [os.environ.get("FEM_PYTHON", "python3"), os.path.join(ROOT, "scripts/bodies_fem.py"), folder]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        values = []
        for line in lines:
            found = json.loads(line.split(" ", 1)[1])["shapes"]
            drag, lift = (sum(f["force"][k] for f in found) for k in (0, 1))
            values.append({"drag": drag, "lift_over_drag": lift / drag}.get(key) or sum(f.get("heat", 0) for f in found))
        rows.append([name, key, len(s["variables"]), f"{s[key + '_first']:.5f}", f"{s[key]:.5f}", percent(s[key], s[key + "_first"]), f"{100 * s['gain']:+.2f} +- {100 * s['gain_error']:.2f} %",
                     f"{values[0]:.5f}", f"{values[1]:.5f}", percent(values[1], values[0]), f"{sum(s['seconds_per_epoch']):.1f}, {seconds:.1f}"])
    return table(["example", "objective", "numbers", "first", "best", "change", "gain with half the spacing", "finite elements: first", "best", "change", "seconds of search, of the command"], rows)


def busy():
    """Threads on a machine that others use too."""
    from busy import report
    return report([4, 8], 3, ["simulate", "heated-channel"])


def fluid_of(path):
    """x and density of the fluid in a frame."""
    with open(path, "rb") as file:
        text, numbers = file.read().split(b'<AppendedData encoding="raw">\n_', 1)
    def block(name):
        offset = int(re.search(rf'Name="{name}"[^>]* offset="(\d+)"', text.decode())[1])
        return numbers[offset + 8:offset + 8 + int.from_bytes(numbers[offset:offset + 8], "little")]
    points, density, tags = array.array("d", block("Points")), array.array("d", block("density")), block("tag")
    fluid = [i for i, tag in enumerate(tags) if tag == 0]
    return [points[3 * i] for i in fluid], [density[i] for i in fluid]


def frames_of(folder):
    """Time and file of each frame."""
    with open(os.path.join(folder, "particles/particles.pvd")) as file:
        found = re.findall(r'timestep="([^"]+)".*file="([^"]+)"', file.read())
    return [(float(time), os.path.join(folder, "particles", name)) for time, name in found]


def density():
    """How well the density of the collapsing column is held, before and after its front meets the other wall."""
    def cells(folder):
        parts = {True: [], False: []}
        for time, name in frames_of(folder):
            parts[time < 2.5] += [abs(rho - 1) for rho in fluid_of(name)[1]]
        out = []
        for part in (parts[True], parts[False]):
            part.sort()
            beyond = sum(1 for off in part if off > 0.01) / len(part)
            out += [f"{100 * sum(part) / len(part):.2f} %", f"{100 * part[int(0.99 * len(part))]:.1f} %", f"{100 * beyond:.1f} %"]
        return out
    kinds = [("", {})]
    kinds += [(f"{key} {value}", {key.replace(".", "__"): value}) for key, value in (
        ("resolution.dx", 0.02), ("fluid.sound_speed_factor", 20), ("fluid.sound_speed_factor", 40), ("method.flux", "delta"), ("method.flux", "riemann"))]
    rows = []
    for label, keys in kinds:
        folder = run("dam-break-density", "simulate", "dam-break", *sets(output__frames=120, **keys))
        rows.append([label or "as it is", *cells(folder), f"{load(folder)['wall_seconds']:.0f}"])
    return table(["", "until t = 2.5: mean", "99 % within", "beyond 1 %", "after it: mean", "99 % within", "beyond 1 %", "seconds"], rows)


def front():
    """The front of a collapsing column beside Martin and Moyce's (1952), as it is and with their clock put back."""
    seen = [tuple(float(x) for x in line.split(",")) for line in open(os.path.join(ROOT, "data/reference/dam-break-front.csv")) if line[0].isdigit()]
    column = dict(water__length=1, water__height=2, tank__length=8, tank__height=3, time__end=3.2, fluid__reference_velocity=2, output__frames=160)
    width = 0.05
    def mean(points, delay):
        errors = []
        for time, place in seen:
            later = next((k for k, (t, _) in enumerate(points) if t >= time - delay), None)
            if later and time <= points[-1][0]:
                (t0, z0), (t1, z1) = points[later - 1], points[later]
                errors.append((z0 + (z1 - z0) * (time - delay - t0) / (t1 - t0)) / place - 1)
        return errors
    def cells(points):
        size = lambda delay: sum(abs(e) for e in mean(points, delay)) / len(mean(points, delay))
        delay = min((k / 100 for k in range(40)), key=size)
        return [f"{100 * sum(mean(points, 0)) / len(mean(points, 0)):+.1f} %", f"{delay:.2f}", f"{100 * size(delay):.1f} %"]
    kinds = [(f"dx {dx}", {"resolution__dx": dx}) for dx in (0.1, 0.05, 0.025, 0.0125)]
    kinds += [(f"dx 0.025, {name}", {"resolution__dx": 0.025, **keys}) for name, keys in (
        ("method.flux delta", {"method__flux": "delta"}), ("method.flux riemann", {"method__flux": "riemann"}),
        ("wall.slip free-slip", {"wall__slip": "free-slip"}), ("method.artificial_viscosity 0.02", {"method__artificial_viscosity": 0.02}),
        ("fluid.sound_speed_factor 20", {"fluid__sound_speed_factor": 20}))]
    rows = []
    for label, keys in kinds:
        folder = run("dam-break", "simulate", "dam-break", *sets(**column, **keys))
        ends, deep = [], []
        for time, name in frames_of(folder):
            (x, _), dx = fluid_of(name), keys["resolution__dx"]
            water = {}
            for place in x:
                water[int(place / width)] = water.get(int(place / width), 0) + dx * dx / width
            ends.append((time * 2**0.5, max(x) + dx / 2))
            deep.append((time * 2**0.5, width * (1 + max(k for k, depth in water.items() if depth >= 0.1))))
        rows.append([label, *cells(ends), *cells(deep)])
    return table(["", "front: ahead by, mean", "delay T", "off with it", "where the water is 0.1 a deep: ahead by", "delay T", "off with it"], rows)


def summary():
    """The fields of summary.json, from data/summary.toml: nothing is measured."""
    import tomllib
    with open(os.path.join(ROOT, "data/summary.toml"), "rb") as file:
        groups = tomllib.load(file)
    out = []
    for title, fields in groups.items():
        rows = [[f"`{name}`", of["unit"], of["in"].replace(" ", ", "), of.get("when", ""), of["what"]] for name, of in fields.items()]
        out += [f"## {title}", "", table(["field", "unit", "in the file of", "there if", "what"], rows), ""]
    return "\n".join(out)


surrogate_figures = {"surrogate-inverse": surrogate_inverse, "surrogate-rank": surrogate_rank, "surrogate-starts": surrogate_starts, "surrogate-compare": surrogate_compare}
solver_figures = (accuracy, validation, switches, gradient, growth, cfl, starts, gain, constraints, drift, shapes, rough, f32, inverse, cloud, errors, errors_around, around, summary, busy, front, density)
PICTURES = {"pictures": QUICK, "pictures-slow": SLOW}
FIGURES = {**{f.__name__: f for f in solver_figures}, **surrogate_figures, **SPEED}


def main():
    wanted, only_print = [name for name in sys.argv[1:] if name != "--print"], "--print" in sys.argv
    if wanted == ["--check"]:
        sys.exit("\n".join(check(FIGURES)) or 0)
    if not wanted or any(name not in {**FIGURES, **PICTURES} for name in wanted):
        sys.exit(__doc__)
    for name in wanted:
        if name in PICTURES:
            print(remake(PICTURES[name]))
            continue
        text = re.sub(r"e([+-])0(\d)\b", lambda m: "e" + m[1].strip("+") + m[2], FIGURES[name]())
        print(f"\n## {name}\n\n{text}\n")
        if not only_print and not write(name, text):
            sys.exit(f"no page has the place of {name}: <!-- figures: {name} --> and <!-- end -->")


if __name__ == "__main__":
    main()
