#!/usr/bin/env python3
"""Run time against error, one picture for each question: hydrograd's methods, finite elements as a user would pick them, and JAX-SPH.

    python3 -m venv ~/.cache/hydrograd/finite-elements
    ~/.cache/hydrograd/finite-elements/bin/pip install -r scripts/peers/requirements-finite-elements.txt
    ~/.cache/hydrograd/finite-elements/bin/python scripts/peers/time_error.py [a b c d e] [--quick] [--program target/release/hydrograd]

a  Q of a curved wall of the heated channel (sin1:0.02 of data/reference/fem-sharp.csv)
b  the gradient of that Q by the wall's 25 nodes, against the exact one of sharp finite elements (channel_fem.py)
c  the whole optimisation from a flat wall: what the walls truly gain (channel_fem.py) over time; 1.63 % are possible
d  the velocity of Taylor and Green's vortices at half of their life, nu 0.05 and 0.005
e  drag and lift of a cylinder in a channel (data/scenes/schaefer-turek-1.toml)

Each point is one process with one thread. What counts is its processor time (user and system), with start-up and compiling, so that other work
on the machine changes little. Results go to runs/peers/time-error.json, where a run goes on that was stopped; delete the file to measure anew.
(Rows of hydrograd are measured again when the program is another one.) The table of all rows is runs/peers/time-error.md; pictures are
data/pictures/time-error-a.png to -e.png, with --quick in runs/peers. All of it takes about a quarter of an hour, --quick two or three. JAX-SPH runs
in the environment that scripts/peers/run.sh makes (HYDROGRAD_PEERS names its folder) and is left out where there is none. `python3 scripts/figures.py time-error` writes the table of the page.
"""
import argparse
import csv
import hashlib
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
sys.dont_write_bytecode = True
sys.path[:0] = [HERE, os.path.dirname(HERE)]
OUT = os.path.join(ROOT, "runs/peers")
PATH = os.path.join(OUT, "time-error.json")
WALL, POSSIBLE = "sin1:0.02", 0.0163
DRAG, LIFT = 5.57953523384, 0.010618948146
HYDROGRAD = ("fixed particles", "moving particles", "standard SPH")
FE, GRADED, JAX = "finite elements", "finite elements, graded mesh", "JAX-SPH"
# No process may take more processor seconds.
LIMIT = 240
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": "", "PYTHONDONTWRITEBYTECODE": "1"}


class Kept:
    """Rows by key in runs/peers/time-error.json: what is there is not measured again."""

    def __init__(self, program):
        with open(program, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        self.all = {"rows": {}, "truth": {}}
        if os.path.exists(PATH):
            with open(PATH) as file:
                self.all = json.load(file)
        if self.all.get("program") != digest:
            self.all["program"] = digest
            self.all["rows"] = {key: row for key, row in self.all["rows"].items() if row["contestant"] in (FE, GRADED, JAX)}

    def of(self, question, contestant, at, measure):
        key = f"{question} | {contestant} | {at}"
        if key not in self.all["rows"]:
            self.all["rows"][key] = {"question": question, "contestant": contestant, "at": at, **measure()}
            self.write()
        # At the end, so that rows come in the order of the questions.
        row = self.all["rows"][key] = self.all["rows"].pop(key)
        what = row.get("failed") or "  ".join(f"{name} {value:.2e}" for name, value in row["errors"].items() if value is not None)
        print(f"{question}  {contestant:<30} {at:<14} {row['seconds']:8.2f} s   {what}", flush=True)
        return row

    def write(self):
        os.makedirs(OUT, exist_ok=True)
        with open(PATH + ".part", "w") as file:
            json.dump(self.all, file, indent=1)
        os.replace(PATH + ".part", PATH)


def cpu_of(pid):
    """Processor seconds of a process that runs."""
    with open(f"/proc/{pid}/stat") as file:
        words = file.read().rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def run(command, one_core=False):
    """Runs a command on one thread: code, output as (processor seconds so far, seconds by the clock, line), errors, and both kinds of seconds."""
    def limits():
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 5))
        if one_core:
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    clock, lines = time.perf_counter(), []
    with tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=ROOT, env={**os.environ, **ONE_THREAD},
                                 preexec_fn=limits)
        for line in child.stdout:
            lines.append((cpu_of(child.pid), time.perf_counter() - clock, line.rstrip()))
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        complaint = errors.read().strip()
    return child.returncode, lines, complaint, used.ru_utime + used.ru_stime, time.perf_counter() - clock


