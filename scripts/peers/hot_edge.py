#!/usr/bin/env python3
"""Where the edge of a hot wall acts on the lattice of fixed particles if the wall slopes there: conduction alone, beside finite elements.

    python=~/.cache/hydrograd/channel-fem/bin/python                 made as in channel_fem.py, and scikit-fem
    $python scripts/peers/hot_edge.py                                a line for each slope and length of a ramp
    $python scripts/peers/hot_edge.py --place 0 --vertices           the edge in the middle of a cell; columns whose heights are those of the wall
    $python scripts/peers/hot_edge.py --first-row                    conormal derivatives from the first row instead of the wall
    $python scripts/peers/hot_edge.py --columns                      what a height of each column changes: the linear part, column by column

A channel of height 1, cold above, adiabatic below for x < 0 and hot for x > 0, without flow. Its bottom is flat but for a ramp of slope S from -R to
R spacings around the edge. The equations are those of src/sph/fixed: the weights of second derivatives, the ghosts and the metric of the map, and the
hot share of the edge's cell (channel.rs, EDGE). Printed is by how many spacings the edge seems to be further out (the heat is larger by as much as a
hot wall that is longer by that), less what it is over a level wall. Finite elements have degree 2 on a mesh that is graded towards the edge and the
kinks; over a level wall the heat above that of an endless hot wall is 2 ln 2 / pi, but for 0.5 % that the ends of the box cost.
"""
import argparse

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as linear
import skfem
from skfem.helpers import dot, grad

# Rows from wall to wall, and heights of the channel to either side of the edge.
ROWS, REACH = 16, 4
EDGE = [0.6845, 0.5464, 0.4288, 0.3275, 0.2395, 0.1622, 0.0938, 0.0328, -0.0219, -0.0711, -0.1159, -0.1566, -0.1938, -0.2280, -0.2595, -0.2886, -0.3155]
DX, EDGE_COLUMN, COLUMNS = 1 / ROWS, REACH * ROWS, 2 * REACH * ROWS


def weights():
    """l_xx, l_yy, l_xy by offset (src/sph/fixed/stencil.rs, times dx^2), and the kernel's derivative of a line."""
    offsets = [(i, j) for j in range(-2, 3) for i in range(-2, 3) if (i, j) != (0, 0)]
    spline = lambda q: sum(c * np.maximum(0, k - q) ** 4 for c, k in ((1, 3), (-6, 2), (15, 1)))
    f = {o: spline(np.hypot(*o)) / np.hypot(*o) for o in offsets}
    q = {o: f[o] / (o[0] ** 2 + o[1] ** 2) for o in offsets}
    same, cross = sum(q[o] * o[0] ** 4 for o in offsets), sum(q[o] * (o[0] * o[1]) ** 2 for o in offsets)
    a, b = 2 * same / (same**2 - cross**2), -2 * cross / (same**2 - cross**2)
    second = {(i, j): (0.5 * q[i, j] * (a * i * i + b * j * j), 0.5 * q[i, j] * (a * j * j + b * i * i), q[i, j] * i * j / cross) for i, j in offsets}
    moment = sum(f[o] * o[0] ** 2 for o in offsets)
    return second, [sum(f[o] * o[0] / moment for o in offsets if o[0] == i) for i in range(-2, 3)]


SECOND, DERIVATIVE = weights()


