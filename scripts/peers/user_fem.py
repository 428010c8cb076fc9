#!/usr/bin/env python3
"""Finite elements as a user would pick them: one task of time_error.py in one process, printed as JSON.

    python scripts/peers/user_fem.py channel --h 0.02 [--gradient]      Q over a curved wall, and its exact gradient by the wall's nodes
    python scripts/peers/user_fem.py optimise --h 0.02                  the best wall by L-BFGS-B; a line for each evaluation
    python scripts/peers/user_fem.py taylor-green --n 16 --nu 0.05      vortices at half of their life
    python scripts/peers/user_fem.py cylinder --points 40 --far 0.05    drag and lift of data/scenes/schaefer-turek-1.toml

scikit-fem, Taylor-Hood elements (degree 2 for velocity and temperature, 1 for pressure), Newton's method, and a direct solver: MKL's Pardiso
where pypardiso is installed, else SciPy's SuperLU. The channel has a structured mesh of quadrilaterals with lines where its boundary conditions
change and where its wall has kinks, but is not refined there (channel_fem.py is). The cylinder has triangles of gmsh with curved edges. `start`
in what is printed is the processor time until all packages are imported.
"""
import argparse
import json
import os
import sys
import time
import tomllib

os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy as np
import scipy.sparse as sparse
from skfem import Basis, BilinearForm, ElementQuad1, ElementQuad2, ElementTriP1, ElementTriP2, ElementVector, Functional, InteriorFacetBasis
from skfem import LinearForm, MeshQuad, MeshTri2, asm
from skfem.helpers import ddot, div, dot, grad, mul

sys.dont_write_bytecode = True
HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
sys.path[:0] = [HERE, os.path.dirname(HERE)]
import channel_fem as sharp
from channel_fem import DIFFUSIVITY, FORCE, HOT, HOT_FROM, HOT_TO, INLET, LENGTH, NODES, OUTLET, SECTION, VISCOSITY, factorised

DEGREE = 5
carried = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]), v))
newton = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]) + mul(grad(w["w"]), u), v))
stiffness = BilinearForm(lambda u, v, w: ddot(grad(u), grad(v)))
divergence = BilinearForm(lambda u, q, w: -div(u) * q)
mass = BilinearForm(lambda u, v, w: dot(u, v))
convection = LinearForm(lambda v, w: dot(mul(grad(w["w"]), w["w"]), v))
heat_form = BilinearForm(lambda u, v, w: DIFFUSIVITY * dot(grad(u), grad(v)) + dot(w["w"], grad(u)) * v)


def joined(basis, size, axes):
    """Of each unknown the one that it equals across the periods along `axes`."""
    own = np.arange(basis.N)
    near = np.round(basis.doflocs / 1e-9).astype(np.int64)
    for axis in axes:
        near[axis] %= round(size[axis] / 1e-9)
    kind = np.zeros(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.facet_dofs, basis.interior_dofs):
        for row, one in enumerate(dofs):
            kind[one] = row
    _, first, inverse = np.unique(np.vstack([near, kind]), axis=1, return_index=True, return_inverse=True)
    own[:] = first[inverse.ravel()]
    return own


def reduction(own, fixed):
    """The matrix from free unknowns to all; equal ones across a period are one, those of `fixed` are none."""
    barred = np.zeros(len(own), bool)
    barred[own[fixed]] = True
    free = np.setdiff1d(np.unique(own), np.where(barred)[0])
    column = np.full(len(own), -1)
    column[free] = np.arange(len(free))
    rows = np.where(column[own] >= 0)[0]
    return sparse.csr_matrix((np.ones(len(rows)), (rows, column[own][rows])), (len(own), len(free)))


