#!/usr/bin/env python3
"""Velocity on the centre lines of the lid-driven cavity at Re = 100 by finite differences: data/reference/lid-driven-cavity.csv.

    python3 scripts/lid_driven_cavity.py > data/reference/lid-driven-cavity.csv

Steady stream function and vorticity, second-order differences on 128 and 256 cells a side (Thom's formula on the walls),
Newton's method with sparse LU, extrapolated (Richardson). Needs numpy and scipy. Ghia, Ghia and Shin (1982), 128 cells and first
order on the walls, are 1.4 to 3.3 % lower at the extrema.
"""
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as la

RE = 100.0


def cavity(n):
    """u on x = 1/2 and v on y = 1/2 at the n + 1 grid lines."""
    h, m = 1.0 / n, n + 1
    N = m * m
    I, J = np.meshgrid(np.arange(m), np.arange(m), indexing="ij")  # x, y
    at = lambda i, j: i * m + j
    inner = (I > 0) & (I < n) & (J > 0) & (J < n)
    i, j = I[inner], J[inner]
    k = at(i, j)
    ones = np.ones(len(k))
    matrix = lambda columns: sum(sp.coo_matrix((c * ones, (k, col)), shape=(N, N)) for col, c in columns).tocsr()
    lap = matrix([(at(i + 1, j), 1 / h**2), (at(i - 1, j), 1 / h**2), (at(i, j + 1), 1 / h**2), (at(i, j - 1), 1 / h**2), (k, -4 / h**2)])
    dx = matrix([(at(i + 1, j), 0.5 / h), (at(i - 1, j), -0.5 / h)])
    dy = matrix([(at(i, j + 1), 0.5 / h), (at(i, j - 1), -0.5 / h)])
    wall = ~inner.ravel()
    W = sp.diags(wall.astype(float))
    D = sp.diags((~wall).astype(float))
    # Thom: omega on a wall from the stream function next to it and the wall's velocity.
    rows, cols, shift = [], [], np.zeros(N)
    for a in range(1, n):
        for w, q, u in [((0, a), (1, a), 0), ((n, a), (n - 1, a), 0), ((a, 0), (a, 1), 0), ((a, n), (a, n - 1), 1.0)]:
            rows.append(at(*w)), cols.append(at(*q))
            shift[at(*w)] = -2 * u / h
    thom = sp.coo_matrix((np.full(len(rows), -2 / h**2), (rows, cols)), shape=(N, N)).tocsr()
    psi, omega = np.zeros(N), np.zeros(N)
    for _ in range(30):
        f1 = lap @ psi + D @ omega + W @ psi
        u, v = dy @ psi, -(dx @ psi)
        f2 = lap @ omega / RE - u * (dx @ omega) - v * (dy @ omega) + W @ omega - thom @ psi - shift
        jac = sp.bmat(
            [
                [lap + W, D],
                [-sp.diags(dx @ omega) @ dy + sp.diags(dy @ omega) @ dx - thom, lap / RE - sp.diags(u) @ dx - sp.diags(v) @ dy + W],
            ]
        ).tocsc()
        step = la.splu(jac).solve(np.concatenate([f1, f2]))
        psi, omega = psi - step[:N], omega - step[N:]
        if np.abs(step).max() < 1e-11:
            break
    u, v = (dy @ psi).reshape(m, m), (-(dx @ psi)).reshape(m, m)
    u[:, n] = 1.0
    return u[n // 2], v[:, n // 2]


(u1, v1), (u2, v2) = cavity(128), cavity(256)
u, v = (4 * u2[::2] - u1) / 3, (4 * v2[::2] - v1) / 3
print("# Lid-driven cavity, Re = 100: u on x = 1/2, v on y = 1/2; scripts/lid_driven_cavity.py")
print("s,u,v")
for k in range(0, 129):
    print("%.7f,%.7f,%.7f" % (k / 128, u[k], v[k]))
