#!/usr/bin/env python3
"""Runs hydrograd and JAX-SPH in turns on the same scenes and merges both into one table; run.sh calls it.

Each turn is a new process of each code. Best is the best of all turns, median the median of theirs.
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))


def case(scene, kind, precision, steps, turns, warm_up=0, dimension=2, per_side=None, segment=None, blocks=3):
    """One comparison: JAX-SPH's options, and those of `hydrograd bench` that measure the same."""
    theirs = ["--scene", scene, "--kind", kind, "--precision", precision, "--steps", str(steps), "--warm-up", str(warm_up),
              "--dimension", str(dimension), "--blocks", str(blocks)]
    ours = ["--precision", precision, "--threads", "0", "--repeats", "1"]
    if segment:
        theirs += ["--segment", str(segment)]
    if scene == "taylor-green":
        theirs += ["--per-side", str(per_side)]
        ours = ["scaling", "--sizes", f"{per_side}^{dimension}", "--filter", f"/{kind}", *ours]
    else:
        group = "step" if kind == "forward" else "gradient"
        ours = [group, "--preset", "report-jax-sph", "--set", f"time.steps={steps}", "--filter", f"{group}/", *ours]
    name = f"{scene} {f'{per_side}^{dimension} ' if per_side else ''}{precision} {kind}"
    return {"name": name, "ours": ours, "theirs": theirs, "turns": turns}


def cases(quick):
    turns = 1 if quick else 3
    steps = 400 if quick else 2000
    yield case("heated-channel-report", "forward", "f64", steps, turns)
    yield case("heated-channel-report", "forward", "f32", steps, turns)
    steps = 100 if quick else 2000
    few = dict(turns=1 if quick else 2, blocks=1)
    yield case("heated-channel-report", "gradient", "f64", steps, **few)
    if not quick:
        yield case("heated-channel-report", "gradient", "f64", steps, turns=1, segment=40, blocks=1)
        yield case("heated-channel-report", "gradient", "f32", steps, turns=1, blocks=1)
    warm_up = 10 if quick else 200  # as ours
    yield case("taylor-green", "forward", "f64", 100, turns, warm_up, per_side=50)
    yield case("taylor-green", "gradient", "f64", 100, turns, warm_up, per_side=50)
    if quick:
        return
    yield case("taylor-green", "forward", "f32", 100, turns, 200, per_side=50)
    for precision in ("f64", "f32"):
        yield case("taylor-green", "forward", precision, 100, turns, 200, per_side=96)
        yield case("taylor-green", "forward", precision, 40, turns, 20, per_side=185)
        yield case("taylor-green", "forward", precision, 20, turns, 20, dimension=3, per_side=20)
    yield case("taylor-green", "forward", "f64", 4, 1, 2, dimension=3, per_side=40, blocks=2)


def jax_sph(options):
    command = [sys.executable, os.path.join(HERE, "jax_sph_bench.py"), *options]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return None, f"{' '.join(command)}\n{done.stderr.strip()[-2000:]}"
    return [json.loads(done.stdout.strip().splitlines()[-1])], None


def hydrograd(program, options, quick):
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "bench", *options, "--out", folder] + (["--quick"] if quick else [])
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            return None, f"{' '.join(command)}\n{done.stderr.strip()[-2000:]}"
        with open(os.path.join(folder, "bench.json")) as file:
            rows = json.load(file)
    for row in rows:
        row["code"] = "hydrograd"
        row.setdefault("ms_per_step_median", row["ms_per_step"])
    return rows, None


def key(row):
    # JAX-SPH's rows say the dimension only in its column.
    names = ("dimension", "particles", "precision", "kind")
    return (row["scene"].removesuffix("-3d"), *(row[name] for name in names))


def merged(turns):
    """Rows of the same case and mode over the turns, as one."""
    first = min(turns, key=lambda row: row["ms_per_step"])
    return {**first, "ms_per_step_median": statistics.median(row["ms_per_step_median"] for row in turns),
            "peak_memory_bytes": max(row["peak_memory_bytes"] for row in turns),
            "repeats": sum(row.get("repeats") or 1 for row in turns)}


def grouped(rows):
    found = {}
    for row in rows:
        found.setdefault((row["code"], key(row), row.get("mode")), []).append(row)
    return [merged(turns) for turns in found.values()]


def comparable(row):
    # A truncated gradient is not the gradient of the whole run, and JAX-SPH's stores are as precise as its run.
    mode = row.get("mode") or ""
    return not mode.startswith("truncated") and not (row["precision"] == "f64" and "f32" in mode)


def table(rows):
    lines = ["| scene | particles | type | work | steps | JAX-SPH, ms per step | hydrograd | ratio | ratio of medians "
             "| pairs ratio | memory, MB | hydrograd |",
             "|---|---|---|---|---|---|---|---|---|---|---|---|"]
    for theirs in (row for row in rows if row["code"] == "jax-sph"):
        candidates = [row for row in rows if row["code"] == "hydrograd" and key(row) == key(theirs) and comparable(row)]
        if not candidates:
            print(f"compare.py: hydrograd has no row for {key(theirs)}", file=sys.stderr)
            continue
        ours = min(candidates, key=lambda row: row["ms_per_step"])
        name = theirs["scene"] + (" 3D" if theirs["dimension"] == 3 else "")
        work = theirs["kind"] if theirs["kind"] == "forward" else f"gradient ({theirs['mode']}; {ours['mode']})"
        lines.append(
            f"| {name} | {theirs['particles']} | {theirs['precision']} | {work} | {theirs['steps']}; {ours['steps']} "
            f"| {theirs['ms_per_step']:.3f} | {ours['ms_per_step']:.4f} "
            f"| {theirs['ms_per_step'] / ours['ms_per_step']:.1f} "
            f"| {theirs['ms_per_step_median'] / ours['ms_per_step_median']:.1f} "
            f"| {theirs['pairs'] / ours['pairs']:.3f} "
            f"| {theirs['peak_memory_bytes'] / 1e6:.0f} | {ours['peak_memory_bytes'] / 1e6:.0f} |")
    return "\n".join(lines)


def write(path, text):
    with open(path + ".part", "w") as file:
        file.write(text)
    os.replace(path + ".part", path)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--hydrograd", default="target/release/hydrograd")
    parser.add_argument("--out", default="runs/peers")
    parser.add_argument("--filter", default="", help="only cases whose name (scene size precision kind) contains this")
    a = parser.parse_args()
    os.makedirs(a.out, exist_ok=True)
    chosen = [c for c in cases(a.quick) if a.filter in c["name"]]
    if not chosen:
        parser.error(f"--filter {a.filter}: no such case; there are: {', '.join(c['name'] for c in cases(a.quick))}")
    rows, failures = [], []
    for c in chosen:
        for turn in range(c["turns"]):
            for label, (found, problem) in (("hydrograd", hydrograd(a.hydrograd, c["ours"], a.quick)),
                                            ("jax-sph", jax_sph(c["theirs"]))):
                if problem:
                    failures.append(problem)
                    print(f"{c['name']}: {label} failed\n{problem}", file=sys.stderr)
                else:
                    rows += found
            print(f"{c['name']}, turn {turn + 1} of {c['turns']}", file=sys.stderr, flush=True)
        write(os.path.join(a.out, "peers.json"), json.dumps(grouped(rows), indent=2) + "\n")
    text = table(grouped(rows))
    write(os.path.join(a.out, "table.md"), text + "\n")
    print(text)
    if failures:
        sys.exit(f"compare.py: {len(failures)} runs failed, see above")


if __name__ == "__main__":
    main()