def steady_flow(bv, bp, nu, push, x, P, tolerance=1e-9):
    """Newton's method for the steady equations of Navier and Stokes from x (velocity, pressure); `push` is the load."""
    viscous, B = nu * asm(stiffness, bv), asm(divergence, bv, bp)
    nv = bv.N
    for turn in range(25):
        field = bv.interpolate(x[:nv])
        residual = np.r_[viscous @ x[:nv] + B.T @ x[nv:] + asm(convection, bv, w=field) - push, B @ x[:nv]]
        J = sparse.bmat([[viscous + asm(newton, bv, w=field), B.T], [B, None]]).tocsr()
        step = P @ factorised((P.T @ J @ P).tocsr())(-(P.T @ residual))
        x = x + step
        if abs(step[:nv]).max() < tolerance ** 0.5:
            # The rest is of the square of this step.
            return x
    raise RuntimeError("Newton's method does not converge")


class Channel:
    """The heated channel of data/scenes/heated-channel.toml on a structured mesh with cells of about h."""

    def __init__(self, h, height=0.2):
        self.height = height
        places = np.unique(np.round(np.r_[0, INLET, HOT_FROM, HOT_TO, SECTION, OUTLET, LENGTH, sharp.kinks(NODES)], 9))
        xs = np.unique(np.concatenate([np.linspace(a, b, max(1, round((b - a) / h)) + 1) for a, b in zip(places, places[1:])]))
        self.flat = MeshQuad.init_tensor(xs, np.linspace(0, height, round(height / h) + 1))
        m = self.flat
        self.middle = m.p[0][m.t].mean(0)
        self.inside = np.where((self.middle > INLET) & (self.middle < OUTLET))[0]
        self.section = m.facets_satisfying(lambda x: abs(x[0] - SECTION) < 1e-9)
        self.build(0 * NODES)
        bv, bp, bt = self.bv, self.bp, self.bt
        v, t = bv.doflocs, bt.doflocs
        nv = bv.N
        own = np.r_[joined(bv, [LENGTH, height], [0]), nv + joined(bp, [LENGTH, height], [0])]
        walls = np.where((v[1] < 1e-9) | (v[1] > height - 1e-9))[0]
        self.P = reduction(own, np.r_[walls, nv])
        hot = (t[1] < 1e-9) & (t[0] > HOT_FROM - 1e-9) & (t[0] < HOT_TO + 1e-9)
        cold = (t[0] < INLET + 1e-9) | (t[0] > OUTLET + 1e-9)
        self.start_T = np.where(hot, HOT, 0.0)
        self.PT = reduction(np.arange(bt.N), np.where(hot | cold)[0])
        self.x = np.zeros(nv + bp.N)

    def moved(self, offsets):
        """The mesh over a wall."""
        x, y = self.flat.p
        s = np.interp(x, sharp.kinks(NODES), np.r_[0, offsets, 0])
        return MeshQuad(np.array([x, y + s * (1 - y / self.height)]), self.flat.t)

    def bases(self, m):
        bv = Basis(m, ElementVector(ElementQuad2()), intorder=DEGREE)
        return bv, bv.with_element(ElementQuad1()), Basis(m, ElementQuad2(), intorder=DEGREE, elements=self.inside)

    def build(self, offsets):
        self.offsets = np.asarray(offsets, float)
        self.m = self.moved(self.offsets)
        self.bv, self.bp, self.bt = self.bases(self.m)
        self.bvt = Basis(self.m, ElementVector(ElementQuad2()), intorder=DEGREE, elements=self.inside)
        self.across = [InteriorFacetBasis(self.m, e, intorder=DEGREE, facets=self.section) for e in (ElementVector(ElementQuad2()), ElementQuad2())]

    def solve(self, offsets):
        """Q over a wall."""
        self.build(offsets)
        push = asm(LinearForm(lambda v, w: FORCE * v[0]), self.bv)
        self.x = steady_flow(self.bv, self.bp, VISCOSITY, push, self.x, self.P)
        self.K = asm(heat_form, self.bt, w=self.bvt.interpolate(self.x[: self.bv.N]))
        self.solve_K = (self.PT.T @ self.K @ self.PT).tocsr()
        self.T = self.start_T - self.PT @ factorised(self.solve_K)(self.PT.T @ (self.K @ self.start_T))
        u, T = self.across[0].interpolate(self.x[: self.bv.N]), self.across[1].interpolate(self.T)
        return asm(Functional(lambda w: w["u"][0] * w["T"]), self.across[1], u=u, T=T)

    def gradient(self):
        """Of Q by the wall's offsets: two transposed solutions, and the residuals' change with the mesh."""
        nv, bv, bp, bt = self.bv.N, self.bv, self.bp, self.bt
        velocity = self.x[:nv]
        u, T = self.across[0].interpolate(velocity), self.across[1].interpolate(self.T)
        by_T = asm(LinearForm(lambda v, w: w["u"][0] * v), self.across[1], u=u)
        by_u = asm(LinearForm(lambda v, w: w["T"] * v[0]), self.across[0], T=T)
        heat = self.PT @ factorised(self.solve_K.T.tocsr())(self.PT.T @ by_T)
        by_u = by_u - asm(LinearForm(lambda v, w: dot(v, grad(w["T"])) * w["l"]), self.bvt, T=bt.interpolate(self.T), l=bt.interpolate(heat))
        B = asm(divergence, bv, bp)
        J = sparse.bmat([[VISCOSITY * asm(stiffness, bv) + asm(newton, bv, w=bv.interpolate(velocity)), B.T], [B, None]]).tocsr()
        flow = self.P @ factorised((self.P.T @ J.T @ self.P).tocsr())(self.P.T @ np.r_[by_u, np.zeros(bp.N)])
        of_flow = Functional(lambda w: VISCOSITY * ddot(grad(w["u"]), grad(w["l"])) + dot(mul(grad(w["u"]), w["u"]), w["l"]) - FORCE * w["l"][0]
                             - w["p"] * div(w["l"]) - w["q"] * div(w["u"]))
        of_heat = Functional(lambda w: DIFFUSIVITY * dot(grad(w["T"]), grad(w["l"])) + dot(w["u"], grad(w["T"])) * w["l"])

        def product(offsets):
            """Adjoint times residual, of each cell."""
            m = self.moved(offsets)
            bv, bp, bt = self.bases(m)
            pressures = {"p": bp.interpolate(self.x[nv:]), "q": bp.interpolate(flow[nv:])}
            out = of_flow.elemental(bv, u=bv.interpolate(velocity), l=bv.interpolate(flow[:nv]), **pressures)
            bvt = Basis(m, ElementVector(ElementQuad2()), intorder=DEGREE, elements=self.inside)
            out[self.inside] += of_heat.elemental(bt, u=bvt.interpolate(velocity), T=bt.interpolate(self.T), l=bt.interpolate(heat))
            return out

        # A node moves the cells between its neighbours, so every other node can move at once.
        found, places, h = np.zeros(len(NODES)), sharp.kinks(NODES), 1e-6
        for odd in (0, 1):
            some = np.arange(len(NODES)) % 2 == odd
            change = (product(self.offsets + h * some) - product(self.offsets - h * some)) / (2 * h)
            for k in np.where(some)[0]:
                found[k] = -change[(self.middle > places[k]) & (self.middle < places[k + 2])].sum()
        return found


