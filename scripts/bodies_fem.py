#!/usr/bin/env python3
"""Finite elements beside fixed particles: flow rate, and force, torque and heat of each body of a scene in two dimensions.

    python3 scripts/bodies_fem.py data/scenes/examples/least-drag.toml        a scene (--points 160: edges a body; --far 0.014: mesh size)
    python3 scripts/bodies_fem.py runs/optimize-least-drag                    the first and the best shapes of a search

Taylor-Hood elements (P2, P1) and P2 for heat on a mesh of gmsh around discs, ellipses, splines and polygons (finer at corners), Newton's method; forces and heat from
the residual at the nodes of each body, which is an exact balance. Either x is periodic and y has walls at rest, whose temperature
is that of the boxes behind them, or region.sides has an inflow at the left (numbers or formulas of y), an outflow at the right, and
symmetry. A drive (fluid.drive) is replaced by the body force that hydrograd found. Needs numpy, scipy, scikit-fem and gmsh.
"""
import argparse
import json
import os
import sys
import tomllib

import gmsh
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as solvers
import skfem
from scipy.interpolate import CubicSpline
from skfem import Basis, BilinearForm, ElementTriP1, ElementTriP2, ElementVector, LinearForm, asm
from skfem.helpers import ddot, div, dot, grad, mul


def centre(shape):
    """The centre of a body, or the centroid of a polygon."""
    if "points" not in shape:
        return shape["centre"]
    p = np.array(shape["points"])
    q = np.roll(p, -1, 0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    return ((p + q) * cross[:, None]).sum(0) / (3 * cross.sum())


def outline(shape, count):
    """Points of a body at equal distances; those of a polygon are denser by far at its corners."""
    if shape["kind"] == "polygon":
        p = np.array(shape["points"], float)
        edges = np.roll(p, -1, 0) - p
        share = np.hypot(*edges.T) / np.hypot(*edges.T).sum()
        found = []
        for corner, edge, part in zip(p, edges, share):
            u = np.arange(n := max(8, round(part * count))) / n
            found.append(corner + np.where(u < 0.5, 4 * u**3, 1 - 4 * (1 - u) ** 3)[:, None] * edge)
        return np.vstack(found)
    a = np.linspace(0, 2 * np.pi, 4001)[:-1]
    x, y = shape["centre"]
    if shape["kind"] == "disc":
        p = np.stack([x + shape["radius"] * np.cos(a), y + shape["radius"] * np.sin(a)], 1)
    elif shape["kind"] == "ellipse":
        q = np.radians(shape.get("angle", 0.0))
        u, v = shape["axes"][0] * np.cos(a), shape["axes"][1] * np.sin(a)
        p = np.stack([x + np.cos(q) * u - np.sin(q) * v, y + np.sin(q) * u + np.cos(q) * v], 1)
    elif shape["kind"] == "spline":
        r = np.array(shape["radii"])
        radius = CubicSpline(np.arange(len(r) + 1) * 2 * np.pi / len(r), np.append(r, r[0]), bc_type="periodic")(a)
        p = np.stack([x + radius * np.cos(a), y + radius * np.sin(a)], 1)
    else:
        sys.exit(f"a body of kind {shape['kind']}: discs, ellipses, splines and polygons only")
    way = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(np.vstack([p, p[:1]]), axis=0).T))])
    at = np.arange(count) / count * way[-1]
    closed = np.vstack([p, p[:1]])
    return np.stack([np.interp(at, way, closed[:, d]) for d in (0, 1)], 1)


def triangles():
    """The triangles of the model that gmsh has, which ends."""
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh.model.mesh.generate(2)
    tags, places, _ = gmsh.model.mesh.getNodes()
    places = places.reshape(-1, 3)[:, :2]
    _, corners = gmsh.model.mesh.getElementsByType(2)
    index = np.zeros(int(tags.max()) + 1, int)
    index[tags.astype(int)] = np.arange(len(tags))
    used, inverse = np.unique(index[corners.astype(int).reshape(-1, 3)], return_inverse=True)
    gmsh.finalize()
    return skfem.MeshTri(places[used].T.copy(), inverse.reshape(-1, 3).T.copy())