def on_lattice(place, heights, on_wall):
    """Heat above that of an endless hot wall, over bottom heights of the columns; the edge is `place` spacings behind the middle of its cell."""
    share = float(np.interp(-place, [-x for x in EDGE], np.linspace(0, 1, 17)))
    columns = np.arange(COLUMNS)
    hot = np.where(columns > EDGE_COLUMN, 1.0, np.where(columns == EDGE_COLUMN, share, 0.0))
    padded = np.pad(heights, 2, mode="edge")
    slope = sum(w * padded[k : k + COLUMNS] for k, w in enumerate(DERIVATIVE)) / DX
    stretch = 1 - heights
    lean = stretch * slope / (1 + slope**2)
    within = lambda of, i: of[np.clip(i, 0, COLUMNS - 1)]

    def value(i, j):
        """T of columns i in row j: pairs (weights, columns, row), and a constant."""
        pairs, constant = [], np.zeros(COLUMNS)

        def add(weight, i, j):
            nonlocal constant
            more, const = value(i, j)
            pairs.extend((weight * w, a, b) for w, a, b in more)
            constant = constant + weight * const

        if 0 <= j < ROWS:
            inside = (i >= 0) & (i < COLUMNS)
            outside = np.where(i < 0, 0.0, 1 - (j + 0.5) * DX)
            return [(1.0 * inside, np.clip(i, 0, COLUMNS - 1), j)], np.where(inside, 0.0, outside)
        near, far = (ROWS - 1, ROWS - 2) if j >= ROWS else (0, 1)
        k = j - ROWS if j >= ROWS else -1 - j
        h = np.ones(COLUMNS) if j >= ROWS else np.where(i < 0, 0.0, within(hot, i))
        of_near, of_far, given = ((-2, 1 / 3, 8 / 3), (-9, 2, 8))[k]
        own = (1 - h) * (1, 0)[k], (1 - h) * (0, 1)[k]
        add(of_near * h + own[0], i, near)
        add(of_far * h + own[1], i, far)
        if j < 0:
            constant = constant + given * h
            cold = lambda i: np.clip(0.5 + place - (i - EDGE_COLUMN), 0, 1)
            side = lambda other: 0.25 * (cold(i) + cold(other)) * cold(i)
            factor = -(1, 3)[k] * np.where((i >= 0) & (i < COLUMNS), within(lean, i), 0.0)
            for row, part in enumerate(on_wall):
                for other, weight in ((i - 1, -side(i - 1)), (i, side(i - 1) - side(i + 1)), (i + 1, side(i + 1))):
                    add(part * factor * weight, other, row)
        return pairs, constant

    rows, cols, numbers = [], [], []
    right, above, rest = np.zeros(COLUMNS * ROWS), np.zeros(COLUMNS * ROWS), 0.0
    # Beyond this column the heat is that of an endless hot wall.
    counted = 1.0 * (columns < COLUMNS - ROWS)
    metric = lambda j: (slope * (1 - (j + 0.5) * DX), (1 + (slope * (1 - (j + 0.5) * DX)) ** 2) / stretch)
    for j in range(ROWS):
        here = j * COLUMNS + columns
        lean_here, normal_here = metric(j)
        for (di, dj), (xx, yy, xy) in SECOND.items():
            i = columns + di
            lean_there, normal_there = metric(j + dj)
            omega = xx * (stretch + within(stretch, i)) + yy * (normal_here + within(normal_there, i)) - xy * (lean_here + within(lean_there, i))
            pairs, constant = value(i, j + dj)
            for w, a, b in pairs:
                rows.append(here), cols.append(b * COLUMNS + a), numbers.append(omega * w)
                if j + dj >= ROWS:
                    np.add.at(above, b * COLUMNS + a, omega * w * counted)
            rows.append(here), cols.append(here), numbers.append(-omega)
            right[here] -= omega * constant
            if j + dj >= ROWS:
                rest += (omega * constant * counted).sum()
                above[here] -= omega * counted
    matrix = sp.csc_matrix((np.concatenate(numbers), (np.concatenate(rows), np.concatenate(cols))), shape=(COLUMNS * ROWS,) * 2)
    heat = -(above @ linear.spsolve(matrix, right) + rest)
    return heat - (COLUMNS - ROWS - EDGE_COLUMN - 0.5 - place) * DX


