#!/usr/bin/env python3
"""Heat that flows out of the heated channel, by finite elements with their mesh graded towards what is singular: the sharp reference.

    python3 -m venv ~/.cache/hydrograd/channel-fem
    ~/.cache/hydrograd/channel-fem/bin/pip install -r scripts/peers/requirements-channel-fem.txt
    export OMP_NUM_THREADS=1; python=~/.cache/hydrograd/channel-fem/bin/python
    $python scripts/peers/channel_fem.py converge [WALL ...]     Q on ever finer meshes, by elements of two degrees; WALL is a shape.csv, or NAME:AMPLITUDE of the old reference
    $python scripts/peers/channel_fem.py reference               data/reference/fem-sharp.csv: flat walls, and the 51 walls of data/reference/fem-shapes-H0.2.csv
    $python scripts/peers/channel_fem.py gradient                data/reference/fem-sharp-gradient.csv: dQ / d offset of the flat wall
    $python scripts/peers/channel_fem.py gain SHAPE.csv ...      the gain of walls over the flat one (columns x and offset)
    $python scripts/peers/channel_fem.py optimise [--smoothing 0.05] [--bound 0.02] [--start SHAPE.csv] [--to SHAPE.csv]     the best wall

Taylor-Hood quadrilaterals (velocity and temperature of degree k, pressure of degree k - 1; k = 2 unless --degree 3), Newton's method and a
direct solver; `level` halves every cell. The mesh is that of a rectangle, moved to y = s(x) + Y (1 - s(x) / H). All kinks of the wall s, both
ends of the hot section, the end of the inlet zone and the outlet are lines of the mesh, so elements fit the boundary exactly. Cells shrink
geometrically towards the wall, both ends of the hot section (T_hot - T grows there with the root of the distance) and the kinks.

The problem is that of data/scenes/heated-channel.toml: flow periodic in x; T = 0 for x <= 0.06, T = 0.23 on the bottom wall for 0.25 <= x <= 0.75,
no heat through other walls, no conduction beyond x = 0.94. Q is the integral of u T over the section x = 0.9, where hydrograd measures too. It is not
all of the heat: some is conducted through that section and arrives at the outlet, 0.02 % of Q over the flat wall at H = 0.2 and 0.17 % at H = 0.26.

The gradient of Q by the wall is exact: one transposed solution, and derivatives of residuals by complex steps.
"""
import argparse
import csv
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
OLD = os.path.join(ROOT, "data/reference/fem-shapes-H0.2.csv")
GRADIENT = os.path.join(ROOT, "data/reference/fem-sharp-gradient.csv")
SHARP = os.path.join(ROOT, "data/reference/fem-sharp.csv")
LENGTH, VISCOSITY, DIFFUSIVITY, FORCE = 1.0, 0.01, 7.313 / 305.27, 2.3
HOT, HOT_FROM, HOT_TO, INLET, OUTLET, SECTION = 0.23, 0.25, 0.75, 0.06, 0.94, 0.9
NODES = np.round(0.26 + 0.02 * np.arange(25), 6)


def factorised(matrix, often=False):
    """A function that solves with the matrix, once or `often`: by MKL's Pardiso if there, else by SuperLU."""
    try:
        from pypardiso import PyPardisoSolver, ps
    except ImportError:
        return scipy.sparse.linalg.splu(matrix.tocsc()).solve
    # Else each solver looks for the library in all folders of the environment, which takes half a second.
    os.environ.setdefault("PYPARDISO_MKL_RT", ps.libmkl._name)
    solver = PyPardisoSolver()
    matrix = matrix.tocsr()
    matrix.sort_indices()
    solver.factorize(matrix)

    def solve(rhs):
        found = solver.solve(matrix, rhs)
        if not often:
            solver.free_memory(everything=True)
        return found
    return solve


def kinks(nodes):
    """Corners of the wall: it is zero as far before the hot section as the first node lies behind its beginning, and likewise behind it."""
    return np.r_[2 * HOT_FROM - nodes[0], nodes, 2 * HOT_TO - nodes[-1]]


