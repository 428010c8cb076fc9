"""Figures of speed: `hydrograd bench`, and what scripts/peers/run.sh and time_error.py measured. Called by figures.py."""
import json
import os
import subprocess
import sys

from pages import ROOT, table

PROGRAM = os.environ.get("HYDROGRAD", os.path.join(ROOT, "target/release/hydrograd"))
OUT = os.path.join(ROOT, "runs/figures")


def bench(name, *arguments):
    """Rows of a bench."""
    folder = os.path.join(OUT, name)
    command = [PROGRAM, "bench", *arguments, "--out", folder]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{done.stderr}")
    return load(os.path.join(folder, "bench.json"))


def load(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def find(rows, **keys):
    return next((row for row in rows if all(row.get(key) == value for key, value in keys.items())), None)


def ms(value):
    """Three digits."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def megabytes(row):
    return f"{row['peak_memory_bytes'] / 1e6:.0f}"


def bench_kernels():
    rows = bench("bench-kernels", "kernels", "--threads", "2", "--precision", "f64", "--repeats", "2")
    lines = []
    for scene, n in dict.fromkeys((row["scene"], row["particles"]) for row in rows):
        same = [row for row in rows if (row["scene"], row["particles"]) == (scene, n)]
        cells, gradient = [], None
        for kinds in (("forward",), ("gradient", "training")):
            both = [next(row for row in same if row["kind"] in kinds and row["mode"] == mode) for mode in ("composed", "fused")]
            composed, fused = (row["ms_per_step"] for row in both)
            cells += [ms(composed), ms(fused), f"{composed / fused:.1f}"]
            gradient = both
        lines.append([f"{words(scene)}, {n}, {same[0]['precision']}", *cells, ", ".join(megabytes(row) for row in gradient)])
    return table(["ms per step", "composed", "fused", "faster by", "gradient or training: composed", "fused", "faster by", "MB"], lines)


def words(scene):
    """A scene or a network as a page names it."""
    if scene.startswith("gns-"):
        _, rounds, latent, radius = scene.split("-")
        return f"GNS-{rounds}-{latent}, {radius.removesuffix('dx')} dx"
    return scene.replace("-", " ").capitalize()


def bench_gradient():
    rows = bench("bench-gradient", "step", "gradient", "--preset", "report-jax-sph", "--repeats", "2")
    one, two, single = dict(precision="f64", threads=1), dict(precision="f64", threads=2), dict(precision="f32", threads=2)
    words = {"every state": "gradient, every state kept",
             "best segments": "gradient, segments of the least memory without running a step twice",
             "10 % of every state": "gradient, in 10 % of the memory of every state",
             "every state in f32": "gradient, every state rounded to f32",
             "taped": "gradient, one tape"}
    lines = []
    for mode in dict.fromkeys(row.get("mode") for row in rows):
        group = {"mode": mode} if mode else {"kind": "forward"}
        cell = lambda keys: (lambda row: f"{row['ms_per_step']:.3f}" if row else "")(find(rows, **group, **keys))
        work = words.get(mode, f"gradient, {mode}") if mode else "forward"
        lines.append([work, cell(one), cell(two), cell(single), megabytes(find(rows, **group, **two))])
    return table(["work, ms per step", "f64, 1 thread", "2 threads", "f32, 2 threads", "peak of the process, f64, MB"], lines)


def bench_formulations():
    lines, standard = [], None
    for label, sets in [("standard", ["method.name=standard", "resolution.smoothing_length=1.0", "time.cfl=2"]), ("moving particles (default)", []),
                        ("moving, a flow rate held", ["fluid.drive=flow-rate"]), ("fixed particles", ["method.name=fixed"]),
                        ("fixed, a flow rate held", ["method.name=fixed", "fluid.drive=flow-rate"])]:
        sets = [word for key in (*sets, "time.steps=500", "objective.window=0") for word in ("--set", key)]
        rows = bench("bench-formulations", "step", "gradient", "heated-channel", "--precision", "f64", "--threads", "2", "--repeats", "3", *sets)
        forward, gradient = find(rows, kind="forward"), find(rows, kind="gradient", mode="every state")
        step = forward["ms_per_step"]
        standard = standard or step
        lines.append([label, forward["particles"], f"{step:.4f}", f"{step / standard:.2f}", f"{gradient['ms_per_step']:.3f}",
                      f"{gradient['ms_per_step'] / step:.1f}", megabytes(gradient)])
    return table(["formulation, dx 0.02, 500 steps", "particles", "ms per step", "over standard", "gradient, ms per step", "over forward", "gradient, MB"], lines)


def bench_scaling():
    rows = bench("bench-scaling", "scaling", "--sizes", "100^2,316^2,1000^2,40^3", "--precision", "f64", "--repeats", "2", "--memory-limit", "6GB")
    lines = []
    for n in dict.fromkeys(row["particles"] for row in rows):
        cells = [find(rows, particles=n, kind=kind, threads=threads) for kind in ("forward", "gradient") for threads in (1, 2)]
        size = f"{n:,}".replace(",", " ") + (" in 3D" if cells[0]["dimension"] == 3 else "")
        lines.append([size, *(f"{cell['ns_per_particle_step']:.0f}" if cell else "" for cell in cells)])
    return table(["particles", "forward, 1 thread", "2 threads", "gradient, 1 thread", "2 threads"], lines)


def bench_plan():
    rows = bench("bench-plan", "plan", "--precision", "f64", "--repeats", "2")
    words = {"isothermal": "heat", "wall-free": "walls", "inviscid": "viscosity", "no-transport-velocity": "transport velocity",
             "constant-mass": "masses of its own"}
    lines = []
    for scene, lacking in words.items():
        cells = [[find(rows, scene=scene, kind=kind, mode=mode)["ms_per_step"] for mode in ("everything on", "plan")]
                 for kind in ("forward", "gradient")]
        lines.append([lacking, *(f"{everything / plan:.2f}x" for everything, plan in cells)])
    return table(["scene without", "forward", "gradient"], lines)


def bench_surrogate():
    rows = bench("bench-surrogate", "surrogate", "--threads", "2", "--repeats", "2")
    lines = []
    for row in sorted(rows, key=lambda row: (-row["gflop_per_step"], row["kind"] == "forward")):
        lines.append([words(row["scene"]), row["kind"], ms(row["ms_per_step"]), f"{row['gflops']:.0f}",
                      f"{row['sgemm_gflops']:.0f}", f"{100 * row['gflops'] / row['sgemm_gflops']:.0f} %", megabytes(row)])
    lines.sort(key=lambda line: line[0], reverse=True)
    return table(["network, radius", "work", "ms", "GFLOP/s", "sgemm", "share", "memory, MB"], lines)


def peers_rows(name):
    path = os.path.join(ROOT, "runs/peers", name)
    if not os.path.exists(path):
        sys.exit(f"there is no {path}: run scripts/peers/run.sh first (--surrogate for the networks; time_error.py for time-error)")
    return load(path)


def peers():
    """Of the table of scripts/peers/compare.py, what the page shows."""
    sys.path.insert(0, os.path.join(ROOT, "scripts/peers"))
    from compare import comparable, key
    rows = peers_rows("peers.json")
    lines = []
    for theirs in (row for row in rows if row["code"] == "jax-sph"):
        ours = [row for row in rows if row["code"] == "hydrograd" and key(row) == key(theirs) and comparable(row)]
        # One row with segments besides, for less memory: not its best.
        if not ours or "segments" in (theirs.get("mode") or ""):
            continue
        ours = min(ours, key=lambda row: row["ms_per_step"])
        scene = words(theirs["scene"]) + (" 3D" if theirs["dimension"] == 3 else "")
        work = f"{theirs['steps']}-step gradient" if theirs["steps"] == 2000 and theirs["kind"] == "gradient" else theirs["kind"]
        lines.append([scene, theirs["particles"], theirs["precision"], work, ms(theirs["ms_per_step"]), ms(ours["ms_per_step"]),
                      f"{theirs['ms_per_step'] / ours['ms_per_step']:.0f}", megabytes(theirs), megabytes(ours)])
    return table(["scene", "particles", "type", "work", "JAX-SPH, ms per step", "hydrograd", "ratio", "memory, MB", "hydrograd"], lines)


def peers_surrogate():
    rows = peers_rows("surrogate.json")
    codes = ["lagrangebench", "pytorch", "pytorch, split edge layer", "hydrograd"]
    lines = []
    for ours in sorted((row for row in rows if row["code"] == "hydrograd"), key=lambda row: (-row["pairs"], row["kind"] == "forward")):
        same = [find(rows, code=code, scene=ours["scene"], kind=ours["kind"]) for code in codes]
        ratios = [f"{row['ms_per_step'] / ours['ms_per_step']:.1f}" if row else "-" for row in same[:-1]]
        lines.append([f"{ours['scene'].split('-')[-1].removesuffix('dx')} dx, {ours['pairs']}", ours["kind"],
                      *(f"{row['ms_per_step']:.0f} ({row['ms_per_step_median']:.0f})" if row else "-" for row in same),
                      ", ".join(ratios), ", ".join(megabytes(row) if row else "-" for row in same)])
    return table(["radius, edges", "work", "LagrangeBench", "PyTorch", "PyTorch, split", "hydrograd", "ours is faster by",
                  "memory, MB, same order"], lines)


def time_error():
    """Of the rows of scripts/peers/time_error.py, a line for each question and contestant."""
    sys.path.insert(0, os.path.join(ROOT, "scripts/peers"))
    from time_error_pictures import page_table
    return page_table(list(peers_rows("time-error.json")["rows"].values()))


FIGURES = {"bench-kernels": bench_kernels, "bench-gradient": bench_gradient, "bench-formulations": bench_formulations, "bench-scaling": bench_scaling, "bench-plan": bench_plan,
           "bench-surrogate": bench_surrogate, "peers": peers, "peers-surrogate": peers_surrogate, "time-error": time_error}
