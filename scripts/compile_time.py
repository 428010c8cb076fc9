#!/usr/bin/env python3
"""What compiling costs: `cargo build --release` from nothing, then `cargo test --release --no-run`, in a folder of their own.

    python3 scripts/compile_time.py                    # seconds by the clock and of the processors, the dearest crates, size of the folder
    python3 scripts/compile_time.py --change FILE      # then one line more in FILE, until `cargo quick` could begin its tests

Seconds of processors are comparable between a quiet machine and a busy one; seconds by the clock are not."""

import argparse
import json
import os
import pathlib
import re
import resource
import shutil
import subprocess
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent


def timed(name, command, target):
    """Runs a command, and prints what it took."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.time()
    subprocess.run(command, cwd=ROOT, env={**os.environ, "CARGO_TARGET_DIR": str(target)}, check=True)
    clock, after = time.time() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    size = int(subprocess.run(["du", "-sk", target], capture_output=True, text=True, check=True).stdout.split()[0])
    print(f"{name}: {clock:.0f} s by the clock, {used:.0f} s of processors; the folder has {size / 1e6:.2f} GB", flush=True)


def dearest(target, count):
    """Seconds that each crate took, from cargo's own page."""
    page = (target / "cargo-timings" / "cargo-timing.html").read_text()
    units = json.loads(re.search(r"const UNIT_DATA = (\[.*?\]);\n", page, re.S).group(1))
    units.sort(key=lambda unit: -unit["duration"])
    for unit in units[:count]:
        print(f"  {unit['duration']:6.1f} s  {unit['name']}{unit['target']}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", type=pathlib.Path, help="the folder, which must be empty or not there (default: a temporary one)")
    parser.add_argument("--crates", type=int, default=12, help="how many crates are listed (12)")
    parser.add_argument("--change", type=pathlib.Path, metavar="FILE", help="a source file to change")
    arguments = parser.parse_args()
    target = arguments.target or pathlib.Path(tempfile.mkdtemp(prefix="hydrograd-compile-"))
    if target.exists() and any(target.iterdir()):
        parser.error(f"--target {target}: not empty, so this would not be a build from nothing")
    try:
        timed("cargo build --release", ["cargo", "build", "--release", "-q", "--timings"], target)
        dearest(target, arguments.crates)
        timed("cargo test --release --no-run", ["cargo", "test", "--release", "--no-run", "-q", "--timings"], target)
        dearest(target, arguments.crates)
        if arguments.change:
            quick = ["cargo", "quick", "--no-run", "-q", "--test", "all"]
            timed("cargo quick, the first time", quick, target)
            text = arguments.change.read_text()
            try:
                arguments.change.write_text(text + "\n#[doc(hidden)]\npub fn changed() {}\n")
                timed(f"cargo quick, a line of {arguments.change} changed", quick, target)
            finally:
                arguments.change.write_text(text)
    finally:
        if not arguments.target:
            shutil.rmtree(target)


if __name__ == "__main__":
    main()
