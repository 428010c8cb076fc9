#!/usr/bin/env python3
"""Drag, lift (along z) and heat of what stands on the floor of a duct by finite elements of Taylor and Hood: a box (bricks), or a cylinder with ends
or a ball (tetrahedra with curved faces).

    python3 scripts/standing_fem.py 12 data/scenes/examples/cube.toml runs/optimize-cube/best.toml

The first number is that of elements along a length of 1. Needs numpy, scipy, scikit-fem and pypardiso, and gmsh for tetrahedra (12 bricks: 85,000
unknowns, two minutes, 3 GB). They are those that the discrete equations have at the body's points, less what the floor carries there.
Elements are finer towards the body's edges.
"""
import sys
import tempfile
import tomllib

import numpy as np
import scipy.sparse as sp
from pypardiso import spsolve
from skfem import Basis, BilinearForm, ElementHex1, ElementHex2, ElementTetP1, ElementTetP2, ElementVector, FacetBasis, LinearForm, MeshHex, MeshTet2
from skfem.helpers import ddot, div, dot, grad, mul

GRADED = 0.7


def axis(length, marks, density):
    """Places along an edge of the duct, closer to each other near the marks."""
    places = []
    ends = sorted({0.0, length, *marks})
    for a, b in zip(ends[:-1], ends[1:]):
        s = np.linspace(0, 1, max(2, round((b - a) * density)) + 1)
        near = (a in marks, b in marks)
        graded = {(1, 1): 0.5 * (1 - np.cos(np.pi * s)), (1, 0): s**1.5, (0, 1): 1 - (1 - s) ** 1.5, (0, 0): s}[near]
        places += list(a + (b - a) * (GRADED * graded + (1 - GRADED) * s)[:-1])
    return np.array([*places, length])


def bricks(size, low, high, density):
    """Bricks between the sides and a box."""
    marks = [[x for x in pair if 0 < x < length] for pair, length in zip(zip(low, high), size)]
    mesh = MeshHex.init_tensor(*(axis(size[d], marks[d], density * (0.8 if d == 0 else 1)) for d in range(3)))
    middle = mesh.p[:, mesh.t].mean(1)
    return mesh.remove_elements(np.nonzero(np.all((middle.T > low) & (middle.T < high), axis=1))[0])


