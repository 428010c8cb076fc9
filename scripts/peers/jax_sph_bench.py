#!/usr/bin/env python3
"""One case of JAX-SPH, timed in this process; prints one row of peers.json.

    python scripts/peers/jax_sph_bench.py --scene heated-channel-report --kind gradient --precision f64 --steps 2000

JAX-SPH in its best form: compiled as a whole, all steps in one `lax.scan`, the neighbour list updated inside it. Compiling is
not timed. compare.py runs this beside `hydrograd bench`.
"""
import argparse
import json
import os
import resource
import statistics
import sys
import time


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", required=True, choices=["heated-channel-report", "taylor-green"])
    parser.add_argument("--dimension", type=int, choices=[2, 3], default=2)
    parser.add_argument("--per-side", type=int, default=50, help="Taylor-Green: particles along a side")
    parser.add_argument("--kind", choices=["forward", "gradient"], default="forward")
    parser.add_argument("--precision", choices=["f64", "f32"], default="f64")
    parser.add_argument("--steps", type=int, default=200, help="steps of one timed run")
    parser.add_argument("--warm-up", type=int, default=0, help="steps before the timed ones")
    parser.add_argument("--segment", type=int, help="gradient: keep states only every so many steps")
    parser.add_argument("--blocks", type=int, default=3, help="timed runs")
    chosen = parser.parse_args()
    for name in ("steps", "blocks", "per_side"):
        if getattr(chosen, name) < 1:
            parser.error(f"--{name.replace('_', '-')} {getattr(chosen, name)} is below 1")
    return chosen


def memory():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main():
    a = arguments()
    import jax

    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", a.precision == "f64")
    import jax.numpy as jnp
    import numpy as np

    import jax_sph_scenes as scenes

    imported = memory()
    dtype = {"f64": np.float64, "f32": np.float32}[a.precision]

    def make(skin):
        if a.scene == "taylor-green":
            return scenes.taylor_green(a.per_side, a.dimension, jitter=0.1, dtype=dtype, skin=skin)
        return scenes.heated_channel(0.26, 0.02, dtype=dtype, skin=skin)

    scene, skin = scenes.with_faster_list(make, steps=20 if make(0.0).particles < 50_000 else 3)
    run = scenes.Run(scene)
    if a.warm_up:
        run.advance(a.warm_up)
    pairs = scene.pairs(run.state)
    extra = {}
    group = "scaling" if a.scene == "taylor-green" else {"forward": "step", "gradient": "gradient"}[a.kind]
    if a.kind == "forward":
        begin = run.state, run.neighbors
        run.advance(min(a.steps, 20))
        seconds = []
        for _ in range(a.blocks):
            if a.scene == "heated-channel-report":  # The whole run from its start, as ours.
                run.state, run.neighbors = begin
            run.prepare(a.steps)
            seconds.append(run.advance(a.steps))
        if not run.finite():
            sys.exit(f"{a.scene}: not finite after {a.steps} steps")
    else:
        if a.scene == "heated-channel-report":
            scene.state = run.state
            start, count = scenes.walls_moved(scene, np.arange(scene.particles) % round(1 / scene.dx))
            value, variables = scenes.heat_outflow(scene), jnp.zeros(count, dtype=dtype)
        else:
            start = lambda variables: {**run.state, **variables}
            value, variables = scenes.kinetic_energy, {name: run.state[name] for name in ("r", "u")}
        neighbors = scene.allocate(start(variables)["r"])
        gradient = scenes.gradient_of(scene, value, start, a.steps, a.segment)
        gradient = gradient.lower(variables, neighbors).compile()
        seconds = []
        for _ in range(a.blocks):
            clock = time.perf_counter()
            (_, overflow), found = jax.block_until_ready(gradient(variables, neighbors))
            seconds.append(time.perf_counter() - clock)
            if overflow:
                sys.exit(f"{a.scene}: a neighbour list overflowed during the gradient's {a.steps} steps")
        leaves = [np.asarray(leaf, dtype=np.float64) for leaf in jax.tree_util.tree_leaves(found)]
        extra = {"mode": "checkpoint each step" + (f", segments of {a.segment}" if a.segment else ""),
                 "gradient_norm": float(np.sqrt(sum(np.sum(leaf * leaf) for leaf in leaves)))}
    per_step = sorted(1e3 * s / a.steps for s in seconds)
    ms = per_step[0]
    print(json.dumps({
        "code": "jax-sph", "group": group,
        "scene": a.scene, "dimension": scene.dimension, "particles": scene.particles, "pairs": pairs,
        "precision": a.precision, "threads": len(os.sched_getaffinity(0)), "kind": a.kind, "steps": a.steps,
        "ms_per_step": ms, "ms_per_step_median": statistics.median(per_step),
        "ns_per_particle_step": 1e6 * ms / scene.particles, "ns_per_pair": 1e6 * ms / pairs,
        "peak_memory_bytes": memory(), "memory_after_imports_bytes": imported, "repeats": len(per_step),
        "time_step": scene.dt, "neighbour_skin": skin, "version": f"jax-sph 0.1.0, jax {jax.__version__}", **extra,
    }))


if __name__ == "__main__":
    main()
