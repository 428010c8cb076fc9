#!/usr/bin/env python3
"""Do the scenes of jax_sph_scenes.py run as JAX-SPH's own cases do?

    python scripts/peers/check.py        (with the virtual environment that run.sh makes; 20 seconds)

Starts them from the states of data/reference/jax-sph-states.h5, which JAX-SPH itself wrote, and compares after 1, 10 and
100 steps; compares the gradient of the heat outflow with data/reference/jax-sph-gradients.h5. Exit code 1 on a difference.
"""
import os
import sys

import jax

jax.config.update("jax_enable_x64", True)

import h5py
import jax.numpy as jnp
import numpy as np

import jax_sph_scenes as scenes

REFERENCE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../data/reference")
FIELDS = ("r", "u", "v", "rho", "p", "T", "dudt", "dvdt", "dTdt")
# Skin 0.2: the list of an earlier step holds the same pairs within the cutoff, so only rounding changes.
CASES = {
    "ht2d_h026": lambda skin: scenes.heated_channel(0.26, 0.02, skin=skin),
    "tgv2d_tvf1": lambda skin: scenes.taylor_green(40, 2, skin=skin),
    "tgv3d_tvf1": lambda skin: scenes.taylor_green(12, 3, reynolds=50.0, skin=skin),
    "pf2d_tvf1": lambda skin: scenes.poiseuille(0.0333333, time_step_of=2e-6, skin=skin),
}


def stored(group, name, like):
    if name in group:
        return jnp.asarray(group[name][:], dtype=like.dtype)
    return jnp.full(like.shape, float(group.attrs[name]), dtype=like.dtype)


def check_states(name, make, skin):
    worst = 0.0
    with h5py.File(os.path.join(REFERENCE, "jax-sph-states.h5")) as file:
        group, scene = file[name], make(skin)
        if not np.array_equal(group["tag"][:], scene.tag):
            sys.exit(f"{name}: tags differ")
        if abs(float(group.attrs["dt"]) / scene.dt - 1) > 1e-12:
            sys.exit(f"{name}: dt {scene.dt} instead of {group.attrs['dt']}")
        state = {**scene.state, **{f: stored(group["0"], f, scene.state[f]) for f in FIELDS}}
        neighbors, done = scene.allocate(state["r"]), 0
        for steps in (1, 10, 100):
            if str(steps) not in group:
                continue
            state, neighbors = scenes.run_for(scene, steps - done)(state, neighbors)
            done = steps
            for f in FIELDS:
                theirs = stored(group[str(steps)], f, state[f])
                gap = state[f] - theirs
                if f == "r":
                    gap -= scene.box * jnp.round(gap / scene.box)
                size = float(jnp.max(jnp.abs(theirs))) or 1.0
                if not bool(jnp.all(jnp.isfinite(state[f]))):
                    sys.exit(f"{name}: {f} is not finite after {steps} steps")
                worst = max(worst, float(jnp.max(jnp.abs(gap))) / size)
    return worst


def check_gradient():
    with h5py.File(os.path.join(REFERENCE, "jax-sph-gradients.h5")) as file:
        group = file["ht2d_dQ_20"]
        scene = scenes.heated_channel(0.26, 0.02)
        scene.state["r"] = jnp.asarray(group["r_base"][:])
        start, count = scenes.walls_moved(scene, np.arange(scene.particles) % 50)
        offsets = jnp.asarray(group["off"][:])
        neighbors = scene.allocate(start(offsets)["r"])
        gradient = scenes.gradient_of(scene, scenes.heat_outflow(scene), start, int(group.attrs["n_steps"]))
        (q, overflow), ours = gradient(offsets, neighbors)
        theirs = group["dQ"][:]
        assert len(ours) == count and not overflow
        return (abs(float(q) / float(group.attrs["Q"]) - 1),
                float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)))


def main():
    bad = False
    for name, make in CASES.items():
        for skin in (0.0, 0.2):
            worst = check_states(name, make, skin)
            bad |= not worst < 1e-8
            print(f"{name}, skin {skin}: states differ by {worst:.1e} of a field's largest value")
    q, gradient = check_gradient()
    bad |= not (q < 1e-6 and gradient < 1e-6)
    print(f"ht2d_dQ_20: Q differs by {q:.1e}, its gradient by {gradient:.1e}")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
