#!/usr/bin/env python3
"""Finite elements beside fixed particles for fins on the floor of a channel: heat outflow and pressure drop, and force and heat of each fin.

    python3 scripts/fins_fem.py data/scenes/examples/fins.toml runs/optimize-fins/best.toml

Taylor-Hood elements (P2, P1) and P2 for heat, on a mesh of gmsh that is finer by far at corners, Newton's method; force and heat of a fin from
the residual at its nodes. Fins are boxes, and polylines of two points with a round end, that stand on the bottom; boxes that end there are
hot parts of it. There is an inflow at the left (numbers or formulas of y), and an outflow at the right. Needs numpy, scipy, scikit-fem
and gmsh.
"""
import argparse
import json
import sys
import tomllib

import gmsh
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as solvers
from bodies_fem import formula, triangles
from skfem import Basis, BilinearForm, ElementTriP1, ElementTriP2, ElementVector, FacetBasis, Functional, LinearForm, asm
from skfem.helpers import ddot, div, dot, grad, mul


def towards(a, b, count, at_first, at_last):
    """Points from a to before b, denser at the ends that are named."""
    u = np.arange(count) / count
    if at_first and at_last:
        u = np.where(u < 0.5, 4 * u**3, 1 - 4 * (1 - u) ** 3)
    elif at_first or at_last:
        u = u**3 if at_first else 1 - (1 - u) ** 3
    return a + u[:, None] * (b - a)


def outline(shape, count):
    """Points of the part of a fin that is above the floor, from its left foot to its right one."""
    if shape["kind"] == "box":
        (x0, _), (x1, y) = shape["lower"], shape["upper"]
        a, b, c, d = np.array([[x0, 0.0], [x0, y], [x1, y], [x1, 0.0]])
        edges = [towards(a, b, count, False, True), towards(b, c, count, True, True), towards(c, d, count, True, False)]
        return np.vstack(edges + [d])
    if shape["kind"] != "polyline" or len(shape["points"]) != 2:
        sys.exit("boxes and polylines of two points only")
    a, b = np.array(shape["points"])
    r, way = 0.5 * shape["thickness"], (b - a) / np.hypot(*(b - a))
    left = np.array([-way[1], way[0]])
    foot = [p - way * p[1] / way[1] for p in (a + r * left, a - r * left)]
    angle = np.linspace(0, np.pi, count + 1)[:, None]
    tip = b + r * (np.cos(angle) * left + np.sin(angle) * way)
    steps = [max(6, int(np.hypot(*(end - at)) * count / (2 * np.pi * r))) for end, at in zip((tip[0], tip[-1]), foot)]
    sides = towards(foot[0], tip[0], steps[0], False, False), towards(tip[-1], foot[1], steps[1], False, False)
    return np.vstack([sides[0], tip[:-1], sides[1], foot[1]])


def mesh(size, fins, edges, far):
    """Triangles over the floor with its fins; `edges`: of its hot parts."""
    plain = [np.array([[x, 0.0]]) for x in edges if not any(f[0, 0] <= x <= f[-1, 0] for f in fins)]
    floor = sorted(fins + plain, key=lambda points: points[0, 0])
    points = np.vstack([[[0.0, 0.0]], *floor, [[size[0], 0.0], size, [0.0, size[1]]]])
    step = np.hypot(*(np.roll(points, -1, 0) - points).T)
    h = np.minimum(np.minimum(step, np.roll(step, 1)), far)
    h[[k for k, p in enumerate(points) if p[1] == 0 and p[0] in edges]] = far / 8
    feet = [x for f in fins for x in (f[0, 0], f[-1, 0])]
    h[[k for k, p in enumerate(points) if abs(p[1]) < 1e-12 and p[0] in feet]] = far / 12
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 0)
    g = gmsh.model.geo
    q = [g.addPoint(*x, 0, size) for x, size in zip(points, h)]
    g.addPlaneSurface([g.addCurveLoop([g.addLine(q[i], q[(i + 1) % len(q)]) for i in range(len(q))])])
    g.synchronize()
    return triangles()


