#!/usr/bin/env python3
"""How threads do on a machine that others use too: makes a load and times one command, with the default threads and with one.

    python3 scripts/busy.py                       4 busy processes (--load N, several may be given), 3 repeats (--repeats N)
    python3 scripts/busy.py --load 4 8 --repeats 5 -- simulate heated-channel --set time.end=1

Prints a table of seconds of the whole command: the least and the median of the repeats, and the ratio of the medians. The rows: without a load;
under each load; bound to one core (`taskset -c 0`), where two threads are asked for. It ends only the processes that it started.
HYDROGRAD names another program than target/release/hydrograd. Needs no packages.
"""
import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

sys.dont_write_bytecode = True
from pages import ROOT, table
from speed import PROGRAM

# Seconds after which a command is ended and counts as not finished.
LIMIT = 600


def seconds(command, folder):
    """Time of the whole command; none if it takes longer than the limit."""
    clock = time.monotonic()
    try:
        done = subprocess.run([*command, "--out", folder], capture_output=True, text=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return None
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{done.stderr}")
    return time.monotonic() - clock


def measured(variants, repeats, load):
    """Times of some commands in turns, so that what else the machine does meets all alike, beside `load` busy processes."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(load)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            turns = [[seconds(command, folder) for command in variants] for _ in range(repeats)]
    finally:
        for process in busy:
            process.kill()
            process.wait()
    return list(zip(*turns))


def shown(times):
    if None in times:
        return f"not in {LIMIT}"
    return f"{min(times):.2f}, {statistics.median(times):.2f}"


def report(loads, repeats, command):
    """The table, with what the machine did before."""
    run = [PROGRAM, *command]
    cases = [(f"{load} busy processes" if load else "no load of ours", load, run, "default") for load in (0, *loads)]
    if shutil.which("taskset"):
        cases.append(("`taskset -c 0`", 0, ["taskset", "-c", "0", *run, "--threads", "2"], "2"))
    before, rows = os.getloadavg()[0], []
    for name, load, many, threads in cases:
        one = ([] if threads == "default" else many[:3]) + [*run, "--threads", "1"]
        times = measured([many, one], repeats, load)
        is_whole = all(None not in some for some in times)
        ratio = f"{statistics.median(times[0]) / statistics.median(times[1]):.2f}" if is_whole else ""
        rows.append([name, threads, *map(shown, times), ratio])
        print(f"{name}: done", file=sys.stderr)
    note = f"`hydrograd {' '.join(command)}` on {os.cpu_count()} cores, load {before:.1f} before; seconds: least, median of {repeats}."
    return "\n".join([note, "", table(["machine", "threads", "seconds", "one thread", "ratio"], rows)])


def main():
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--load", type=int, nargs="+", default=[4], help="busy processes")
    given.add_argument("--repeats", type=int, default=3)
    given.add_argument("command", nargs="*", default=["simulate", "heated-channel"], help="a command of hydrograd, behind --")
    given = given.parse_args()
    os.chdir(ROOT)
    print(report(given.load, given.repeats, given.command))


if __name__ == "__main__":
    main()
