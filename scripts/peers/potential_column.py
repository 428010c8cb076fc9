"""The front of a collapsing column of an inviscid fluid, released at once: potential flow, to compare with `hydrograd simulate dam-break`.

    python scripts/peers/potential_column.py [PANELS TIME_STEP]      (numpy, scipy)

The column is one long and two high, beside a wall, gravity 1. The potential is that of sources on the free surface, in straight panels, with
images in the wall and the floor (Hess and Smith 1967); nodes follow the fluid, with Bernoulli's equation for their potential (Longuet-Higgins
and Cokelet 1976). The surface is divided anew after every step, finer towards the front, and smoothed after every third one as by them. Prints
T = t sqrt(2 g / a), the front over a, and the area, which should stay 2. It ends where the jet at the floor has become thinner than a few panels.
"""

import sys

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

TIMES = (0.2, 0.4, 0.6, 0.832, 1.0, 1.219, 1.4)


def influence(points, nodes):
    """Potential and velocity at points by unit sources on the panels and their images; on a panel itself the limit from its right."""
    potential = velocity_x = velocity_y = 0
    for mirror in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        ends = nodes * np.array(mirror)
        begin, along = ends[:-1], np.diff(ends, axis=0)
        length = np.hypot(*along.T)
        tangent = along / length[:, None]
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1)
        away = points[:, None] - begin[None]
        x, y = (away * tangent).sum(-1), (away * normal).sum(-1)
        angle = np.arctan2(y * length, x * (x - length) + y * y)
        angle = np.where((np.abs(y) < 1e-12) & (x > 0) & (x < length), np.pi, angle)
        near, far = x * x + y * y + 1e-300, (x - length) ** 2 + y * y + 1e-300
        potential = potential + 0.5 * (x * np.log(near) - (x - length) * np.log(far)) - length + y * angle
        parallel = 0.5 * np.log(near / far)
        velocity_x = velocity_x + parallel * tangent[:, 0] + angle * normal[:, 0]
        velocity_y = velocity_y + parallel * tangent[:, 1] + angle * normal[:, 1]
    return [part / (2 * np.pi) for part in (potential, velocity_x, velocity_y)]


def velocity(nodes, potential):
    """Velocity of the nodes of the surface, from the floor to the wall: the fluid is on the left."""
    points = 0.5 * (nodes[1:] + nodes[:-1])
    matrix, by_x, by_y = influence(points, nodes)
    sources = np.linalg.solve(matrix, 0.5 * (potential[1:] + potential[:-1]))
    along = np.diff(nodes, axis=0)
    length = np.hypot(*along.T)
    normal = np.stack([along[:, 1], -along[:, 0]], 1) / length[:, None]
    found = np.stack([by_x @ sources, by_y @ sources], 1) - sources[:, None] * normal
    arc = np.concatenate([[0], np.cumsum(length)])
    middle = 0.5 * (arc[1:] + arc[:-1])
    # Beyond both ends are the images.
    places = np.concatenate([-middle[:3][::-1], middle, 2 * arc[-1] - middle[-3:][::-1]])
    x = np.concatenate([found[:3, 0][::-1], found[:, 0], -found[-3:, 0][::-1]])
    y = np.concatenate([-found[:3, 1][::-1], found[:, 1], found[-3:, 1][::-1]])
    at_nodes = np.stack([CubicSpline(places, x)(arc), CubicSpline(places, y)(arc)], 1)
    at_nodes[0, 1] = at_nodes[-1, 0] = 0
    return at_nodes


def rates(nodes, potential):
    u = velocity(nodes, potential)
    return u, 0.5 * (u**2).sum(1) - nodes[:, 1]


def divided(nodes, potential, panels):
    arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(nodes, axis=0).T))])
    share = np.linspace(0, 1, panels + 1)
    places = arc[-1] * (0.5 * share + 0.5 * share**2)
    new = np.stack([PchipInterpolator(arc, nodes[:, k])(places) for k in (0, 1)], 1)
    new[0, 1] = new[-1, 0] = 0
    return new, PchipInterpolator(arc, potential)(places)


def smooth(values):
    old = values.copy()
    values[2:-2] = (-old[:-4] + 4 * old[1:-3] + 10 * old[2:-2] + 4 * old[3:-1] - old[4:]) / 16


def fronts(panels, dt):
    """T, front, area of every step."""
    side = np.stack([np.ones(401), np.linspace(0, 2, 401)], 1)
    top = np.stack([np.linspace(1, 0, 201)[1:], np.full(200, 2.0)], 1)
    nodes, potential = divided(np.concatenate([side, top]), np.zeros(601), panels)
    rows = []
    for step in range(1, int(1.0 / dt) + 1):
        u, rate = rates(nodes, potential)
        u, rate = rates(nodes + 0.5 * dt * u, potential + 0.5 * dt * rate)
        nodes, potential = divided(nodes + dt * u, potential + dt * rate, panels)
        if step % 3 == 0:
            for values in (nodes[:, 0], nodes[:, 1], potential):
                smooth(values)
        x, y = nodes.T
        area = 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
        if not 1.95 < area < 2.05:
            break
        rows.append((step * dt * 2**0.5, x[0], area))
    return np.array(rows)


if __name__ == "__main__":
    kinds = [(int(sys.argv[1]), float(sys.argv[2]))] if len(sys.argv) > 2 else [(60, 0.01), (100, 0.005), (140, 0.0025)]
    for panels, dt in kinds:
        time, front, area = fronts(panels, dt).T
        shown = [f"{t}: {np.interp(t, time, front):.3f} ({np.interp(t, time, area):.3f})" for t in TIMES if t <= time[-1]]
        print(f"{panels} panels, steps of {dt}: T: front (area)  " + "  ".join(shown))
