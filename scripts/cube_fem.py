#!/usr/bin/env python3
"""Drag and heat of the hot block of a scene like data/scenes/examples/cube.toml by finite elements of Taylor and Hood on bricks.

    python3 scripts/cube_fem.py 12 data/scenes/examples/cube.toml runs/optimize-cube/best.toml

The first number is that of bricks along a length of 1. Needs numpy, scipy, scikit-fem and pypardiso (12 bricks: 85,000 unknowns, two minutes,
3 GB). Drag and heat are those that the discrete equations have at the block's points. Bricks are finer towards its edges.
"""
import sys
import tomllib

import numpy as np
import scipy.sparse as sp
from pypardiso import spsolve
from skfem import Basis, BilinearForm, ElementHex1, ElementHex2, ElementVector, LinearForm, MeshHex
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


def solve(scene, density):
    size, fluid, block = scene["region"]["size"], scene["fluid"], scene["shapes"][0]
    low, high = np.array(block["lower"]), np.array(block["upper"])
    marks = [[x for x in pair if 0 < x < length] for pair, length in zip(zip(low, high), size)]
    mesh = MeshHex.init_tensor(*(axis(size[d], marks[d], density * (0.8 if d == 0 else 1)) for d in range(3)))
    middle = mesh.p[:, mesh.t].mean(1)
    mesh = mesh.remove_elements(np.nonzero(np.all((middle.T > low) & (middle.T < high), axis=1))[0])
    velocity = Basis(mesh, ElementVector(ElementHex2()), intorder=4)
    pressure, heat = Basis(mesh, ElementHex1(), intorder=4), Basis(mesh, ElementHex2(), intorder=4)
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
    near = lambda x: np.all([(x[d] > low[d] - 1e-9) & (x[d] < high[d] + 1e-9) for d in range(3)], axis=0)
    on_block = mesh.facets_satisfying(lambda x: near(x) & ~np.isclose(x[2], 0), boundaries_only=True)
    drag = -rest[velocity.get_dofs(on_block).all(["u^1"])].sum()
    conducts = BilinearForm(lambda t, s, w: alpha * dot(grad(t), grad(s)) + dot(w.w, grad(t)) * s)
    matrix, t = conducts.assemble(heat, w=w), heat.zeros()
    cold, hot = heat.get_dofs(inflow).all(), heat.get_dofs(on_block).all()
    t[hot], t[cold] = block["temperature"], 0.0
    free = np.setdiff1d(np.arange(heat.N), np.union1d(cold, hot))
    t[free] = spsolve(matrix[free][:, free].tocsr(), -(matrix @ t)[free])
    return mesh.t.shape[1], drag, (matrix @ t)[hot].sum()


density, *files = sys.argv[1:]
for file in files:
    with open(file, "rb") as text:
        bricks, drag, given = solve(tomllib.load(text), float(density))
    print(f"{file}: {bricks} bricks, drag {drag:.5f}, heat {given:.5f}", flush=True)
