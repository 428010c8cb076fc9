#!/usr/bin/env python3
"""JAX-SPH's points of time_error.py: one run in one process, printed as JSON. Runs in the environment that run.sh makes.

    python scripts/peers/jax_sph_point.py channel --dx 0.02 [--gradient] --wall '[0.0, ...]'      Q over a wall, and its gradient by the nodes
    python scripts/peers/jax_sph_point.py taylor-green --n 32 --nu 0.05       velocity error at half of the vortices' life

In double precision and with a neighbour list of 0.2 spacings more than the cutoff, which steps faster than a new list each step. The wall moves
the columns of particles whose places it covers (jax_sph_scenes.walls_moved). `start` is the processor time until all packages are imported,
`compile` what compiling takes.
"""
import argparse
import json
import math
import sys
import time

sys.dont_write_bytecode = True
import jax

jax.config.update("jax_platforms", "cpu")
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np

import jax_sph_scenes as scenes
from jax_sph_accuracy import even_steps, outflow

# The displacement at the start is that of hydrograd's scene; without it the error is twice as large.
SKIN, JITTER, CHUNK = 0.2, 0.1, 200
compiling = 0.0


class Run(scenes.Run):
    def prepare(self, steps):
        global compiling
        clock = time.process_time()
        found = super().prepare(steps)
        compiling += time.process_time() - clock
        return found


def advance(run, steps):
    """Whole chunks and a rest: two compilations."""
    for _ in range(steps // CHUNK):
        run.advance(CHUNK)
    if steps % CHUNK:
        run.advance(steps % CHUNK)


def channel(options):
    """Q as the mean of 20 samples of the last 0.5; with a gradient, the gradient of what flows out after the last step (the report's objective)."""
    global compiling
    end, nodes = 2.5, 0.26 + 0.02 * np.arange(25)
    steps, dt = even_steps(end, scenes.heated_channel(0.2, options.dx, developed=True).dt)
    scene = scenes.heated_channel(0.2, options.dx, developed=True, time_step_of=dt, skin=SKIN)
    lattice = scenes.heated_channel(0.2, options.dx, jitter=0.0)
    columns = np.floor(np.asarray(lattice.state["r"][:, 0]) / options.dx + 1e-6).astype(int)
    start, count = scenes.walls_moved(scene, columns)
    hot = np.unique(columns[scene.tag == scenes.Tag.DIRICHLET_WALL])
    places = (hot + 0.5) * options.dx
    assert len(hot) == count
    # Heights of the columns by those of the nodes: linear between them.
    kinks = np.r_[0.24, nodes, 0.76]
    by_nodes = np.array([np.interp(places, kinks, np.r_[0, row, 0]) for row in np.eye(len(nodes))]).T
    wall = np.array(json.loads(options.wall))
    found = {"particles": scene.particles, "steps": steps}
    if options.gradient:
        begin = lambda offsets: start(jnp.asarray(by_nodes) @ offsets)
        value = scenes.heat_outflow(scene)
        state = begin(jnp.asarray(wall))
        neighbors = scene.allocate(state["r"], extra=20)
        clock = time.process_time()
        compiled = scenes.gradient_of(scene, value, begin, steps).lower(jnp.asarray(wall), neighbors).compile()
        compiling += time.process_time() - clock
        (q, overflow), gradient = compiled(jnp.asarray(wall), neighbors)
        if bool(overflow):
            raise RuntimeError("the neighbour list is too short")
        # The sum over a column of targets times their distance is the integral.
        return {**found, "q": float(q) * options.dx, "gradient": (np.asarray(gradient) * options.dx).tolist()}
    scene.state = start(jnp.asarray(by_nodes @ wall))
    run = Run(scene)
    every = max(1, round(0.5 / dt) // 20)
    advance(run, steps - 20 * every)
    q = []
    for _ in range(20):
        run.advance(every)
        q.append(outflow(scene, run.state))
    return {**found, "q": float(np.mean(q)) if run.finite() else None}


def taylor_green(options):
    reynolds = 1 / options.nu
    end = math.log(2) * reynolds / (8 * math.pi ** 2)
    steps, dt = even_steps(end, scenes.taylor_green(options.n, 2, reynolds=reynolds).dt)
    scene = scenes.taylor_green(options.n, 2, reynolds=reynolds, jitter=JITTER, time_step_of=dt, skin=SKIN)
    run = Run(scene)
    advance(run, steps)
    r, u = (np.asarray(run.state[name]) for name in ("r", "u"))
    error = math.sqrt(np.mean(np.sum((u - scenes.taylor_green_velocity(r, end, reynolds)) ** 2, axis=1))) / 0.5
    return {"particles": scene.particles, "steps": steps, "error": error if run.finite() else None}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("channel", "taylor-green"))
    parser.add_argument("--dx", type=float, default=0.02)
    parser.add_argument("--gradient", action="store_true")
    parser.add_argument("--wall", default=json.dumps([0.0] * 25))
    parser.add_argument("--n", type=int, default=32)
    parser.add_argument("--nu", type=float, default=0.05)
    options = parser.parse_args()
    start = time.process_time()
    found = channel(options) if options.what == "channel" else taylor_green(options)
    print(json.dumps({**found, "start": start, "compile": compiling, "seconds": time.process_time()}))


if __name__ == "__main__":
    main()