def channel(options):
    """Q over a wall of the reference, and its gradient."""
    _, wall = sharp.read_wall(options.wall)
    if options.graded:
        of = sharp.Channel(0.2, NODES, 0, 2, options.graded)
        return {"q": of.solve(wall), "unknowns": len(of.free) + len(of.warm)}
    of = Channel(options.h)
    q = of.solve(wall)
    found = {"unknowns": of.P.shape[1] + of.PT.shape[1], "q": q}
    if options.gradient:
        found["gradient"] = of.gradient().tolist()
    return found


def optimise(options):
    """The best wall, as hydrograd looks for it: -Q + smoothing * sum of (o[k + 1] - o[k])^2 within bounds. Lines have the processor time so far."""
    from scipy.optimize import minimize

    of = Channel(options.h)
    flat, count = [], [0]

    def loss(offsets):
        q = of.solve(offsets)
        flat[:] = flat or [q]
        steps = np.diff(offsets)
        g = -of.gradient() + 2 * options.smoothing * (np.r_[0, steps] - np.r_[steps, 0])
        count[0] += 1
        value = -q + options.smoothing * (steps ** 2).sum()
        print(json.dumps({"seconds": time.process_time(), "q": q, "loss": value, "wall": offsets.tolist()}), flush=True)
        return value / flat[0], g / flat[0]

    limit = [(-options.bound, options.bound)] * len(NODES)
    found = minimize(loss, 0 * NODES, jac=True, method="L-BFGS-B", bounds=limit, options={"maxiter": 40, "ftol": 1e-7, "gtol": 1e-6})
    return {"unknowns": of.P.shape[1] + of.PT.shape[1], "evaluations": count[0], "message": str(found.message), "wall": found.x.tolist()}