def graded(a, b, first, last, largest, ratio):
    """Lines from a to b whose distances grow by `ratio` from `first` at a and `last` at b, up to `largest`."""
    left, right, sizes = [], [], [first, last]
    while True:
        rest = b - a - sum(left) - sum(right)
        k = 0 if sizes[0] <= sizes[1] else 1
        if rest <= 1.5 * sizes[k]:
            break
        (left, right)[k].append(sizes[k])
        sizes[k] = min(ratio * sizes[k], largest)
    steps = np.array(left + [rest] + right[::-1])
    return a + np.r_[0, np.cumsum(steps)] * (b - a) / steps.sum()


def mesh(height, nodes, level, finest):
    """Lines in x and Y."""
    corner, far = 2.5e-3, 0.03
    places = {0.0: far, INLET: 5e-3, HOT_FROM: finest, HOT_TO: finest, SECTION: far, OUTLET: far, LENGTH: far}
    places.update({round(x, 9): corner for x in kinks(nodes) if round(x, 9) not in places})
    at = sorted(places)
    xs = np.unique(np.concatenate([graded(a, b, places[a], places[b], far, 4.0 if finest in (places[a], places[b]) else 2.0) for a, b in zip(at, at[1:])]))
    ys = graded(0.0, height, finest, 0.02, 0.02, 4.0)
    xs = xs[np.r_[True, np.diff(xs) > 1e-12]]
    for _ in range(level):
        xs, ys = (np.sort(np.r_[line, 0.5 * (line[1:] + line[:-1])]) for line in (xs, ys))
    return xs, ys


def one_dimension(degree, at):
    """Values and slopes of the Lagrange polynomials of evenly spaced points in 0 ... 1."""
    points = np.linspace(0, 1, degree + 1)
    value, slope = np.ones((len(at), degree + 1)), np.zeros((len(at), degree + 1))
    for j in range(degree + 1):
        basis = np.poly1d([1.0])
        for m in range(degree + 1):
            if m != j:
                basis *= np.poly1d([1.0, -points[m]]) / (points[j] - points[m])
        value[:, j], slope[:, j] = basis(at), basis.deriv()(at)
    return value, slope


def between(degree, coarse, fine):
    """The matrix that takes values at the nodes on coarse lines to those on fine ones, in one dimension."""
    part = np.linspace(0, 1, degree + 1)[:-1]
    at = np.r_[(fine[:-1, None] + np.diff(fine)[:, None] * part).ravel(), fine[-1]]
    cell = np.clip(np.searchsorted(coarse, at + 1e-13) - 1, 0, len(coarse) - 2)
    value, _ = one_dimension(degree, (at - coarse[cell]) / np.diff(coarse)[cell])
    rows = np.repeat(np.arange(len(at)), degree + 1)
    columns = (degree * cell[:, None] + np.arange(degree + 1)).ravel()
    return sp.csr_matrix((value.ravel(), (rows, columns)), (len(at), degree * (len(coarse) - 1) + 1))