def finite_elements(wall, kinks):
    """The same by finite elements over the wall itself."""
    graded = np.concatenate([[0], np.geomspace(1e-6, 0.03, 34)])
    x = np.unique(np.round(np.concatenate([np.linspace(-3, 3, 97), [-REACH, REACH]] + [k + s * graded for k in (0, *kinks) for s in (1, -1)]), 9))
    x = x[np.concatenate([[True], np.diff(x) > 5e-7])]
    for kink in (0, *kinks):
        x[np.argmin(abs(x - kink))] = kink
    y = np.concatenate([[0], np.geomspace(1e-6, 0.3, 46), np.linspace(0.3, 1, 10)[1:]])
    mesh = skfem.MeshQuad.init_tensor(x, y)
    points = mesh.p.copy()
    points[1] += wall(points[0]) * (1 - points[1])
    basis = skfem.Basis(skfem.MeshQuad(points, mesh.t), skfem.ElementQuad2())
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    x, y = basis.doflocs
    top, left, right = abs(y - 1) < 1e-9, abs(x + REACH) < 1e-9, abs(x - REACH) < 1e-9
    hot = (abs(y - wall(x)) < 1e-9) & (x >= -1e-10)
    t = np.where(hot, 1.0, np.where(right, 1 - y, 0.0))
    t = skfem.solve(*skfem.condense(matrix, x=t, D=np.where(top | left | right | hot)[0]))
    return -(matrix @ t)[top].sum() - REACH


def heights_of(wall, kinks, place, keeps_area):
    """Heights of the columns, of the wall or of the polygon that keeps its area (src/design/parametrisations/column_averages.rs)."""
    x = (np.arange(COLUMNS) - EDGE_COLUMN - place) * DX
    heights = wall(x)
    for kink, turn in kinks if keeps_area else ():
        k = int(np.floor((kink - x[0]) / DX))
        t = (kink - x[k]) / DX
        area = -turn * DX * t * (1 - t) / 2
        heights[k] += area * (2 - t) / 3
        heights[k + 1] += area * (1 + t) / 3
    return heights


def columns(place, on_wall):
    """The change of the place by a height of each column, less that of the exact heat for a hat of this height: dQ/dh = 1/(1 - exp(-pi x))."""
    logarithm = lambda a: a * np.log(abs(a)) if abs(a) > 1e-12 else 0.0
    for k in range(-7, 9):
        heights = np.zeros(COLUMNS)
        heights[EDGE_COLUMN + k] = 0.01 * DX
        change = (on_lattice(place, heights, on_wall) - on_lattice(place, -heights, on_wall)) / (0.02 * DX)
        a = k - place
        x = np.linspace(a - 1, a + 1, 400) * DX
        smooth = (1 / (1 - np.exp(-np.pi * x)) - 1 / (np.pi * x)) * np.maximum(0, 1 - abs(x / DX - a))
        exact = (logarithm(a + 1) - 2 * logarithm(a) + logarithm(a - 1)) / np.pi + np.trapezoid(smooth, x)
        print(f"column {a:+.2f}: {change:+.4f}, exact {exact:+.4f}, more {change - exact:+.4f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--place", type=float, default=0.5, help="of the edge, in spacings behind the middle of its cell: -0.31 to 0.5 (as in scenes where dx fits)")
    parser.add_argument("--first-row", action="store_true")
    parser.add_argument("--vertices", action="store_true")
    parser.add_argument("--columns", action="store_true")
    options = parser.parse_args()
    on_wall = (1.0, 0.0) if options.first_row else (1.5, -0.5)
    if options.columns:
        return columns(options.place, on_wall)
    level = on_lattice(options.place, np.zeros(COLUMNS), on_wall) - finite_elements(lambda x: 0 * x, ())
    slopes = (0.25, -0.25, 0.5, -0.5, 1, -1)
    print("spacings to either side, and the slope: " + " ".join(f"{s:>7}" for s in slopes))
    for reach in (1, 2, 3, 4):
        found = []
        for slope in slopes:
            end = reach * DX
            wall = lambda x: slope * (np.clip(x, -end, end) - end)
            heights = heights_of(wall, ((-end, slope), (end, -slope)), options.place, not options.vertices)
            found.append((on_lattice(options.place, heights, on_wall) - finite_elements(wall, (-end, end)) - level) * ROWS)
        print(f"{reach:39d} " + " ".join(f"{x:+7.3f}" for x in found), flush=True)


if __name__ == "__main__":
    main()