def failure(code, complaint):
    """Why a command gave no result, in a line."""
    if code < 0:
        return f"stopped after {LIMIT} s"
    return next((line for line in complaint.splitlines() if "error" in line.lower()), complaint[-200:] or f"exit code {code}")[:200]


def measured(command, errors, one_core=False):
    """A row of a command that prints JSON in its last line; `errors` makes errors of it."""
    code, lines, complaint, seconds, wall = run(command, one_core)
    row = {"seconds": seconds, "wall": wall, "start": None, "compile": None, "errors": {}}
    if code != 0:
        return {**row, "failed": failure(code, complaint)}
    found = json.loads(lines[-1][-1])
    row |= {"start": found["start"], "compile": found.get("compile"), "solver": found.get("solver"), "unknowns": found.get("unknowns")}
    try:
        return {**row, "errors": errors(found)}
    except TypeError:
        return {**row, "failed": "diverged"}


def by_fem(task, errors):
    return measured([sys.executable, os.path.join(HERE, "user_fem.py"), *map(str, task)], errors)


class Race:
    def __init__(self, options):
        self.program, self.quick = os.path.abspath(options.program), options.quick
        self.kept = Kept(self.program)
        folder = os.environ.get("HYDROGRAD_PEERS", os.path.expanduser("~/.cache/hydrograd/peers"))
        self.jax_python = os.path.join(folder, "bin/python")
        if not os.path.exists(self.jax_python):
            print(f"JAX-SPH is left out, because there is no {self.jax_python}: scripts/peers/run.sh makes it")
            self.jax_python = None
        import channel_fem

        self.sharp = channel_fem
        _, self.wall = channel_fem.read_wall(WALL)
        with open(channel_fem.SHARP) as file:
            name, amplitude = WALL.split(":")
            self.q = next(float(row["Q"]) for row in csv.DictReader(file) if (row["shape"], row["A"]) == (name, amplitude))
        self.start = self.kept.all.setdefault("start of hydrograd", run([self.program, "--version"])[3])

    def some(self, points, quick=2):
        return points[:quick] if self.quick else points

    def hydrograd(self, command, sets, read):
        """A row of a run of hydrograd; `read` makes errors (and more) of its folder and its lines."""
        with tempfile.TemporaryDirectory() as folder:
            words = [self.program, *command, "--threads", "1", "--out", os.path.join(folder, "run")]
            for key, value in {"output.frames": 0, **sets}.items():
                words += ["--set", f"{key}={value}"]
            code, lines, complaint, seconds, wall = run(words)
            row = {"seconds": seconds, "wall": wall, "start": self.start, "compile": None, "errors": {}}
            if code != 0:
                row["note"] = failure(code, complaint)
            try:
                return {**row, **read(os.path.join(folder, "run"), lines)}
            except (OSError, StopIteration, KeyError):
                return {**row, "failed": failure(code, complaint)}

    def by_jax(self, task, errors):
        return measured([self.jax_python, os.path.join(HERE, "jax_sph_point.py"), *map(str, task)], errors, one_core=True)

    def wall_sets(self, offsets):
        return {"design.nodes": json.dumps(self.sharp.NODES.tolist()), "design.offsets": json.dumps(list(offsets))}

    def sharp_gradient(self):
        """Of Q at the wall; the exact one on a fine mesh."""
        truth = self.kept.all["truth"]
        if "gradient" not in truth:
            channel = self.sharp.Channel(0.2, self.sharp.NODES, 1)
            channel.solve(self.wall)
            truth["gradient"] = channel.gradient().tolist()
            self.kept.write()
        return truth["gradient"]

    def gain(self, wall, memory={}):
        """What a wall truly gains over the flat one."""
        truth = self.kept.all["truth"].setdefault("q", {})
        flat = [0.0] * len(wall)
        for one in (flat, wall):
            key = " ".join(f"{o:.5f}" for o in one)
            if key not in truth:
                if not memory:
                    memory["channel"] = self.sharp.Channel(0.2, self.sharp.NODES, 0)
                truth[key] = memory["channel"].solve(one)
        return truth[key] / truth[" ".join(f"{o:.5f}" for o in flat)] - 1

    def a(self):
        """Q of a curved wall."""
        error = lambda found: {"Q": abs(found["q"] / self.q - 1)}
        for method, name in (("fixed", HYDROGRAD[0]), ("consistent", HYDROGRAD[1]), ("standard", HYDROGRAD[2])):
            for rows in self.some((8 if method == "standard" else 6, 10, 20, 30)):
                sets = {"method.name": method, "resolution.dx": 0.2 / rows, **self.wall_sets(self.wall)}
                read = lambda folder, lines: {"errors": error(loaded(folder))}
                self.kept.of("a", name, f"dx 1/{5 * rows}", lambda: self.hydrograd(["simulate"], sets, read))
        for h in self.some((0.04, 0.02, 0.01, 0.005)):
            self.kept.of("a", FE, f"h {h}", lambda: by_fem(["channel", "--h", h], error))
        for finest in self.some((1e-3, 1e-4, 1e-5), 1):
            self.kept.of("a", GRADED, f"finest {finest:.0e}", lambda: by_fem(["channel", "--graded", finest], error))
        for dx in self.some((0.04, 0.025, 0.02), 0) if self.jax_python else ():
            self.kept.of("a", JAX, f"dx {dx}", lambda: self.by_jax(["channel", "--dx", dx, "--wall", self.wall.tolist()], error))

    def b(self):
        """The gradient of Q by the wall's nodes."""
        truth = self.sharp_gradient()

        def errors(gradient):
            size = lambda x: math.sqrt(sum(a * a for a in x))
            cosine = sum(a * b for a, b in zip(gradient, truth)) / size(gradient) / size(truth)
            pairs = lambda g: [g[0] + g[1], *g[2:-2], g[-2] + g[-1]]
            gap = lambda a, b: size([x - y for x, y in zip(a, b)]) / size(b)
            return {"gradient": gap(gradient, truth), "1 - cosine": 1 - cosine, "ends in pairs": gap(pairs(gradient), pairs(truth))}

        def read(folder, lines):
            """Seconds are those until the first line of an epoch, which has Q and the norm of its gradient."""
            seconds, wall = next((seconds, wall) for seconds, wall, line in lines if line.startswith("epoch"))
            return {"seconds": seconds, "wall": wall, "errors": errors([-g for g in tensor(folder, "l-bfgs-b.gradient")[0]])}
        fixed, moving, standard = HYDROGRAD
        usual = (6, 10, 15, 20)
        cases = (("consistent", "fixed", fixed, usual), ("consistent", "scene", moving, usual), ("standard", "scene", standard, (10,)))
        for method, search, name, all_rows in cases:
            for rows in self.some(all_rows):
                sets = {"method.name": method, "optimise.search": search, "optimise.smoothing": 0, "resolution.dx": 0.2 / rows,
                        **self.wall_sets(self.wall)}
                self.kept.of("b", name, f"dx 1/{5 * rows}", lambda: self.hydrograd(["optimize", "--no-verify", "--epochs", "1"], sets, read))
        of = lambda found: errors(found["gradient"])
        for h in self.some((0.04, 0.02, 0.01, 0.005)):
            self.kept.of("b", FE, f"h {h}", lambda: by_fem(["channel", "--h", h, "--gradient"], of))
        if self.jax_python and not self.quick:
            self.kept.of("b", JAX, "dx 0.025", lambda: self.by_jax(["channel", "--dx", 0.025, "--gradient", "--wall", self.wall.tolist()], of))

    def c(self):
        """The whole optimisation."""
        def path(points):
            """Of (seconds, loss, wall): the true gain of the wall with the least loss so far, over time."""
            best, found = math.inf, []
            for seconds, loss, wall in points:
                if loss < best:
                    best = loss
                    found.append([seconds, self.gain(wall)])
            at = lambda share: next((seconds for seconds, gain in found if gain >= share * POSSIBLE), None)
            return {"seconds": points[-1][0], "path": found, "evaluations": len(points),
                    "errors": {"left": 1 - max(gain for _, gain in found) / POSSIBLE, **{f"to {s} %": at(s / 100) for s in (50, 90, 99)}}}

        def read(folder, lines):
            points = [(seconds, wall) for seconds, wall, line in lines if line.startswith("epoch")]
            losses, walls = tensor(folder, "history.loss")[0], tensor(folder, "history.offsets")
            return {"wall": points[-1][1], **path([(seconds, *of) for (seconds, _), *of in zip(points, losses, walls)])}
        for search, name, all_rows in (("fixed", HYDROGRAD[0], (6, 10, 15, 20)), ("scene", HYDROGRAD[1], (6, 10))):
            for rows in self.some(all_rows, 2 if search == "fixed" else 0):
                sets = {"optimise.search": search, "resolution.dx": 0.2 / rows, "design.nodes": json.dumps(self.sharp.NODES.tolist())}
                self.kept.of("c", name, f"dx 1/{5 * rows}", lambda: self.hydrograd(["optimize", "--no-verify"], sets, read))

        def by_elements(h):
            code, lines, complaint, seconds, wall = run([sys.executable, os.path.join(HERE, "user_fem.py"), "optimise", "--h", str(h)])
            row = {"seconds": seconds, "wall": wall, "compile": None, "start": None, "errors": {}}
            points = [json.loads(line) for *_, line in lines if line.startswith("{")]
            if code != 0 and not points:
                return {**row, "failed": failure(code, complaint)}
            points, start = [p for p in points if "q" in p], points[-1].get("start")
            return {**row, **path([(p["seconds"], p["loss"], p["wall"]) for p in points]), "start": start}
        for h in self.some((0.04, 0.02, 0.01), 1):
            self.kept.of("c", FE, f"h {h}", lambda: by_elements(h))

    def d(self):
        """Taylor and Green's vortices."""
        for nu in (0.05, 0.005):
            end, name = math.log(2) / (8 * math.pi ** 2 * nu), f"nu {nu}"
            error = lambda found: {name: 1.0 * found["error"]}

            def read(folder, lines):
                return {"errors": {name: loaded(folder)["velocity_error"]}}

            def read_fixed(folder, lines):
                return {"errors": {name: vortices_error(folder, nu, end)}}
            for derivatives, contestant in (("spectral", HYDROGRAD[0]), ("fits", "fixed particles, fits")):
                for n in self.some((8, 16, 32, 64)):
                    with tempfile.NamedTemporaryFile("w", suffix=".toml") as scene:
                        scene.write(VORTICES)
                        scene.flush()
                        sets = {"fluid.viscosity": nu, "resolution.dx": 1 / n, "time.end": end, "method.derivatives": derivatives}
                        self.kept.of("d", contestant, f"{name}, {n}^2", lambda: self.hydrograd(["simulate", scene.name], sets, read_fixed))
            for method, contestant in (("consistent", HYDROGRAD[1]), ("standard", HYDROGRAD[2])):
                for n in self.some((20, 32, 50, 100)):
                    sets = {"method.name": method, "resolution.dx": 1 / n, "flow.reynolds": 1 / nu, "time.end": end}
                    self.kept.of("d", contestant, f"{name}, {n}^2", lambda: self.hydrograd(["simulate", "taylor-green"], sets, read))
            for n in self.some((8, 16, 32, 64)):
                self.kept.of("d", FE, f"{name}, {n}^2", lambda: by_fem(["taylor-green", "--n", n, "--nu", nu], error))
            for n in self.some((16, 20, 32, 50), 1) if self.jax_python else ():
                self.kept.of("d", JAX, f"{name}, {n}^2", lambda: self.by_jax(["taylor-green", "--n", n, "--nu", nu], error))

    def e(self):
        """A cylinder in a channel."""
        of = lambda drag, lift: {"drag": abs(drag / DRAG - 1), "lift": abs(lift / LIFT - 1)}

        def read(folder, lines):
            force = loaded(folder)["shapes"][0]["force"]
            return {"errors": of(force[0] / 0.002, force[1] / 0.002)}
        scene = os.path.join(ROOT, "data/scenes/schaefer-turek-1.toml")
        for dx in self.some((0.02, 0.01, 0.005, 0.0025)):
            self.kept.of("e", HYDROGRAD[0], f"dx {dx}", lambda: self.hydrograd(["simulate", scene], {"resolution.dx": dx}, read))
        for points, far in self.some(((20, 0.08), (40, 0.05), (80, 0.03), (160, 0.02))):
            error = lambda found: of(found["drag"], found["lift"])
            self.kept.of("e", FE, f"{points} edges", lambda: by_fem(["cylinder", "--points", points, "--far", far], error))