def tetrahedra(size, centre, radius, height, density):
    """Tetrahedra between the sides and a cylinder that stands on the floor, or a ball around a centre."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 0)
    occ, field = gmsh.model.occ, gmsh.model.mesh.field
    body = occ.addSphere(*centre, radius) if len(centre) == 3 else occ.addCylinder(*centre, -1.0, 0, 0, 1.0 + height, radius)
    occ.cut([(3, occ.addBox(0, 0, 0, *size))], [(3, body)])
    occ.synchronize()
    on_body = lambda box: all(abs(0.5 * (box[d] + box[d + 3]) - centre[d]) < 1e-3 and box[d + 3] - box[d] < 2.1 * radius for d in (0, 1))
    edges = [tag for _, tag in gmsh.model.getEntities(1) if on_body(gmsh.model.getBoundingBox(1, tag))]
    faces = [tag for _, tag in gmsh.model.getEntities(2) if on_body(gmsh.model.getBoundingBox(2, tag))]
    fine = [("EdgesList", edges, 0.35), ("FacesList", faces, 0.6)]
    all_of_them = []
    for key, tags, share in fine:
        distance, threshold = field.add("Distance"), field.add("Threshold")
        field.setNumbers(distance, key, tags)
        field.setNumber(distance, "Sampling", 100)
        values = {"InField": distance, "SizeMin": share / density, "SizeMax": 1.3 / density, "DistMin": 0.0, "DistMax": 3 * radius}
        for name, value in values.items():
            field.setNumber(threshold, name, value)
        all_of_them.append(threshold)
    least = field.add("Min")
    field.setNumbers(least, "FieldsList", all_of_them)
    field.setAsBackgroundMesh(least)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    with tempfile.TemporaryDirectory() as folder:
        gmsh.write(f"{folder}/mesh.msh")
        gmsh.finalize()
        return MeshTet2.load(f"{folder}/mesh.msh")


def solve(scene, density):
    size, fluid, body = scene["region"]["size"], scene["fluid"], scene["shapes"][0]
    if body["kind"] == "box":
        low, high = np.array(body["lower"]), np.array(body["upper"])
        mesh, quadratic, linear = bricks(size, low, high, density), ElementHex2(), ElementHex1()
        near = lambda x: np.all([(x[d] > low[d] - 1e-9) & (x[d] < high[d] + 1e-9) for d in range(3)], axis=0)
    else:
        is_ball, radius = body["kind"] != "cylinder", body["radius"]
        centre = body["centre"][: 3 if is_ball else 2]
        height = centre[2] + radius if is_ball else body["ends"][1]
        mesh, quadratic, linear = tetrahedra(size, centre, radius, height, density), ElementTetP2(), ElementTetP1()
        away = lambda x: np.sqrt(sum((x[d] - centre[d]) ** 2 for d in range(len(centre))))
        near = lambda x: (away(x) < 1.01 * radius) & (x[2] < height + 1e-6)
    velocity = Basis(mesh, ElementVector(quadratic), intorder=4)
    pressure, heat = Basis(mesh, linear, intorder=4), Basis(mesh, quadratic, intorder=4)
    nu, alpha = fluid["viscosity"], fluid["conductivity"]
    viscous = BilinearForm(lambda u, v, w: nu * ddot(grad(u), grad(v))).assemble(velocity)
    divergence = BilinearForm(lambda u, q, w: -q * div(u)).assemble(velocity, pressure)
    by_velocity = BilinearForm(lambda u, v, w: dot(mul(grad(w.w), u), v) + dot(mul(grad(u), w.w), v))
    carried = LinearForm(lambda v, w: dot(mul(grad(w.w), w.w), v))
    inflow = mesh.facets_satisfying(lambda x: np.isclose(x[0], 0))
    outflow = mesh.facets_satisfying(lambda x: np.isclose(x[0], size[0]))
    n = velocity.N
    fixed = velocity.get_dofs(np.setdiff1d(mesh.boundary_facets(), outflow)).all()
    u, p, enters = velocity.zeros(), np.zeros(pressure.N), velocity.get_dofs(inflow).all(["u^1"])
    place = velocity.doflocs[:, enters]
    formula = scene["region"]["sides"]["left"]["velocity"][0].replace("^", "**")
    u[enters] = eval(formula, {"x": place[0], "y": place[1], "z": place[2]})
    free = np.setdiff1d(np.arange(n + pressure.N), fixed)
    for step in range(12):
        w = velocity.interpolate(u)
        moved = by_velocity.assemble(velocity, w=w) if step else 0 * viscous
        matrix = sp.bmat([[viscous + moved, divergence.T], [divergence, None]], format="csr")
        rest = viscous @ u + divergence.T @ p + (carried.assemble(velocity, w=w) if step else 0)
        change = spsolve(matrix[free][:, free].tocsr(), -np.concatenate([rest, divergence @ u])[free])
        both = np.concatenate([u, p])
        both[free] += change
        u, p = both[:n], both[n:]
        if np.abs(change).max() < 1e-9:
            break
    w = velocity.interpolate(u)
    rest = viscous @ u + divergence.T @ p + carried.assemble(velocity, w=w)
    # Points at the foot of the body have what the floor beside them carries, too.
    floor = mesh.facets_satisfying(lambda x: np.isclose(x[2], 0), boundaries_only=True)
    beside = lambda element: FacetBasis(mesh, element, facets=floor, intorder=4)
    of_u, of_p, of_t = beside(ElementVector(quadratic)), beside(linear), beside(quadratic)
    push = LinearForm(lambda v, w: nu * dot(mul(grad(w["u"]), w.n), v) - w["p"] * dot(w.n, v))
    rest -= push.assemble(of_u, u=of_u.interpolate(u), p=of_p.interpolate(p))
    on_body = mesh.facets_satisfying(lambda x: near(x) & ~np.isclose(x[2], 0), boundaries_only=True)
    drag, lift = (-rest[velocity.get_dofs(on_body).all([name])].sum() for name in ("u^1", "u^3"))
    conducts = BilinearForm(lambda t, s, w: alpha * dot(grad(t), grad(s)) + dot(w.w, grad(t)) * s)
    matrix, t = conducts.assemble(heat, w=w), heat.zeros()
    cold, hot = heat.get_dofs(inflow).all(), heat.get_dofs(on_body).all()
    t[hot], t[cold] = body["temperature"], 0.0
    free = np.setdiff1d(np.arange(heat.N), np.union1d(cold, hot))
    t[free] = spsolve(matrix[free][:, free].tocsr(), -(matrix @ t)[free])
    flux = matrix @ t - LinearForm(lambda s, w: alpha * dot(grad(w["t"]), w.n) * s).assemble(of_t, t=of_t.interpolate(t))
    return mesh.t.shape[1], drag, lift, flux[hot].sum()


density, *files = sys.argv[1:]
for file in files:
    with open(file, "rb") as text:
        elements, drag, lift, given = solve(tomllib.load(text), float(density))
    print(f"{file}: {elements} elements, drag {drag:.5f}, lift {lift:.5f}, heat {given:.5f}", flush=True)
