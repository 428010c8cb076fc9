#!/usr/bin/env python3
"""Bodies in a channel at random beside finite elements: do the errors of flow rate, force and heat, and that of the gain of `optimize`, hold?

    python3 scripts/random_bodies.py figures --count 20     one or two discs, ellipses and splines with `simulate --error`
    python3 scripts/random_bodies.py corners --count 20     the same with polygons of three to five corners
    python3 scripts/random_bodies.py fins --count 12        one to three boxes or leaning plates on the floor, with half of these a hot one
    python3 scripts/random_bodies.py gain --count 12        an ellipse or a spline of an area, by `optimize`: least drag, or most heat

Fixed particles, steady flows. Places, sizes, viscosity and conductivity are drawn by --seed and number; half of the channels are periodic and driven
by a body force, the others have an inflow and an outflow. One line for each scene: how far figures are from those of bodies_fem.py (fins_fem.py) and, in
brackets, their errors, in per cent (transverse forces in per cent of the drag, torques of drag times radius); then how many hold, and how much
larger than the true error the error is in the middle. HYDROGRAD names another program than target/release/hydrograd. Needs what bodies_fem.py needs.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import tomllib

os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
PROGRAM = os.environ.get("HYDROGRAD", os.path.join(os.path.dirname(HERE), "target/release/hydrograd"))


def body(kind, centre, size, random, temperature):
    number = lambda least, most: float(np.round(random.uniform(least, most), 3))
    own = {
        "disc": lambda: f"radius = {size}",
        "ellipse": lambda: f"axes = [{size}, {round(size * number(0.45, 1), 3)}]\nangle = {round(number(0, 180))}",
        "spline": lambda: f"radii = {[round(size * number(0.65, 1), 3) for _ in range(int(random.integers(5, 9)))]}",
        "polygon": lambda: f"points = {polygon(centre, size, random)}",
    }[kind]()
    if kind == "polygon":
        return f'[[shapes]]\nkind = "polygon"\ntemperature = {temperature}\n{own}\n'
    return f'[[shapes]]\nkind = "{kind}"\ncentre = {list(centre)}\ntemperature = {temperature}\n{own}\n'


def polygon(centre, size, random):
    """Corners around a centre."""
    count, turn = int(random.integers(3, 6)), random.uniform(0, 2 * np.pi)
    angles = turn + 2 * np.pi * (np.arange(count) + random.uniform(-0.2, 0.2, count)) / count
    return [[round(float(c + size * r * f(a)), 4) for c, f in zip(centre, (np.cos, np.sin))] for a, r in zip(angles, random.uniform(0.75, 1.15, count))]


ROUND = ("disc", "ellipse", "spline")


def scene(random, searched, kinds=ROUND):
    """A scene's text, and the number of its first body."""
    number = lambda least, most, digits=3: float(np.round(random.uniform(least, most), digits))
    height, length, viscosity = float(random.choice([0.4, 0.5, 0.6])), float(random.choice([0.8, 1.0, 1.4])), number(0.005, 0.03, 4)
    periodic, size = random.random() < 0.5, number(0.06, 0.1)
    force, speed, wall = number(0.2, 1.2, 2), number(0.3, 1.0, 2), number(0, 1, 2)
    first = 2 if periodic else 0
    text = f'scene = "custom"\nmethod.name = "fixed"\nresolution = {{ dx = {random.choice([0.02, 0.025])} }}\ninitial = {{ temperature = 0.0 }}\n'
    text += f"fluid = {{ viscosity = {viscosity}, conductivity = {number(0.6, 3, 2) * viscosity:.5f} }}\n"
    goal = ["drag", "smaller"] if random.random() < 0.5 else ["shape-heat", "larger"]
    text += f'objective = {{ kind = "{goal[0]}", goal = "{goal[1]}", shapes = [{first}] }}\n'
    place = (number(0.33 * length, 0.45 * length), number(0.45 * height, 0.55 * height))
    kind = str(random.choice(["ellipse", "spline"] if searched else kinds))
    if searched:
        lower, upper, area = 0.7 * size, 1.35 * size, np.pi * size**2
        names = ["axes[0]", "axes[1]"] if kind == "ellipse" else [f"radii[{k}]" for k in range(6)]
        variables = [f'{{ number = "shapes[{first}].{name}", lower = {lower:.4f}, upper = {upper:.4f} }}' for name in names]
        if kind == "ellipse":
            variables.append(f'{{ number = "shapes[{first}].angle", lower = -40.0, upper = 40.0 }}')
        text += f"variables = [{', '.join(variables)}]\noptimise = {{ epochs = 15 }}\n"
        text += f'limits = [{{ kind = "area", shapes = [{first}], at_least = {0.97 * area:.6f}, at_most = {1.03 * area:.6f} }}]\n'
        round_one = f"axes = [{size}, {size}]\nangle = 0.0" if kind == "ellipse" else f"radii = {[size] * 6}"
        bodies = f'[[shapes]]\nkind = "{kind}"\ncentre = {list(place)}\ntemperature = 1.0\n{round_one}\n'
    else:
        bodies = body(kind, place, size, random, number(0.5, 2))
        if random.random() < 0.35:
            bodies += body(kinds[0], (number(0.7 * length, 0.78 * length), number(0.4 * height, 0.6 * height)), number(0.05, 0.08), random, number(0.5, 2))
    sides = f'{{ left = {{ kind = "inflow", velocity = ["{speed}*4*y*({height} - y)/{height}^2", 0], temperature = "0" }}, right = {{ kind = "outflow" }} }}'
    text += f"[region]\nsize = [{length}, {height}]\nperiodic = [{str(periodic).lower()}, false]\nacceleration = [{force if periodic else 0.0}, 0.0]\n"
    if periodic:
        for low, high in ((-0.2, 0.0), (height, height + 0.2)):
            text += f'[[shapes]]\nkind = "box"\nlower = [-1.0, {low}]\nupper = [3.0, {high}]\ntemperature = {wall}\n'
    else:
        text += f"sides = {sides}\n"
    return text + bodies, first


