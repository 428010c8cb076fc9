"""Run one solver (a tesseract_api.py) against the Navier-Stokes tasks of Mosaic without docker, in this process.

    MOSAIC=/path/to/checkout python run.py --api path/to/tesseract_api.py --key my_solver \\
        --tasks baseline,tgv,multimode,laws,cylinder,fd,horizon,cost,drag,b3,a3,c3,f3 --out rows.csv

Initial fields, inputs, error norm and gradient checks are the checkout's (pasteurlabs/mosaic, Apache-2.0); this file only drives
them. Rows: task,parameters,solver,figure,value. A failure is a row too. `run.sh` calls it for every solver.
"""
from __future__ import annotations

import argparse
import csv
import os
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument("--mosaic", default=os.environ.get("MOSAIC", ""), help="checkout of the benchmark (or $MOSAIC)")
ap.add_argument("--api", required=True, help="tesseract_api.py of the solver")
ap.add_argument("--key", required=True, help="name; jax_cfd, xlb, exponax get the benchmark's own overrides")
ap.add_argument("--tasks", default="baseline,tgv,multimode,laws,cylinder,fd,horizon,cost")
ap.add_argument("--out", default="", help="CSV to append to")
ap.add_argument("--iters", type=int, default=250, help="drag: Adam iterations (the benchmark's own: 250)")
ap.add_argument("--trials", type=int, default=3, help="cost: timed calls after the warm-up")
ap.add_argument("--cost-n", default="64,128", help="cost: grid sizes")
ap.add_argument("--horizons", default="5,20,80,320")
ap.add_argument("--save", default="", help="npz for the output fields")
ARGS = ap.parse_args()
sys.path[:0] = [ARGS.mosaic, str(Path(ARGS.mosaic) / "mosaic")] if ARGS.mosaic else []

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from tesseract_core import Tesseract  # noqa: E402

from mosaic.benchmarks.core.utils import l2_error_rel  # noqa: E402
from mosaic.benchmarks.problems.navier_stokes_3d_grid import config as c3  # noqa: E402
from mosaic.benchmarks.problems.navier_stokes_grid import config as c2  # noqa: E402
from mosaic.benchmarks.problems.navier_stokes_grid.optimization import _drag_opt_adam_loop  # noqa: E402
from mosaic.benchmarks.problems.shared.diagnostics import divergence_rms, kinetic_energy  # noqa: E402
from mosaic.benchmarks.problems.shared.gradient import _fd_vjp_arrays, _vjp_grad  # noqa: E402

EPS = (5.0, 1.0, 1e-1, 1e-2, 1e-3, 1e-4)
HERE = Path(__file__).resolve().parent
PROBLEMS = Path(c2.__file__).resolve().parents[1]
TWO_PI = 2 * float(jnp.pi)
OBSTACLE = {"shape": "cylinder", "center": [0.5, 0.5]}
FIELDS: dict[str, np.ndarray] = {}


def spec_for(cfg):
    """The benchmark's own spec where it knows the key, else a plain one."""
    plain = SimpleNamespace(key=ARGS.key, name=ARGS.key, input_overrides={})
    return next((s for s in cfg.problem.solvers if s.key == ARGS.key), plain)


def ic2(name, N, cfg=c2, **kw):
    # Some solvers switch jax to 64 bit when imported; the random fields differ then.  Build them in 32 bit.
    with jax.enable_x64(False):
        return np.asarray(cfg.problem.make_ic[name](N=N, L=TWO_PI, **kw))


ic3 = partial(ic2, cfg=c3)


def inputs(cfg, ic, **phys):
    phys.setdefault("domain_extent", TWO_PI)
    return cfg.make_inputs(spec_for(cfg), jnp.asarray(ic), **phys)


def emit(task, params, figure, value):
    value = f"{value:.6g}" if isinstance(value, float) else str(value)
    p = " ".join(f"{k}={v}" for k, v in params.items())
    print(f"{task:<22} {p:<34} {ARGS.key:<10} {figure:<22} {value}", flush=True)
    if ARGS.out:
        with open(ARGS.out, "a", newline="") as f:
            if f.tell() == 0:
                csv.writer(f).writerow(["task", "parameters", "solver", "figure", "value"])
            csv.writer(f).writerow([task, p, ARGS.key, figure, value])


def run_field(t, cfg, ic, **phys):
    out = t.apply(inputs(cfg, ic, **phys))
    return np.asarray(out["result"]), out.get("drag")


def guarded(task, params, fn):
    try:
        fn()
    except Exception as e:  # a failure is a result
        lines = [x.strip() for x in str(e).splitlines() if x.strip() and "errors.pydantic.dev" not in x] or ["-"]
        emit(task, params, "failed", f"{type(e).__name__}: {lines[-1][:160]}")