class Channel:
    def __init__(self, height=0.2, nodes=NODES, level=1, degree=2, finest=1e-5):
        self.H, self.nodes, self.k = height, np.asarray(nodes, float), degree
        self.xs, self.ys = mesh(height, self.nodes, level, finest)
        nx, ny = len(self.xs) - 1, len(self.ys) - 1
        self.nx, self.ny = nx, ny
        gauss, weight = np.polynomial.legendre.leggauss(degree + 2)
        gauss, weight = 0.5 * (gauss + 1), 0.5 * weight
        self.gauss = gauss
        (n, d), (m, _) = one_dimension(degree, gauss), one_dimension(degree - 1, gauss)
        points = len(gauss) ** 2
        both = lambda a, b: np.einsum("ai,bj->abij", a, b).reshape(points, -1)
        self.phi, self.psi = both(n, n), both(m, m)
        self.d_xi, self.d_eta = both(d, n), both(n, d)
        self.weight = np.outer(weight, weight).ravel()
        self.line = (n, weight)
        ex, ey = (index.ravel() for index in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
        self.ex, self.ey = ex, ey
        self.hx, self.hy = np.diff(self.xs)[ex], np.diff(self.ys)[ey]

        def numbers(k, columns):
            local = np.arange(k + 1)
            i = (k * ex[:, None] + local) % columns
            j = k * ey[:, None] + local
            return (i[:, :, None] * (k * ny + 1) + j[:, None, :]).reshape(len(ex), -1)
        self.velocity, self.pressure = numbers(degree, degree * nx), numbers(degree - 1, (degree - 1) * nx)
        self.heat = numbers(degree, degree * nx + 1)
        self.nv, self.np, self.nt = degree * nx * (degree * ny + 1), (degree - 1) * nx * ((degree - 1) * ny + 1), (degree * nx + 1) * (degree * ny + 1)
        rows = np.arange(degree * ny + 1)
        wall = ((rows == 0) | (rows == rows[-1]))[None, :].repeat(degree * nx, 0).ravel()
        pinned = np.zeros(self.np, bool)
        pinned[0] = True
        self.free = np.where(~np.r_[wall, wall, pinned])[0]
        local = np.linspace(0, 1, degree + 1)[:-1]
        columns = np.r_[(self.xs[:-1, None] + np.diff(self.xs)[:, None] * local).ravel(), self.xs[-1]]
        self.columns = columns
        near = 1e-10
        self.heated = (self.xs[ex] >= INLET - near) & (self.xs[ex + 1] <= OUTLET + near)
        grid = np.broadcast_to(columns[:, None], (len(columns), len(rows)))
        hot = (grid >= HOT_FROM - near) & (grid <= HOT_TO + near) & (rows == 0)[None, :]
        self.hot = np.where(hot.ravel())[0]
        inside = ((grid > INLET + near) & (grid <= OUTLET + near) & ~hot).ravel()
        self.warm = np.where(inside)[0]
        self.inlet = np.where(((grid >= INLET - near) & (grid <= INLET + near)).ravel())[0]
        self.u, self.p, self.T, self.offsets = np.zeros((2, self.nv)), np.zeros(self.np), np.zeros(self.nt), None

    def geometry(self, offsets, some=slice(None)):
        """Gradients of the shape functions, and weights of the points, of some elements."""
        corner = np.r_[0, offsets, 0]
        places = kinks(self.nodes)
        middle = 0.5 * (self.xs[self.ex[some]] + self.xs[self.ex[some] + 1])
        k = np.clip(np.searchsorted(places, middle) - 1, -1, len(places) - 1)
        inside = (k >= 0) & (k < len(places) - 1)
        k = np.clip(k, 0, len(places) - 2)
        slope = np.where(inside, (corner[k + 1] - corner[k]) / (places[k + 1] - places[k]), 0)
        base = np.where(inside, corner[k], 0)
        xi, eta = (a.ravel() for a in np.meshgrid(self.gauss, self.gauss, indexing="ij"))
        hx, hy = self.hx[some, None], self.hy[some, None]
        x = self.xs[self.ex[some], None] + hx * xi
        Y = self.ys[self.ey[some], None] + hy * eta
        s = base[:, None] + slope[:, None] * (x - places[k][:, None])
        stretch = 1 - s / self.H
        gy = self.d_eta / (hy * stretch)[:, :, None]
        gx = self.d_xi / hx[:, :, None] - (slope[:, None] * (1 - Y / self.H))[:, :, None] * gy
        return gx, gy, self.weight * hx * hy * stretch

    def fields(self, g, some=slice(None)):
        gx, gy, _ = g
        u = self.u[:, self.velocity[some]]
        at = lambda b: np.einsum("eqn,cen->ceq", b, u)
        return np.einsum("qn,cen->ceq", self.phi, u), at(gx), at(gy)

    def flow_residual(self, g, some=slice(None)):
        """Local residuals of momentum (two components) and continuity."""
        gx, gy, w = g
        v, vx, vy = self.fields(g, some)
        p = self.p[self.pressure[some]] @ self.psi.T
        momentum = []
        for c in (0, 1):
            carried = v[0] * vx[c] + v[1] * vy[c] - (FORCE if c == 0 else 0.0)
            fx, fy = VISCOSITY * vx[c], VISCOSITY * vy[c]
            fx, fy = (fx - p, fy) if c == 0 else (fx, fy - p)
            momentum.append(np.einsum("eq,qn->en", w * carried, self.phi) + np.einsum("eq,eqn->en", w * fx, gx) + np.einsum("eq,eqn->en", w * fy, gy))
        return momentum[0], momentum[1], -((w * (vx[0] + vy[1])) @ self.psi)

    def heat_residual(self, g, some=slice(None)):
        gx, gy, w = g
        v, _, _ = self.fields(g, some)
        T = self.T[self.heat[some]]
        tx, ty = np.einsum("eqn,en->eq", gx, T), np.einsum("eqn,en->eq", gy, T)
        w = w * self.heated[some, None]
        return (w * (v[0] * tx + v[1] * ty)) @ self.phi + DIFFUSIVITY * (np.einsum("eq,eqn->en", w * tx, gx) + np.einsum("eq,eqn->en", w * ty, gy))

    def gathered(self, local):
        sum_of = lambda index, values, n: np.bincount(index.ravel(), values.ravel(), n)
        return np.r_[sum_of(self.velocity, local[0], self.nv), sum_of(self.velocity, local[1], self.nv), sum_of(self.pressure, local[2], self.np)]

    def flow_matrix(self, g):
        gx, gy, w = g
        v, vx, vy = self.fields(g)
        phi, psi = self.phi, self.psi
        product = lambda a, b: np.matmul(a.transpose(0, 2, 1), b)
        shape = (len(w), *phi.shape)
        all_phi = np.broadcast_to(phi, shape)
        w_ = w[:, :, None]
        carry = product(w_ * all_phi, v[0][:, :, None] * gx + v[1][:, :, None] * gy)
        same = carry + VISCOSITY * (product(w_ * gx, gx) + product(w_ * gy, gy))
        mass = lambda f: product((w * f)[:, :, None] * all_phi, all_phi)
        blocks = {(0, 0): same + mass(vx[0]), (0, 1): mass(vy[0]), (1, 0): mass(vx[1]), (1, 1): same + mass(vy[1])}
        grad = [-product(w_ * gc, np.broadcast_to(psi, (len(w), *psi.shape))) for gc in (gx, gy)]
        shift = [0, self.nv, 2 * self.nv]
        rows, columns, values = [], [], []

        def add(r, c, index_r, index_c, local):
            rows.append((shift[r] + np.broadcast_to(index_r[:, :, None], local.shape)).ravel())
            columns.append((shift[c] + np.broadcast_to(index_c[:, None, :], local.shape)).ravel())
            values.append(local.ravel())
        for (r, c), local in blocks.items():
            add(r, c, self.velocity, self.velocity, local)
        for c in (0, 1):
            add(c, 2, self.velocity, self.pressure, grad[c])
            add(2, c, self.pressure, self.velocity, grad[c].transpose(0, 2, 1))
        n = 2 * self.nv + self.np
        return sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n, n))[self.free][:, self.free]

    def heat_matrix(self, g):
        gx, gy, w = g
        v, _, _ = self.fields(g)
        w_ = (w * self.heated[:, None])[:, :, None]
        product = lambda a, b: np.matmul(a.transpose(0, 2, 1), b)
        local = product(w_ * np.broadcast_to(self.phi, gx.shape), v[0][:, :, None] * gx + v[1][:, :, None] * gy)
        local += DIFFUSIVITY * (product(w_ * gx, gx) + product(w_ * gy, gy))
        index = lambda a: np.broadcast_to(a, local.shape).ravel()
        return sp.csr_matrix((local.ravel(), (index(self.heat[:, :, None]), index(self.heat[:, None, :]))), (self.nt, self.nt))

    def begin_from(self, other):
        """Takes the flow of a coarser mesh of the same degree to begin with."""
        def taken(values, degree):
            across = between(degree, other.ys, self.ys)
            along = between(degree, other.xs, self.xs)
            grid = values.reshape(-1, degree * other.ny + 1)
            return (across @ (along @ np.r_[grid, grid[:1]]).T).T[:-1].ravel()
        self.u, self.p = np.array([taken(u, self.k) for u in other.u]), taken(other.p, self.k - 1)

    def solve(self, offsets, tolerance=3e-5):
        """Flow and temperature over a wall; starts from the last flow. After a step below the tolerance the rest is of its square."""
        self.offsets = np.asarray(offsets, float)
        g = self.geometry(self.offsets)
        for turn in range(20):
            residual = self.gathered(self.flow_residual(g))[self.free]
            step = np.zeros(2 * self.nv + self.np)
            step[self.free] = -factorised(self.flow_matrix(g))(residual)
            self.u += step[: 2 * self.nv].reshape(2, -1)
            self.p += step[2 * self.nv:]
            self.last_step = abs(step[: 2 * self.nv]).max()
            if self.last_step < tolerance:
                break
        else:
            raise RuntimeError("Newton's method does not converge")
        matrix = self.heat_matrix(g)
        self.T[:] = 0
        self.T[self.hot] = HOT
        self.T[self.warm] = factorised(matrix[self.warm][:, self.warm])(-(matrix @ self.T)[self.warm])
        reaction = matrix @ self.T
        # What the hot wall gives, and what the inlet zone takes of it, by the residual at their nodes.
        self.given, self.taken = reaction[self.hot].sum(), reaction[self.inlet].sum()
        return self.outflow()

    def at(self, x):
        """Integrals of u T and of u over a section outside of the shaped part; and the derivatives of the first by u and T."""
        i = int(np.argmin(abs(self.columns - x)))
        n, weight = self.line
        rows = self.k * np.arange(self.ny)[:, None] + np.arange(self.k + 1)
        place = i * (self.k * self.ny + 1) + rows
        u, T = self.u[0][place % self.nv] @ n.T, self.T[place] @ n.T
        w = np.diff(self.ys)[:, None] * weight
        by_u, by_T = np.bincount((place % self.nv).ravel(), ((w * T) @ n).ravel(), self.nv), np.bincount(place.ravel(), ((w * u) @ n).ravel(), self.nt)
        return (w * u * T).sum(), (w * u).sum(), by_u, by_T

    def outflow(self):
        return self.at(SECTION)[0]

    def gradient(self):
        """Of Q by the offsets."""
        g = self.geometry(self.offsets)
        gx, gy, w = g
        _, _, by_u, by_T = self.at(SECTION)
        heat = np.zeros(self.nt)
        matrix = self.heat_matrix(g)[self.warm][:, self.warm]
        heat[self.warm] = factorised(matrix.T.tocsr())(by_T[self.warm])
        T, l = self.T[self.heat], heat[self.heat] @ self.phi.T
        w = w * self.heated[:, None]
        rhs = np.zeros(2 * self.nv + self.np)
        for c, gc in enumerate((gx, gy)):
            rhs[c * self.nv: (c + 1) * self.nv] = -np.bincount(self.velocity.ravel(), ((w * l * np.einsum("eqn,en->eq", gc, T)) @ self.phi).ravel(), self.nv)
        rhs[: self.nv] += by_u
        flow = np.zeros(len(rhs))
        flow[self.free] = factorised(self.flow_matrix(g).T.tocsr())(rhs[self.free])
        out, places = np.zeros(len(self.nodes)), kinks(self.nodes)
        lu, lv, lp = flow[: self.nv], flow[self.nv: 2 * self.nv], flow[2 * self.nv:]
        for k in range(len(out)):
            some = np.where((self.xs[self.ex] >= places[k] - 1e-10) & (self.xs[self.ex + 1] <= places[k + 2] + 1e-10))[0]
            moved = self.offsets.astype(complex)
            moved[k] += 1e-30j
            g = self.geometry(moved, some)
            a, b, c = self.flow_residual(g, some)
            total = (a * lu[self.velocity[some]]).sum() + (b * lv[self.velocity[some]]).sum() + (c * lp[self.pressure[some]]).sum()
            out[k] = -(total + (self.heat_residual(g, some) * heat[self.heat[some]]).sum()).imag / 1e-30
        return out


