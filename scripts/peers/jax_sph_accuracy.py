#!/usr/bin/env python3
"""JAX-SPH's points of the picture of run time against error; run.sh calls it. Writes an array of
{code, scene, dx, cfl, precision, particles, steps, time_step, threads, seconds, error, stable}.

The same flows, starts, end times and errors as `hydrograd bench accuracy` (src/scene/accuracy.rs), at JAX-SPH's time step:
Taylor-Green at the half life of its vortices and Poiseuille at a fifth of its viscous time (root mean square of the particles'
velocity errors over the exact amplitude), heated channel at t = 2.5 from the developed flow (|Q / Q_FEM - 1|, Q the flux
through x = 0.9 over the last 0.5 in 40 samples). Compiling is not timed, nor is taking the samples.
"""
import argparse
import json
import math
import os
import subprocess
import sys

FEM_Q = 0.0234715  # data/reference/README.md
REYNOLDS, POISEUILLE_REYNOLDS = 100.0, 0.0125
CHUNK = 200


def even_steps(end, limit):
    steps = max(1, math.ceil(end / limit - 1e-9))
    return steps, end / steps


def advance(run, steps):
    """Whole chunks and a rest: two compilations."""
    seconds = sum(run.advance(CHUNK) for _ in range(steps // CHUNK))
    return seconds + (run.advance(steps % CHUNK) if steps % CHUNK else 0.0)


def poiseuille_velocity(y, time):
    """From rest under a constant force, steady centre line 1 (Morris, Fox and Zhu 1997, eq. 19), height 1."""
    import numpy as np

    u = 4 * y * (1 - y)
    for k in range(1, 200, 2):
        k = math.pi * k
        u = u - 32 / k**3 * np.sin(k * y) * math.exp(-k * k * time / POISEUILLE_REYNOLDS)
    return np.stack([u, 0 * u], axis=1)


def outflow(scene, state):
    """Heat flux through x = 0.9: sum over targets of dx sum_j W m_j u_j (T_j - T_in), fluid only, targets beyond the walls too."""
    import numpy as np

    import jax_sph_scenes as scenes

    r, u, t, m = (np.asarray(state[name], dtype=np.float64) for name in ("r", "u", "T", "mass"))
    fluid = scene.tag == 0
    r, carried = r[fluid], (m * u[:, 0] * (t - scenes.T_INLET))[fluid]
    rows = round(scene.extra["height"] / scene.dx) + 2 * scenes.WALL_ROWS
    targets = np.stack([np.full(rows, 0.9), (np.arange(rows) + 0.5) * scene.dx], axis=1)
    distance = np.linalg.norm(targets[:, None] - r[None], axis=2)
    kernel = scenes.QuinticKernel(h=scene.dx, dim=2)
    return float(scene.dx * np.sum(np.asarray(kernel.w(distance)) @ carried))


def one(scene_name, size, precision):
    import jax

    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", precision == "f64")
    import numpy as np

    import jax_sph_scenes as scenes

    options = {"dtype": {"f64": np.float64, "f32": np.float32}[precision]}
    if scene_name == "taylor-green":
        end, make = math.log(2) * REYNOLDS / (8 * math.pi**2), lambda **o: scenes.taylor_green(size, 2, **o)
    elif scene_name == "poiseuille":
        # In heights and steady centre-line velocities, 12 columns long, as ours.
        end = 0.2 * POISEUILLE_REYNOLDS
        make = lambda **o: scenes.poiseuille(1 / size, 1.0, 12 / size, 1 / POISEUILLE_REYNOLDS, 8 / POISEUILLE_REYNOLDS, 1.0, **o)
    else:
        end, make = 2.5, lambda **o: scenes.heated_channel(0.2, size, developed=True, **o)
    steps, dt = even_steps(end, make(**options).dt)
    scene, skin = scenes.with_faster_list(lambda skin: make(time_step_of=dt, skin=skin, **options))
    run = scenes.Run(scene)
    if scene_name == "heated-channel":
        window, count = round(0.5 / dt), 40
        samples = sorted({steps - k * window // count for k in range(count)})
        seconds, done, q = 0.0, 0, []
        for sample in samples:
            seconds += advance(run, sample - done)
            done = sample
            q.append(outflow(scene, run.state))
        error = abs(np.mean(q) / FEM_Q - 1)
    else:
        seconds = advance(run, steps)
        fluid = scene.tag == 0
        r, u = (np.asarray(run.state[name], dtype=np.float64)[fluid] for name in ("r", "u"))
        if scene_name == "taylor-green":
            exact, amplitude = scenes.taylor_green_velocity(r, end, REYNOLDS), math.exp(-8 * math.pi**2 * end / REYNOLDS)
        else:
            exact, amplitude = poiseuille_velocity(r[:, 1] - scenes.WALL_ROWS * scene.dx, end), 1.0
        error = math.sqrt(np.mean(np.sum((u - exact) ** 2, axis=1))) / amplitude
    finite = run.finite() and bool(np.isfinite(error))
    speed = 11.0  # sound speed 10, reference velocity 1
    return {"code": "jax-sph", "scene": scene_name, "dx": scene.dx, "cfl": dt * speed / scene.dx, "precision": precision,
            "particles": scene.particles, "steps": steps, "time_step": dt, "seconds": seconds,
            "error": float(error) if finite else None, "stable": finite and bool(error < 1),
            "threads": len(os.sched_getaffinity(0)), "neighbour_skin": skin}


def cases(quick):
    for precision in ("f64", "f32"):
        for side in (20, 32) if quick else (20, 32, 50, 64, 100):
            yield "taylor-green", side, precision
        for rows in (10, 20) if quick else (10, 20, 30, 40, 60):
            yield "poiseuille", rows, precision
        for dx in (0.02,) if quick else (0.02, 0.01):
            yield "heated-channel", dx, precision


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", default="runs/peers/accuracy.json")
    parser.add_argument("--one", nargs=3, metavar=("SCENE", "SIZE", "PRECISION"), help="one point, printed")
    a = parser.parse_args()
    if a.one:
        scene, size, precision = a.one
        print(json.dumps(one(scene, float(size) if scene == "heated-channel" else int(size), precision)))
        return
    os.makedirs(os.path.dirname(os.path.abspath(a.out)), exist_ok=True)
    points, failed = [], 0
    print("| scene | dx | type | steps | seconds | error |\n|---|---|---|---|---|---|")
    for case in cases(a.quick):
        command = [sys.executable, os.path.abspath(__file__), "--one", *map(str, case)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            failed += 1
            print(f"{' '.join(command)}\n{done.stderr.strip()[-2000:]}", file=sys.stderr)
            continue
        p = json.loads(done.stdout.strip().splitlines()[-1])
        points.append(p)
        error = f"{p['error']:.3e}" if p["stable"] else "not stable"
        print(f"| {p['scene']} | {p['dx']:.4g} | {p['precision']} | {p['steps']} | {p['seconds']:.2f} | {error} |", flush=True)
        with open(a.out + ".part", "w") as file:
            file.write(json.dumps(points, indent=2) + "\n")
        os.replace(a.out + ".part", a.out)
    if failed:
        sys.exit(f"jax_sph_accuracy.py: {failed} points failed, see above")


if __name__ == "__main__":
    main()