def taylor_green(options):
    """Backward differences of second order; convection is extrapolated, so one factorisation serves all steps. A step goes half a cell at most."""
    n, nu = options.n, options.nu
    end = np.log(2) / (8 * np.pi ** 2 * nu)
    steps = options.steps or max(2 * n, int(np.ceil(2 * n * end)))
    dt = end / steps
    m = MeshQuad.init_tensor(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    bv = Basis(m, ElementVector(ElementQuad2()), intorder=DEGREE)
    bp = bv.with_element(ElementQuad1())
    nv = bv.N
    P = reduction(np.r_[joined(bv, [1, 1], [0, 1]), nv + joined(bp, [1, 1], [0, 1])], [nv])
    M, A, B = asm(mass, bv), nu * asm(stiffness, bv), asm(divergence, bv, bp)

    def exact(x, t):
        a, b = 2 * np.pi * x
        return np.exp(-8 * np.pi ** 2 * nu * t) * np.array([-np.cos(a) * np.sin(b), np.sin(a) * np.cos(b)])
    both = exact(bv.doflocs, 0)
    second = np.zeros(nv, bool)
    for dofs in (bv.nodal_dofs, bv.facet_dofs, bv.interior_dofs):
        second[dofs[1]] = True
    old = np.where(second, both[1], both[0])

    def solver(weight):
        S = sparse.bmat([[weight / dt * M + A, B.T], [B, None]]).tocsr()
        return factorised((P.T @ S @ P).tocsr(), often=True)
    load = lambda u: asm(convection, bv, w=bv.interpolate(u))
    none, first = np.zeros(bp.N), solver(1.0)
    carried_old = load(old)
    u = (P @ first(P.T @ np.r_[M @ old / dt - carried_old, none]))[:nv]
    # The first step once more, with the mean of both ends, is of second order.
    u = (P @ first(P.T @ np.r_[M @ old / dt - 0.5 * (carried_old + load(u)) + 0.5 * (A @ (u - old)), none]))[:nv]
    solve = solver(1.5)
    for _ in range(steps - 1):
        carried_new = load(u)
        rhs = M @ (2 * u - 0.5 * old) / dt - 2 * carried_new + carried_old
        old, u, carried_old = u, (P @ solve(P.T @ np.r_[rhs, none]))[:nv], carried_new
    amplitude = np.exp(-8 * np.pi ** 2 * nu * end)
    gap = Functional(lambda w: ((w["u"] - exact(w.x, end)) ** 2).sum(0))
    error = np.sqrt(asm(gap, bv, u=bv.interpolate(u))) / amplitude
    return {"unknowns": P.shape[1], "steps": steps, "error": float(error)}


def cylinder(options):
    """Drag and lift over density x 0.2^2 x 0.1 / 2."""
    from bodies_fem import formula, mesh, outline

    with open(os.path.join(ROOT, "data/scenes/schaefer-turek-1.toml"), "rb") as file:
        scene = tomllib.load(file)
    size, nu, disc = scene["region"]["size"], scene["fluid"]["viscosity"], scene["shapes"][0]
    centre, radius = np.array(disc["centre"]), disc["radius"]
    straight = mesh(size, [outline(disc, options.points)], options.far, False)
    # Middles of the edges on the circle move there.
    m = MeshTri2.from_mesh(straight)
    places = np.array(m.doflocs)
    way = np.hypot(*(places - centre[:, None]))
    on = way < radius * (1 + 1e-6)
    places[:, on] = centre[:, None] + (places[:, on] - centre[:, None]) * radius / way[on]
    m = MeshTri2(places, m.t)
    bv = Basis(m, ElementVector(ElementTriP2()), intorder=DEGREE)
    bp = bv.with_element(ElementTriP1())
    nv = bv.N
    facets = m.boundary_facets()
    x, y = m.p[:, m.facets[:, facets]].mean(1)
    out, left = x > size[0] - 1e-6, x < 1e-6
    body = np.hypot(x - centre[0], y - centre[1]) < 1.5 * radius
    dofs = lambda which: bv.get_dofs(facets[which]).flatten()
    second = np.zeros(nv, bool)
    for some in (bv.nodal_dofs, bv.facet_dofs):
        second[some[1]] = True
    start = np.zeros(nv + bp.N)
    inflow = dofs(left)
    speed = scene["region"]["sides"]["left"]["velocity"][0]
    start[inflow] = np.where(second[inflow], 0, formula(speed, *bv.doflocs[:, inflow]))
    P = reduction(np.arange(nv + bp.N), dofs(~out))
    x = steady_flow(bv, bp, nu, np.zeros(nv), start, P)
    viscous, B = nu * asm(stiffness, bv), asm(divergence, bv, bp)
    force = -(viscous @ x[:nv] + B.T @ x[nv:] + asm(convection, bv, w=bv.interpolate(x[:nv])))
    on = dofs(body)
    scale = 0.2 ** 2 * 0.1 / 2
    return {"unknowns": P.shape[1], "drag": force[on[~second[on]]].sum() / scale, "lift": force[on[second[on]]].sum() / scale}


def main():
    jobs = {"channel": channel, "optimise": optimise, "taylor-green": taylor_green, "cylinder": cylinder}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=jobs)
    parser.add_argument("--wall", default="sin1:0.02", help="NAME:AMPLITUDE of data/reference/fem-shapes-H0.2.csv")
    parser.add_argument("--h", type=float, default=0.02)
    parser.add_argument("--graded", type=float, default=None, help="channel_fem.py's mesh instead, with its smallest cells of this size")
    parser.add_argument("--gradient", action="store_true")
    parser.add_argument("--smoothing", type=float, default=0.05)
    parser.add_argument("--bound", type=float, default=0.02)
    parser.add_argument("--n", type=int, default=16)
    parser.add_argument("--nu", type=float, default=0.05)
    parser.add_argument("--steps", type=int, default=None)
    parser.add_argument("--points", type=int, default=40)
    parser.add_argument("--far", type=float, default=0.05)
    options = parser.parse_args()
    if options.what == "cylinder":
        # Here, so that it counts as start-up.
        import gmsh  # noqa: F401
    try:
        from pypardiso import ps
        os.environ.setdefault("PYPARDISO_MKL_RT", ps.libmkl._name)
        solver = "Pardiso"
    except ImportError:
        solver = "SuperLU"
    start = time.process_time()
    found = jobs[options.what](options)
    print(json.dumps({**found, "solver": solver, "start": start, "seconds": time.process_time()}))


if __name__ == "__main__":
    main()