def read_wall(path):
    """Nodes and offsets of a CSV file, or of `name:amplitude` of the old reference."""
    if ":" in path:
        name, amplitude = path.split(":")
        with open(OLD) as file:
            row = next(row for row in csv.DictReader(file) if row["shape"] == name and float(row["A"]) == float(amplitude))
        return NODES, np.array([float(row[f"o{k}"]) for k in range(25)])
    with open(path) as file:
        rows = list(csv.DictReader(file))
    return np.array([float(row["x"]) for row in rows]), np.array([float(row["offset"]) for row in rows])


def converge(options):
    """Q on ever finer meshes, and by elements of a higher degree."""
    cases = [("flat, H 0.2", 0.2, NODES, 0 * NODES), ("flat, H 0.26", 0.26, NODES, 0 * NODES)]
    cases += [(wall, 0.2, *read_wall(wall)) for wall in options.walls]
    for name, height, nodes, offsets in cases:
        print(name, flush=True)
        for degree, level in ((2, 0), (2, 1), (2, 2), (3, 0))[: 4 if options.thorough else 2]:
            clock = time.monotonic()
            channel = Channel(height, nodes, level, degree)
            q = channel.solve(offsets)
            print(f"  degree {degree}, {channel.nx:3d} x {channel.ny:2d} cells: Q {q:.8f}, at the outlet {channel.at(OUTLET)[0]:.8f}, by hot wall and inlet {channel.given + channel.taken:.8f}, "
                  f"flow rate {channel.at(SECTION)[1]:.7f}, {time.monotonic() - clock:.1f} s", flush=True)