def mesh(size, bodies, far, periodic):
    """Triangles around the bodies."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 0)
    g = gmsh.model.geo
    corners = [g.addPoint(*q, 0, far) for q in [(0, 0), (size[0], 0), (size[0], size[1]), (0, size[1])]]
    edges = [g.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    loops = [g.addCurveLoop(edges)]
    for points in bodies:
        step = np.hypot(*(np.roll(points, -1, 0) - points).T)
        q = [g.addPoint(*x, 0, h) for x, h in zip(points, 0.5 * (step + np.roll(step, 1)))]
        lines = [g.addLine(q[i], q[(i + 1) % len(q)]) for i in range(len(q))]
        for line in lines:
            g.mesh.setTransfiniteCurve(line, 2)
        loops.append(g.addCurveLoop(lines))
    g.addPlaneSurface(loops)
    g.synchronize()
    if periodic:
        gmsh.model.mesh.setPeriodic(1, [edges[1]], [edges[3]], [1, 0, 0, size[0], 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
    return triangles()


def formula(text, x, y):
    """A number or a formula of the scene, by place; ^ is the power."""
    return eval(str(text).replace("^", "**"), {"__builtins__": {}}, {"x": x, "y": y, "PI": np.pi, "sin": np.sin, "cos": np.cos, "exp": np.exp})


def flow(scene, force, points, far):
    """Flow rate and, of each body, force, torque and heat."""
    region, fluid = scene["region"], scene.get("fluid", {})
    size, density = region["size"], fluid.get("density", 1.0)
    nu = fluid.get("viscosity", 0.01) / density
    capacity = fluid.get("heat_capacity", 1.0)
    alpha = fluid.get("conductivity", 7.313) / (density * capacity)
    sides = region.get("sides", {})
    periodic = bool(region.get("periodic", [False])[0])
    has_heat = "temperature" in scene.get("initial", {})
    bodies = [shape for shape in scene["shapes"] if shape["kind"] != "box"]
    walls = [shape for shape in scene["shapes"] if shape["kind"] == "box"]
    wall_temperature = [next((w["temperature"] for w in walls if w["lower"][1] < y < w["upper"][1] and "temperature" in w), None) for y in (-1e-6, size[1] + 1e-6)]
    m = mesh(size, [outline(body, points) for body in bodies], far, periodic)
    bv = Basis(m, ElementVector(ElementTriP2()), intorder=5)
    bp, bt = bv.with_element(ElementTriP1()), bv.with_element(ElementTriP2())
    nv = bv.N
    component = np.zeros(nv, int)
    for dofs in (bv.nodal_dofs, bv.facet_dofs):
        component[dofs[1]] = 1

    def master(basis, groups):
        """Of each degree of freedom the one that it equals across the period."""
        own = np.arange(basis.N)
        if periodic:
            for c in np.unique(groups):
                left = np.where((basis.doflocs[0] < 1e-9) & (groups == c))[0]
                right = np.where((basis.doflocs[0] > size[0] - 1e-9) & (groups == c))[0]
                own[right[np.argsort(basis.doflocs[1][right])]] = left[np.argsort(basis.doflocs[1][left])]
        return own

    facets = m.boundary_facets()
    middle = m.p[:, m.facets[:, facets]].mean(1)
    low, high = middle[1] < 1e-9, middle[1] > size[1] - 1e-9
    left, right = middle[0] < 1e-9, middle[0] > size[0] - 1e-9
    body = ~(low | high | left | right)
    dofs = lambda basis, which: basis.get_dofs(facets[which]).flatten()
    given = np.zeros(nv)
    fixed = list(dofs(bv, body))
    for name, which in (("bottom", low), ("top", high)):
        edge = dofs(bv, which)
        fixed += list(edge[component[edge] == 1] if sides.get(name, {}).get("kind") == "symmetry" else edge)
    if not periodic:
        inflow = dofs(bv, left)
        x, y = bv.doflocs[:, inflow]
        speeds = [formula(v, x, y) for v in sides["left"]["velocity"]]
        given[inflow] = np.where(component[inflow] == 0, *speeds)
        fixed += list(inflow)
    fixed = np.unique(fixed)
    pin = [nv] if periodic else []
    own = np.concatenate([master(bv, component), nv + master(bp, np.zeros(bp.N, int))])
    barred = np.concatenate([fixed, own[fixed], pin]).astype(int)
    free = np.setdiff1d(np.unique(own), barred)
    column = np.full(nv + bp.N, -1)
    column[free] = np.arange(len(free))
    c = column[own]
    k = np.where(c >= 0)[0]
    P = sparse.csr_matrix((np.ones(len(k)), (k, c[k])), shape=(nv + bp.N, len(free)))
    viscous = asm(BilinearForm(lambda u, v, w: nu * (ddot(grad(u), grad(v)))), bv)
    divergence = asm(BilinearForm(lambda u, q, w: -div(u) * q), bv, bp)
    push = asm(LinearForm(lambda v, w: force[0] * v[0] + force[1] * v[1]), bv)
    carried = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]), v))
    newton = BilinearForm(lambda u, v, w: dot(mul(grad(u), w["w"]) + mul(grad(w["w"]), u), v))
    x = np.concatenate([given, np.zeros(bp.N)])

    def residual(x, more=1.0):
        u, p = x[:nv], x[nv:]
        momentum = more * (viscous @ u) + divergence.T @ p - push + asm(carried, bv, w=bv.interpolate(u)) @ u
        return np.concatenate([momentum, divergence @ u])

    # With a viscosity that becomes smaller, so that Newton's method converges.
    for more in (8.0, 3.0, 1.5, 1.0):
        for _ in range(25):
            r = P.T @ residual(x, more)
            if abs(r).max() < 1e-12:
                break
            J = sparse.bmat([[more * viscous + asm(newton, bv, w=bv.interpolate(x[:nv])), divergence.T], [divergence, None]]).tocsr()
            dx = P @ solvers.spsolve((P.T @ J @ P).tocsc(), -r)
            x = x + dx
            if abs(dx[:nv]).max() < 1e-11:
                break
    R = residual(x)
    found = {"flow_rate": asm(LinearForm(lambda v, w: w["w"][0] * v), bt, w=bv.interpolate(x[:nv])).sum() / size[0], "shapes": []}
    RT = None
    if has_heat:
        heat = asm(BilinearForm(lambda u, v, w: alpha * dot(grad(u), grad(v)) + dot(w["w"], grad(u)) * v), bt, w=bv.interpolate(x[:nv]))
        T, fixed = np.zeros(bt.N), []
        for which, value in ((low, wall_temperature[0]), (high, wall_temperature[1])):
            if value is not None:
                T[dofs(bt, which)] = value
                fixed += list(dofs(bt, which))

    def near(points, q):
        return np.hypot(*(points - q).T).min() < 0.01

    at = dofs(bv, body)
    outlines = [outline(shape, 400) for shape in bodies]
    owner = [at[[near(points, q) for q in bv.doflocs[:, at].T]] for points in outlines]
    if has_heat:
        hot = dofs(bt, body)
        warm = [hot[[near(points, q) for q in bt.doflocs[:, hot].T]] for points in outlines]
        for shape, which in zip(bodies, warm):
            T[which] = shape["temperature"]
            fixed += list(which)
        if not periodic:
            inflow = dofs(bt, left)
            T[inflow] = float(sides["left"]["temperature"])
            fixed += list(inflow)
        own = master(bt, np.zeros(bt.N, int))
        fixed = np.unique(fixed)
        free = np.setdiff1d(np.unique(own), np.concatenate([fixed, own[fixed]]))
        column = np.full(bt.N, -1)
        column[free] = np.arange(len(free))
        c = column[own]
        k = np.where(c >= 0)[0]
        PT = sparse.csr_matrix((np.ones(len(k)), (k, c[k])), shape=(bt.N, len(free)))
        T += PT @ solvers.spsolve((PT.T @ heat @ PT).tocsc(), -(PT.T @ (heat @ T)))
        RT = heat @ T
    for i, shape in enumerate(bodies):
        d = owner[i]
        xs, ys = d[component[d] == 0], d[component[d] == 1]
        cx, cy = centre(shape)
        torque = -((bv.doflocs[0, ys] - cx) * R[ys]).sum() + ((bv.doflocs[1, xs] - cy) * R[xs]).sum()
        record = {"force": [-density * R[xs].sum(), -density * R[ys].sum()], "torque": density * torque}
        if has_heat:
            record["heat"] = density * capacity * RT[warm[i]].sum()
        found["shapes"].append(record)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path")
    parser.add_argument("--points", type=int, default=160)
    parser.add_argument("--far", type=float, default=None)
    parser.add_argument("--force", type=float, default=None, help="body force along x, where the scene has a drive")
    options = parser.parse_args()
    scenes = [(options.path, options.force)]
    if os.path.isdir(options.path):
        summary = json.load(open(os.path.join(options.path, "summary.json")))
        scenes = [(os.path.join(options.path, "config.toml"), summary.get("before", summary).get("body_force"))]
        if "before" in summary:
            scenes.append((os.path.join(options.path, "best.toml"), summary["body_force"]))
    for path, push in scenes:
        scene = tomllib.load(open(path, "rb"))
        force = list(scene["region"].get("acceleration", [0.0, 0.0]))
        if push is not None:
            force[0] = push
        far = options.far or 0.035 * scene["region"]["size"][1]
        print(path, json.dumps(flow(scene, force, options.points, far)), flush=True)


if __name__ == "__main__":
    main()
