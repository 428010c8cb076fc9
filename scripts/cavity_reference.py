"""Steady flow in a cubic lid-driven cavity by finite differences: the reference of tests/flows.rs.

Staggered grid, second-order central differences, explicit steps, exact projection (the pressure's matrix is diagonal in
cosines). Prints u on the vertical and v on the horizontal line through the centre, and with `square` the same for a cavity
without walls in front and behind, which is Ghia, Ghia and Shin's (1982).

    python3 scripts/cavity_reference.py [cells a side] [square]
"""
import sys

import numpy as np

RE, END = 100.0, 20.0


def solve(n, square):
    h, nu = 1.0 / n, 1.0 / RE
    m = 4 if square else n  # cells in z; a square cavity is periodic there
    dt = min(0.2 * h, 0.12 * h * h / nu)
    # Faces with ghosts: u[0..n] in x; one ghost cell on both sides of the other directions.
    u, v, w = np.zeros((n + 1, n + 2, m + 2)), np.zeros((n + 2, n + 1, m + 2)), np.zeros((n + 2, n + 2, m + 1))

    def ghosts():
        u[:, 0], u[:, -1] = -u[:, 1], 2.0 - u[:, -2]
        v[0], v[-1] = -v[1], -v[-2]
        w[0], w[-1] = -w[1], -w[-2]
        w[:, 0], w[:, -1] = -w[:, 1], -w[:, -2]
        if square:
            u[..., 0], u[..., -1], v[..., 0], v[..., -1] = u[..., -2], u[..., 1], v[..., -2], v[..., 1]
            w[..., 0] = w[..., -1]
        else:
            u[..., 0], u[..., -1], v[..., 0], v[..., -1] = -u[..., 1], -u[..., -2], -v[..., 1], -v[..., -2]

    def cosines(n, periodic=False):
        lap = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        if periodic:
            lap[0, -1] = lap[-1, 0] = -1
        else:
            lap[0, 0] = lap[-1, -1] = 1
        return np.linalg.eigh(lap)

    (ex, qx), (ez, qz) = cosines(n), cosines(m, square)
    eigen = (ex[:, None, None] + ex[None, :, None] + ez) / h**2
    eigen.flat[np.argmin(eigen)] = np.inf

    def laplace(f):
        c = f[1:-1, 1:-1, 1:-1]
        return (f[2:, 1:-1, 1:-1] + f[:-2, 1:-1, 1:-1] + f[1:-1, 2:, 1:-1] + f[1:-1, :-2, 1:-1]
                + f[1:-1, 1:-1, 2:] + f[1:-1, 1:-1, :-2] - 6 * c) / h**2

    def along(f, d):
        a, b = [slice(None)] * 3, [slice(None)] * 3
        a[d], b[d] = slice(1, None), slice(None, -1)
        return f[tuple(a)], f[tuple(b)]

    mean = lambda f, d: 0.5 * sum(along(f, d))
    diff = lambda f, d: (along(f, d)[0] - along(f, d)[1]) / h
    i = slice(1, -1)
    for _ in range(int(END / dt)):
        ghosts()
        uu = diff(mean(u, 0) ** 2, 0)[:, i, i] + diff(mean(v, 0) * mean(u, 1), 1)[i, :, i] + diff(mean(w, 0) * mean(u, 2), 2)[i, i]
        vv = diff(mean(v, 1) ** 2, 1)[i, :, i] + diff(mean(u, 1) * mean(v, 0), 0)[:, i, i] + diff(mean(w, 1) * mean(v, 2), 2)[i, i]
        new_u, new_v = u[i, i, i] + dt * (nu * laplace(u) - uu), v[i, i, i] + dt * (nu * laplace(v) - vv)
        if not square:
            ww = diff(mean(w, 2) ** 2, 2)[i, i] + diff(mean(u, 2) * mean(w, 0), 0)[:, i, i] + diff(mean(v, 2) * mean(w, 1), 1)[i, :, i]
            w[i, i, i] += dt * (nu * laplace(w) - ww)
        u[i, i, i], v[i, i, i] = new_u, new_v
        div = diff(u, 0)[:, i, i] + diff(v, 1)[i, :, i] + diff(w, 2)[i, i]
        p = np.einsum("ia,jb,kc,ijk->abc", qx, qx, qz, div, optimize=True) / -eigen
        p = np.einsum("ia,jb,kc,abc->ijk", qx, qx, qz, p, optimize=True)
        u[i, i, i] -= diff(p, 0)
        v[i, i, i] -= diff(p, 1)
        if not square:
            w[i, i, i] -= diff(p, 2)
    ghosts()
    k, middle = m // 2, n // 2
    # n is even: faces stand on the middle planes in their own direction, the others half a cell beside.
    down = 0.5 * (u[middle, 1:-1, k] + u[middle, 1:-1, k + 1])
    across = 0.5 * (v[1:-1, middle, k] + v[1:-1, middle, k + 1])
    return (np.arange(n) + 0.5) * h, down, across


if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 48
    place, u, v = solve(n, "square" in sys.argv)
    for at in (0.1719, 0.2813, 0.4531, 0.5, 0.7344):
        print(f"u(0.5, {at}) = {np.interp(at, place, u):.5f}")
    for at in (0.1563, 0.2344, 0.5, 0.8047, 0.8594):
        print(f"v({at}, 0.5) = {np.interp(at, place, v):.5f}")