def fins(random):
    """A scene with fins, and the number of the first."""
    number = lambda least, most, digits=4: float(np.round(random.uniform(least, most), digits))
    length, height = float(random.choice([1.5, 2.0, 3.0])), float(random.choice([0.4, 0.5, 0.8]))
    dx, fastest, first = round(height / random.choice([20, 25, 32]), 5), number(0.5, 1.2), int(random.random() < 0.6)
    text = f'scene = "custom"\nmethod.name = "fixed"\nresolution.dx = {dx}\ninitial.temperature = 0.0\nobjective.target_x = {length}\n'
    text += f"fluid = {{ viscosity = {random.choice([0.005, 0.01, 0.02, 0.05])}, conductivity = {random.choice([0.005, 0.01, 0.03])}, inlet_temperature = 0.0 }}\n"
    inflow = f'{{ kind = "inflow", velocity = ["{4 * fastest / height**2:.5f}*y*({height} - y)", 0], temperature = 0 }}'
    text += f'[region]\nsize = [{length}, {height}]\nperiodic = [false, false]\nsides = {{ left = {inflow}, right = {{ kind = "outflow" }} }}\n'
    if first:
        text += f'[[shapes]]\nkind = "box"\nlower = [{0.15 * length:.4f}, -0.3]\nupper = [{0.8 * length:.4f}, 0.0]\ntemperature = 1.0\n'
    count = int(random.integers(1, 4))
    for k in range(count):
        x = 0.15 * length + 0.65 * length * (k + 0.5 + number(-0.1, 0.1)) / count
        top, thick, leans = number(0.15, 0.55) * height, number(2, 5) * dx, number(-0.3, 0.3)
        if random.random() < 0.5:
            own = f'kind = "box"\nlower = [{x - thick / 2:.4f}, -0.1]\nupper = [{x + thick / 2:.4f}, {top:.4f}]'
        else:
            own = f'kind = "polyline"\npoints = [[{x - 0.1 * leans:.4f}, -0.1], [{x + leans * top:.4f}, {top:.4f}]]\nthickness = {thick:.4f}'
        text += f"[[shapes]]\n{own}\ntemperature = 1.0\n"
    return text, first


def finite_elements(path, script="bodies_fem.py", *more):
    """Figures of a scene, or of the first and the best shapes of a search."""
    done = subprocess.run([sys.executable, os.path.join(HERE, script), path, *more], capture_output=True, text=True, check=True)
    return [json.loads(line[line.index("{"):]) for line in done.stdout.splitlines() if "{" in line]


def size_of(path, k):
    """About the radius of a body."""
    with open(path, "rb") as file:
        shape = tomllib.load(file)["shapes"][k]
    if "points" in shape:
        return 0.5 * float(np.ptp(np.array(shape["points"]), axis=0).max())
    return shape.get("radius") or float(np.mean(shape.get("axes") or shape["radii"]))