# ---- forward -------------------------------------------------------------------------------------
def each(task, key, values, body, **fixed):
    for i, v in enumerate(values):
        params = {**fixed, key: v}
        guarded(task, params, lambda i=i, v=v, params=params: body(i, v, lambda f, x: emit(task, params, f, x)))


def analytic(cfg, ic, nu, t):
    return np.asarray(cfg.problem.reference(jnp.asarray(ic), nu=nu, t=t, L=TWO_PI))


def baseline(t, cfg=c2, ic=ic2, name="tgv", task="forward/baseline", sizes=(16, 32, 64, 128)):
    def body(_, N, put):
        extra = {"lbm_N_base": 64} if cfg is c2 else {}
        u, _ = run_field(t, cfg, ic(name, N), nu=0.05, dt=0.01, steps=1, **extra)
        put("error", l2_error_rel(u, analytic(cfg, ic(name, N), 0.05, 0.01)))
    each(task, "N", sizes, body)


def tgv(t):  # the union of forward/agreement/tgv and forward/tgv_nu_sweep; all but nu=0.02 make the published ranking
    errors = {}
    def body(_, nu, put):
        FIELDS[f"tgv_{nu}"] = u = run_field(t, c2, ic2("tgv", 64), nu=nu, dt=0.05, steps=20)[0]
        errors[nu] = l2_error_rel(u, analytic(c2, ic2("tgv", 64), nu, 1.0))
        put("error", errors[nu])
    each("forward/agreement/tgv", "nu", (0.0001, 0.0005, 0.001, 0.005, 0.01, 0.02, 0.05), body, N=64)
    errors.pop(0.02, None)
    emit("forward/tgv_nu_sweep", {"N": 64}, "ranking_mean_error", float(np.mean(list(errors.values()) or [np.nan])))


def multimode(t):
    data = np.load(HERE.parents[1] / "data/reference/mosaic_multimode.npz")
    def body(i, nu, put):
        ic = ic2("multimode", 64, seed=42)
        FIELDS[f"multimode_{nu}"] = u = run_field(t, c2, ic, nu=nu, dt=0.05, steps=20)[0]
        put("error", l2_error_rel(u, data[f"reference_{i}"]))
        put("error_as_published", l2_error_rel(u, analytic(c2, ic, nu, 1.0)))
    each("forward/agreement/multimode", "nu", (0.001, 0.005, 0.01, 0.02, 0.05), body, N=64)


def laws(t):
    def body(_, N, put):
        u, _ = run_field(t, c2, ic2("tgv", N), nu=0.05, dt=0.01, steps=20)
        put("divergence_rms", divergence_rms(u, domain_extent=TWO_PI))
        put("kinetic_energy", kinetic_energy(u))
        put("error", l2_error_rel(u, analytic(c2, ic2("tgv", N), 0.05, 0.2)))
    each("forward/physical_laws", "N", (16, 32, 64, 128), body)


def cylinder(t):
    data = np.load(PROBLEMS / "ns_grid/references/forward_cylinder.npz")
    def body(i, nu, put):
        u, drag = run_field(t, c2, ic2("uniform", 64), nu=nu, dt=0.01, steps=500, obstacle={**OBSTACLE, "radius": 0.1})
        FIELDS[f"cylinder_{nu}"] = u
        put("error", l2_error_rel(u, data[f"reference_{i}"]))
        put("drag", float("nan") if drag is None else float(np.ravel(drag)[0]))
    each("forward/cylinder", "nu", (0.05, 0.02, 0.01, 0.005), body, N=64)


# ---- gradient ------------------------------------------------------------------------------------
def gradient(t, cfg, ic, phys, eps, n_dirs, seed, task, params):
    def one():
        ctx = SimpleNamespace(
            name=ARGS.key, ic=jnp.asarray(ic), phys={**phys, "domain_extent": TWO_PI}, output_key="result",
            ic_key="v0", seed=seed, make_inputs=lambda _n, i, **p: cfg.make_inputs(spec_for(cfg), i, **p))
        start = time.perf_counter()
        _, _, g, vjp, fd = _fd_vjp_arrays(t, ctx, list(eps), n_dirs)
        emit(task, params, "grad_norm", float(jnp.linalg.norm(g)))
        rel = [np.abs(fd[e] - vjp) / np.maximum(np.maximum(np.abs(fd[e]), np.abs(vjp)), 1e-30) for e in eps]
        cos = [float(fd[e] @ vjp / (np.linalg.norm(fd[e]) * np.linalg.norm(vjp) + 1e-30)) for e in eps]
        med, mean = [float(np.median(r)) for r in rel], [float(np.mean(r)) for r in rel]
        for k, v in (("best_cosine", max(cos)), ("best_median_rel_err", min(med)), ("best_mean_rel_err", min(mean)),
                     ("best_eps", str(eps[int(np.argmin(med))])), ("seconds", time.perf_counter() - start),
                     ("median_rel_err_by_eps", " ".join(f"{m:.1e}" for m in med))):
            emit(task, params, k, v)
    guarded(task, params, one)