def reference(options):
    """Flat walls and the walls of the old reference, on two meshes. Goes on where it was stopped."""
    with open(OLD) as file:
        walls = [(row["shape"], row["A"], 0.2, np.array([float(row[f"o{k}"]) for k in range(25)]), float(row["Q"])) for row in csv.DictReader(file)]
    walls.insert(1, ("flat", "0", 0.26, 0 * NODES, 0.02860))
    meshes = {}
    done = []
    if os.path.exists(SHARP + ".part"):
        with open(SHARP + ".part") as file:
            done = [row[:3] for row in csv.reader(file)][1:]
    with open(SHARP + ".part", "a", newline="\n") as file:
        if not done:
            print("shape,A,H,Q,error,heat_at_outlet,flow_rate,old_Q_off", file=file, flush=True)
        for name, amplitude, height, offsets, old in walls:
            if [name, amplitude, str(height)] in done:
                continue
            q = []
            for level in (0, 1):
                if (height, level) not in meshes:
                    meshes[height, level] = Channel(height, NODES, level)
                channel = meshes[height, level]
                if level > 0:
                    channel.begin_from(meshes[height, level - 1])
                q.append(channel.solve(offsets))
            line = f"{name},{amplitude},{height},{q[1]:.8f},{abs(q[1] - q[0]):.1e},{channel.at(OUTLET)[0]:.8f},{channel.at(SECTION)[1]:.7f},{old / q[1] - 1:+.1e}"
            print(line, file=file, flush=True)
            print(line, flush=True)
    os.replace(SHARP + ".part", SHARP)


