#!/usr/bin/env python3
"""What the Python package costs beside the command line: processor time of a gradient, and of a call that does nothing.

    python3 scripts/python_cost.py [target/release/hydrograd]

Needs the package installed. One thread, and processor time: another process on the machine changes neither much.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time

for pool in ("CANDLE_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[pool] = "1"

import hydrograd  # noqa: E402

EPOCHS = 9
REPEATS = 2
CALLS = 200


def command_line(program, epochs):
    """Processor seconds of an optimisation by the program."""
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [program, "optimize", "--epochs", str(epochs), "--no-verify", "--out", f"{folder}/out"]
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    program = sys.argv[1] if len(sys.argv) > 1 else "target/release/hydrograd"
    first, all_of_them = (min(command_line(program, epochs) for _ in range(REPEATS)) for epochs in (1, EPOCHS))
    print(f"hydrograd optimize, an epoch: {(all_of_them - first) / (EPOCHS - 1):.3f} s")
    scene = hydrograd.Scene()
    designs = scene.optimise(epochs=EPOCHS).designs[1:]
    seconds = []
    for _ in range(REPEATS):
        clock = time.process_time()
        for design in designs:
            scene.value_and_gradient(design)
        seconds.append((time.process_time() - clock) / len(designs))
    print(f"value_and_gradient, the same walls: {min(seconds):.3f} s")
    clock = time.perf_counter()
    for _ in range(CALLS):
        try:
            scene.value_and_gradient(designs[0][1:])
        except ValueError:
            pass
    print(f"a call that is refused by the solver's thread: {1e3 * (time.perf_counter() - clock) / CALLS:.2f} ms")


if __name__ == "__main__":
    main()
