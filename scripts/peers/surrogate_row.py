"""What the peers of `hydrograd bench surrogate` have in common: options, timing, the row that they print."""
import argparse
import json
import os
import resource
import statistics
import time


def arguments(doc, split=False):
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--latent", type=int, default=128)
    parser.add_argument("--radius", type=float, default=3.0, help="connectivity radius in spacings")
    parser.add_argument("--kind", choices=["forward", "training"], default="training")
    parser.add_argument("--seconds", type=float, default=4.0, help="time to measure for")
    if split:
        parser.add_argument("--split", action="store_true")
    return parser.parse_args()


def measure(a, code, step, particles, edges, version):
    """Times single steps after two that warm up, for a.seconds and at least three."""
    step(), step()
    seconds = []
    while len(seconds) < 3 or sum(seconds) < a.seconds:
        clock = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - clock)
    print(json.dumps({
        "code": code, "group": "surrogate", "scene": f"gns-{a.rounds}-{a.latent}-{a.radius:g}dx", "dimension": 2,
        "particles": particles, "pairs": edges, "precision": "f32", "threads": len(os.sched_getaffinity(0)), "kind": a.kind,
        "steps": 1, "ms_per_step": 1e3 * min(seconds), "ms_per_step_median": 1e3 * statistics.median(seconds),
        "peak_memory_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, "repeats": len(seconds),
        "version": version}))