def gradient(options):
    """The derivative of Q by the offset of each node of the flat wall at H = 0.2, on two meshes."""
    coarse, fine = Channel(0.2, NODES, 0), Channel(0.2, NODES, 1)
    found = []
    for channel in (coarse, fine):
        channel.solve(0 * NODES)
        found.append(channel.gradient())
    with open(GRADIENT, "w", newline="\n") as file:
        print("x,dQ_d_offset,error", file=file)
        for x, a, b in zip(NODES, *found):
            print(f"{x:.2f},{b:.4e},{abs(b - a):.0e}", file=file)


def gain(options):
    """Of walls over the flat one on the same mesh."""
    for wall in options.walls:
        nodes, offsets = read_wall(wall)
        for level in (0, 1):
            channel = Channel(options.height, nodes, level)
            flat, q = channel.solve(0 * offsets), channel.solve(offsets)
            print(f"{wall}: level {level}: Q {flat:.8f} -> {q:.8f} ({100 * (q / flat - 1):+.3f} %)", flush=True)


def optimise(options):
    """The best wall: L-BFGS-B with the exact gradient, and what hydrograd optimize makes small, -Q + smoothing * sum of (o[k + 1] - o[k])^2."""
    from scipy.optimize import minimize

    nodes, start = read_wall(options.start) if options.start else (NODES, 0 * NODES)
    channel = Channel(options.height, nodes, options.level)
    flat = channel.solve(0 * start)
    state = channel.u.copy(), channel.p.copy()

    def loss(offsets):
        q = channel.solve(offsets)
        steps = np.diff(offsets)
        bend = np.r_[0, steps] - np.r_[steps, 0]
        print(f"  {100 * (q / flat - 1):+.4f} %", flush=True)
        return (-q + options.smoothing * (steps ** 2).sum()) / flat, (-channel.gradient() + 2 * options.smoothing * bend) / flat

    limit = [(-options.bound, options.bound)] * len(nodes)
    found = minimize(loss, np.clip(start, -options.bound, options.bound), jac=True, method="L-BFGS-B", bounds=limit, options={"maxiter": options.epochs, "ftol": 1e-8, "gtol": 1e-7})
    q = channel.solve(found.x)
    print(f"smoothing {options.smoothing}, bound {options.bound}: Q {flat:.8f} -> {q:.8f} ({100 * (q / flat - 1):+.3f} %), {found.nfev} solutions: {found.message}")
    print(" ".join(f"{o:.4f}" for o in found.x))
    if options.to:
        with open(options.to, "w", newline="\n") as file:
            print("x,offset", file=file)
            for x, o in zip(nodes, found.x):
                print(f"{x:.6g},{o:.6f}", file=file)