def flow(scene, count, far):
    size, left, fluid = scene["region"]["size"], scene["region"]["sides"]["left"], scene["fluid"]
    nu, alpha = fluid["viscosity"], fluid["conductivity"]
    shapes = scene["shapes"]
    hot = [s for s in shapes if s["kind"] == "box" and s["upper"][1] <= 0]
    fins = [s for s in shapes if s not in hot]
    outlines = [outline(s, count) for s in fins]
    m = mesh(size, outlines, [x for s in hot for x in (s["lower"][0], s["upper"][0])], far)
    bv = Basis(m, ElementVector(ElementTriP2()), intorder=5)
    bp, bt = bv.with_element(ElementTriP1()), bv.with_element(ElementTriP2())
    component = np.zeros(bv.N, int)
    for dofs in (bv.nodal_dofs, bv.facet_dofs):
        component[dofs[1]] = 1
    facets = m.boundary_facets()
    x, y = m.p[:, m.facets[:, facets]].mean(1)
    at_left, at_right, at_top = x < 1e-9, x > size[0] - 1e-9, y > size[1] - 1e-9
    wall = ~(at_left | at_right)
    u = np.zeros(bv.N)
    inflow = bv.get_dofs(facets[at_left]).flatten()
    u[inflow] = np.where(component[inflow] == 0, *[formula(v, *bv.doflocs[:, inflow]) for v in left["velocity"]])
    fixed = np.union1d(bv.get_dofs(facets[wall]).flatten(), inflow)
    free = np.setdiff1d(np.arange(bv.N + bp.N), fixed)
    viscous = asm(BilinearForm(lambda u, v, w: nu * ddot(grad(u), grad(v))), bv)
    divergence = asm(BilinearForm(lambda u, q, w: -div(u) * q), bv, bp)
    carried = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]), v))
    newton = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]) + mul(grad(w["w"]), u), v))
    z = np.concatenate([u, np.zeros(bp.N)])

    def residual(more):
        u, p = z[: bv.N], z[bv.N :]
        return np.concatenate([more * (viscous @ u) + divergence.T @ p + asm(carried, bv, w=bv.interpolate(u)) @ u, divergence @ u])

    # With a viscosity that becomes smaller, so that Newton's method converges.
    for more in (8.0, 3.0, 1.5, 1.0):
        for _ in range(25):
            r = residual(more)[free]
            if abs(r).max() < 1e-12:
                break
            J = sparse.bmat([[more * viscous + asm(newton, bv, w=bv.interpolate(z[: bv.N])), divergence.T], [divergence, None]]).tocsc()
            z[free] -= solvers.spsolve(J[free][:, free], r)
    R, u = residual(1.0), z[: bv.N]
    heat = asm(BilinearForm(lambda t, v, w: alpha * dot(grad(t), grad(v)) + dot(w["w"], grad(t)) * v), bt, w=bv.interpolate(u))
    owner = [(y > 1e-9) & ~at_top & wall & (points[:, 0].min() - 1e-9 < x) & (x < points[:, 0].max() + 1e-9) for points in outlines]
    T, given = np.zeros(bt.N), []
    floor = [((y < 1e-9) & (s["lower"][0] < x) & (x < s["upper"][0]), s["temperature"]) for s in hot]
    for which, value in [(at_left, left["temperature"]), *floor, *zip(owner, [s["temperature"] for s in fins])]:
        nodes = bt.get_dofs(facets[which]).flatten()
        T[nodes] = value
        given.append(nodes)
    rest = np.setdiff1d(np.arange(bt.N), np.concatenate(given))
    T[rest] = solvers.spsolve(heat[rest][:, rest].tocsc(), -(heat @ T)[rest])
    # The residual at the foot of a fin has what the first edge of the floor carries, too.
    elements = ElementVector(ElementTriP2()), ElementTriP1(), ElementTriP2()
    of_u, of_p, of_t = [FacetBasis(m, element, facets=facets[(y < 1e-9) & wall], intorder=5) for element in elements]
    push = LinearForm(lambda v, w: nu * dot(mul(grad(w["u"]), w.n), v) - w["p"] * dot(w.n, v))
    R = R[: bv.N] - asm(push, of_u, u=of_u.interpolate(u), p=of_p.interpolate(z[bv.N :]))
    flux = heat @ T - asm(LinearForm(lambda v, w: alpha * dot(grad(w["t"]), w.n) * v), of_t, t=of_t.interpolate(T))
    found = {"fins": []}
    for which in owner:
        nodes = bv.get_dofs(facets[which]).flatten()
        force = [-R[nodes[component[nodes] == d]].sum() for d in (0, 1)]
        found["fins"].append({"force": force, "heat": flux[bt.get_dofs(facets[which]).flatten()].sum()})
    out = [FacetBasis(m, element, facets=facets[at_right], intorder=5) for element in (ElementVector(ElementTriP2()), ElementTriP2())]
    found["heat_outflow"] = asm(Functional(lambda w: w["u"][0] * w["t"]), out[1], u=out[0].interpolate(u), t=out[1].interpolate(T))

    def pressure(which):
        basis = FacetBasis(m, ElementTriP1(), facets=facets[which], intorder=3)
        return asm(Functional(lambda w: w["p"]), basis, p=basis.interpolate(z[bv.N :])) / size[1]

    found["pressure_drop"] = pressure(at_left) - pressure(at_right)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--points", type=int, default=14, help="edges along a side, or around a round end")
    parser.add_argument("--far", type=float, default=0.018, help="mesh size")
    options = parser.parse_args()
    for path in options.scenes:
        print(path, json.dumps(flow(tomllib.load(open(path, "rb")), options.points, options.far)), flush=True)


if __name__ == "__main__":
    main()