VORTICES = """scene = "custom"
region = { size = [1.0, 1.0], periodic = [true, true], acceleration = [0.0, 0.0] }
fluid = { reference_velocity = 1.0 }
initial.velocity = ["-cos(2*PI*x)*sin(2*PI*y)", "sin(2*PI*x)*cos(2*PI*y)"]
method = { name = "fixed", flow = "unsteady" }
"""


def loaded(folder):
    with open(os.path.join(folder, "summary.json")) as file:
        return json.load(file)


def tensor(folder, name):
    """A tensor of a run's checkpoint: a list of rows."""
    import numpy as np

    with open(os.path.join(folder, "checkpoint.safetensors"), "rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
        data = file.read()
    first, last = header[name]["data_offsets"]
    return np.frombuffer(data[first:last], "<f8").reshape(-1, header[name]["shape"][-1]).tolist()


def vortices_error(folder, nu, end):
    """Root mean square of the particles' velocity errors, over the exact amplitude: what summaries of `taylor-green` call velocity_error."""
    import h5py
    import numpy as np

    with h5py.File(os.path.join(folder, "state.h5")) as file:
        r, u = np.array(file["position"]), np.array(file["velocity"])
    x, y = 2 * np.pi * r.T
    amplitude = math.exp(-8 * math.pi ** 2 * nu * end)
    exact = amplitude * np.stack([-np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)], 1)
    return math.sqrt(np.mean(np.sum((u - exact) ** 2, 1))) / amplitude


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("questions", nargs="*", help="a b c d e; all if none is given")
    parser.add_argument("--quick", action="store_true", help="two points of each contestant, pictures to runs/peers")
    parser.add_argument("--program", default=os.path.join(ROOT, "target/release/hydrograd"), help="hydrograd")
    options = parser.parse_args()
    wanted = options.questions or list("abcde")
    if set(wanted) - set("abcde"):
        parser.error(f"questions are a b c d e, not {' '.join(wanted)}")
    if not os.path.exists(options.program):
        parser.error(f"there is no {options.program}: cargo build --release, or --program FILE")
    from time_error_pictures import draw, full_table

    race = Race(options)
    for question in wanted:
        getattr(race, question)()
        race.kept.write()
        rows = [row for row in race.kept.all["rows"].values() if row["question"] == question]
        folder = OUT if options.quick else os.path.join(ROOT, "data/pictures")
        print("->", os.path.relpath(draw(question, rows, folder), ROOT), flush=True)
    with open(os.path.join(OUT, "time-error.md"), "w") as file:
        file.write(full_table(race.kept.all["rows"].values()) + "\n")
    used = sum(sum(resource.getrusage(of)[:2]) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(f"-> runs/peers/time-error.md; {used:.0f} s of processor time")


if __name__ == "__main__":
    main()