def check(options):
    """The gradient against central differences."""
    channel, rng = Channel(0.2, NODES, 0), np.random.default_rng(1)
    wall, way = rng.uniform(-0.01, 0.01, 25), rng.standard_normal(25)
    channel.solve(wall, 1e-10)
    ours = channel.gradient() @ way
    h = 1e-5
    theirs = (channel.solve(wall + h * way, 1e-10) - channel.solve(wall - h * way, 1e-10)) / (2 * h)
    print(f"along a random way: {ours:.9e}, by differences {theirs:.9e} ({ours / theirs - 1:+.1e})")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    jobs = {of.__name__: of for of in (converge, reference, gradient, gain, optimise, check)}
    parser.add_argument("what", choices=jobs)
    parser.add_argument("walls", nargs="*")
    parser.add_argument("--thorough", action="store_true", help="converge: one more mesh, and cubic elements")
    parser.add_argument("--height", type=float, default=0.2)
    parser.add_argument("--level", type=int, default=0)
    parser.add_argument("--smoothing", type=float, default=0.05)
    parser.add_argument("--bound", type=float, default=0.02)
    parser.add_argument("--epochs", type=int, default=60)
    parser.add_argument("--start")
    parser.add_argument("--to")
    options = parser.parse_args()
    jobs[options.what](options)


if __name__ == "__main__":
    main()