def fd(t):
    gradient(t, c2, ic2("multimode", 16, seed=42), dict(nu=0.001, dt=0.05, steps=20), EPS, 20, 42,
             "gradient/fd_check", {"N": 16, "steps": 20})


def horizon(t):
    for steps in map(int, ARGS.horizons.split(",")):
        gradient(t, c2, ic2("multimode", 16, seed=42), dict(nu=0.001, dt=0.05, steps=steps),
                 (1.0, 1e-1, 1e-2, 1e-3), 8, 42, "gradient/horizon_sweep", {"N": 16, "steps": steps})


def timed(task, params, label, fn):
    def one():
        wall, cpu = [], []
        for _ in range(1 + ARGS.trials):  # the first call compiles
            w, c = time.perf_counter(), time.process_time()
            jax.block_until_ready(fn())
            wall.append(time.perf_counter() - w)
            cpu.append(time.process_time() - c)
        for k, v in (("first_s", wall[0]), ("mean_s", float(np.mean(wall[1:]))), ("min_s", min(wall[1:])),
                     ("first_cpu_s", cpu[0]), ("min_cpu_s", min(cpu[1:]))):
            emit(task, params, f"{label}_{k}", v)
    guarded(task, params, one)


def cost(t, cfg=c2, ic=ic2, name="multimode", steps=100, extra=None, task="cost", sizes=ARGS.cost_n):
    for N in map(int, sizes.split(",")):
        inp = inputs(cfg, ic(name, N, seed=0), nu=0.01, dt=0.01, steps=steps, **(extra or {}))
        p = {"N": N, "steps": steps}
        timed(task, p, "forward", lambda inp=inp: t.apply(inp)["result"])
        timed(task, p, "vjp", lambda inp=inp: _vjp_grad(t, inp, "result", "v0"))


def drag(t):
    phys = dict(N=32, nu=0.0025, dt=0.02, steps=200, domain_extent=1.0, U_mean=0.5,
                obstacle={**OBSTACLE, "radius": 0.05})
    p = {"N": 32, "steps": 200, "iters": ARGS.iters}
    def one():
        spec = spec_for(c2)
        start = time.perf_counter()
        prof, _, e = _drag_opt_adam_loop(
            ARGS.key, t, jnp.full((32,), 0.5, jnp.float32), phys, lr=5e-4, max_iters=ARGS.iters, patience=50,
            flow_penalty_weight=50.0, U_mean=0.5, by_solver={}, write_partial=lambda: None,
            make_inputs=lambda _n, i, **k: c2.make_inputs(spec, i, **k), domain_extent=TWO_PI)
        FIELDS.update(drag_profile=np.asarray(prof), drag_history=np.asarray(e["drags"]))
        e.update(mean_final_profile=float(jnp.mean(prof)), seconds=time.perf_counter() - start)
        for k in ("initial_drag", "final_drag", "drag_reduction_pct", "n_iters", "mean_final_profile", "seconds"):
            emit("optimization/drag_opt", p, k, e[k])
    guarded("optimization/drag_opt", p, one)


def a3(t):
    data = np.load(PROBLEMS / "navier_stokes_3d_grid/references/forward_agreement.npz")
    def body(i, nu, put):
        u, _ = run_field(t, c3, ic3("tgv3d", 16), nu=nu, dt=0.01, steps=50, lbm_N_base=16)
        put("error", l2_error_rel(u, data[f"reference_{i}"]))
    each("3d/forward/agreement", "nu", (0.001, 0.01, 0.05), body, N=16)


def f3(t):
    gradient(t, c3, ic3("tgv3d", 16), dict(nu=0.001, dt=0.05, steps=10), EPS, 10, 0,
             "3d/gradient/fd_check", {"N": 16, "steps": 10})


b3 = partial(baseline, cfg=c3, ic=ic3, name="tgv3d", task="3d/forward/baseline", sizes=(8, 16, 32))
cost3 = partial(cost, cfg=c3, ic=ic3, name="tgv3d", steps=50, extra={"lbm_N_base": 16}, task="3d/cost", sizes="16,32")
TASKS = dict(baseline=baseline, tgv=tgv, multimode=multimode, laws=laws, cylinder=cylinder, fd=fd, horizon=horizon,
             cost=cost, drag=drag, b3=b3, a3=a3, c3=cost3, f3=f3)

if __name__ == "__main__":
    solver = Tesseract.from_tesseract_api(ARGS.api)
    for task_name in ARGS.tasks.split(","):
        TASKS[task_name](solver)
    if ARGS.save and FIELDS:
        np.savez_compressed(ARGS.save, **FIELDS)
