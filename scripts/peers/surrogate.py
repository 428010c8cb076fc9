#!/usr/bin/env python3
"""Runs hydrograd, PyTorch and LagrangeBench in turns on the same networks and graphs, one table; `run.sh --surrogate` calls it.

Each turn is a new process of each code. Best is the best of all turns, median the median of theirs.
"""
import argparse
import json
import os
import subprocess
import sys

from compare import HERE, grouped, hydrograd, write

NETWORKS = [(10, 128, 3.0), (10, 128, 1.45)]
PEERS = {
    "LagrangeBench": ["surrogate_lagrangebench.py"],
    "PyTorch": ["surrogate_torch.py"],
    "PyTorch, split edge layer": ["surrogate_torch.py", "--split"],
}
CODES = {"LagrangeBench": "lagrangebench", "PyTorch": "pytorch", "PyTorch, split edge layer": "pytorch, split edge layer"}


def peer(options):
    command = [sys.executable, os.path.join(HERE, options[0]), *options[1:]]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return None, f"{' '.join(command)}\n{done.stderr.strip()[-2000:]}"
    return [json.loads(done.stdout.strip().splitlines()[-1])], None


def table(rows):
    lines = ["| network | work | code | ms, best | median | ours is faster by | memory, MB |", "|---|---|---|---|---|---|---|"]
    for ours in (row for row in rows if row["code"] == "hydrograd"):
        same = [row for row in rows if all(row[name] == ours[name] for name in ("scene", "kind"))]
        for row in sorted(same, key=lambda row: -row["ms_per_step"]):
            name = next((name for name, code in CODES.items() if code == row["code"]), "hydrograd")
            ratio = "" if row is ours else f"{row['ms_per_step'] / ours['ms_per_step']:.1f}"
            lines.append(f"| {row['scene']} ({row['pairs']} edges) | {row['kind']} | {name} | {row['ms_per_step']:.0f} "
                         f"| {row['ms_per_step_median']:.0f} | {ratio} | {row['peak_memory_bytes'] / 1e6:.0f} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--hydrograd", default="target/release/hydrograd")
    parser.add_argument("--out", default="runs/peers")
    parser.add_argument("--without", action="append", default=[], choices=PEERS, help="leave this code out")
    a = parser.parse_args()
    os.makedirs(a.out, exist_ok=True)
    rows, failures = [], []
    turns, seconds = (1, 2) if a.quick else (3, 5)
    for turn in range(turns):
        for rounds, latent, radius in NETWORKS:
            name = f"gns-{rounds}-{latent}-{radius:g}dx"
            for kind in ("forward", "training"):
                found = {"hydrograd": hydrograd(a.hydrograd, ["surrogate", "--threads", "0", "--repeats", "1", "--filter",
                                                              f"{name}/950/f32/{len(os.sched_getaffinity(0))}/{kind}"], a.quick)}
                options = ["--rounds", str(rounds), "--latent", str(latent), "--radius", str(radius), "--kind", kind,
                           "--seconds", str(seconds)]
                found.update((name, peer([*script, *options])) for name, script in PEERS.items() if name not in a.without)
                for label, (more, problem) in found.items():
                    if problem:
                        failures.append(problem)
                        print(f"{name} {kind}: {label} failed\n{problem}", file=sys.stderr)
                    else:
                        rows += more
                print(f"{name} {kind}, turn {turn + 1} of {turns}", file=sys.stderr, flush=True)
        write(os.path.join(a.out, "surrogate.json"), json.dumps(grouped(rows), indent=2) + "\n")
    text = table(grouped(rows))
    write(os.path.join(a.out, "surrogate.md"), text + "\n")
    print(text)
    if failures:
        sys.exit(f"surrogate.py: {len(failures)} runs failed, see above")


if __name__ == "__main__":
    main()