def measured(path, out):
    """The summary of a run, and the errors of figures by name; none if it failed."""
    record = run("simulate", path, "--error", "--out", out)
    return record, record and {one["name"]: one["error"] for one in record["errors"]}


def force_and_heat(record, errors, shape, truth, all_of_them):
    """Those of a shape, beside those of finite elements for this one and all."""
    own = record["shapes"][shape]
    for along, name in enumerate(["drag", "lift"]):
        yield name, own["force"][along] - truth["force"][along], errors.get(f"shapes[{shape}].force[{along}]"), truth["force"][0]
    yield "heat", own["heat"] - truth["heat"], errors.get(f"shapes[{shape}].heat"), max(abs(one["heat"]) for one in all_of_them)


def figures(path, out, first):
    record, errors = measured(path, out)
    if record is None:
        return
    (truth,) = finite_elements(path)
    yield "flow rate", record["flow_rate"] - truth["flow_rate"], errors.get("flow_rate"), truth["flow_rate"]
    for k, of_body in enumerate(truth["shapes"]):
        yield from force_and_heat(record, errors, first + k, of_body, truth["shapes"])
        size = np.sqrt(of_body["force"][0] ** 2 + of_body["force"][1] ** 2) * size_of(path, first + k)
        yield "torque", record["shapes"][first + k]["torque"] - of_body["torque"], errors.get(f"shapes[{first + k}].torque"), size


def of_fins(path, out, first):
    record, errors = measured(path, out)
    if record is None:
        return
    (truth,) = finite_elements(path, "fins_fem.py", "--far", "0.025")
    for name, figure in (("outflow", "heat_outflow"), ("pressure drop", "pressure_drop")):
        yield name, record[figure] - truth[figure], errors.get(figure), truth[figure]
    for k, of_fin in enumerate(truth["fins"]):
        yield from force_and_heat(record, errors, first + k, of_fin, truth["fins"])


def gain(path, out, _):
    record = run("optimize", path, "--out", out)
    if record is None:
        return
    first, best = finite_elements(out)
    of = (lambda found: found["shapes"][0]["force"][0]) if record["objective_kind"] == "drag" else (lambda found: found["shapes"][0]["heat"])
    truth = (of(best) / of(first) - 1) * (-1 if record["objective_kind"] == "drag" else 1)
    yield f"gain {100 * truth:.2f} %", record["gain"] - truth, record["gain_error"], 1.0


def run(*words):
    """The summary of a run, or none."""
    done = subprocess.run([PROGRAM, *words, "--threads", "1"], capture_output=True, text=True)
    if done.returncode:
        print(f"  ended with {done.returncode}: {done.stderr.strip()[:300]}", flush=True)
        return None
    with open(os.path.join(words[words.index("--out") + 1], "summary.json")) as file:
        return json.load(file)


def conclude(found):
    """Says how many errors hold, given (true error, error, unit) of figures by name, and ends."""
    for name, all_of_it in found.items():
        off, error, unit = np.array(all_of_it).T
        print(f"{name}: {len(off)}, {100 * np.mean(off <= error):.0f} % inside, error over true error {np.median(error / np.maximum(off, 1e-12)):.1f}, true error {100 * np.median(off / unit):.2f} %, error {100 * np.median(error / unit):.2f} % (medians)")
    sys.exit(not found)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["figures", "corners", "fins", "gain"])
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--seed", type=int, default=3000)
    options = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.count):
            random = np.random.default_rng(options.seed + turn)
            kinds = ("polygon",) if options.what == "corners" else ROUND
            text, first = fins(random) if options.what == "fins" else scene(random, options.what == "gain", kinds)
            path, out = os.path.join(folder, f"{turn}.toml"), os.path.join(folder, f"run-{turn}")
            with open(path, "w") as file:
                file.write(text)
            told = []
            for name, off, error, unit in {"gain": gain, "fins": of_fins}.get(options.what, figures)(path, out, first):
                if error is not None:
                    found.setdefault(name.split()[0], []).append((abs(off), error, abs(unit)))
                    told.append(f"{name} {100 * off / abs(unit):+.3f} ({100 * error / abs(unit):.3f}){'' if abs(off) <= error else ' OUT'}")
            print(f"{turn:3d} {'; '.join(told)}", flush=True)
    conclude(found)


if __name__ == "__main__":
    main()
