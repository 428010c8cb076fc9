"""The flow of `hydrograd bench surrogate` (src/cli/bench/surrogate.rs): a jittered lattice of 38 x 25 particles that moves."""
import numpy as np

COLUMNS, ROWS, SPACING, JITTER, SPEED = 38, 25, 0.02, 0.2, 0.02
BOX = np.array([COLUMNS * SPACING, ROWS * SPACING])
FRAMES = 10


def positions(frames=FRAMES):
    """[frames, N, 2], wrapped into the periodic box."""
    k = np.arange(COLUMNS * ROWS)
    jitter = lambda k: JITTER * (2 * np.modf((k * k) * (0.5 * (np.sqrt(5.0) - 1)))[0] - 1)
    start = SPACING * np.stack([k % COLUMNS + 0.5 + jitter(2 * k), k // COLUMNS + 0.5 + jitter(2 * k + 1)], axis=-1)
    wave = np.sin(2 * np.pi * start / BOX)[:, ::-1]
    return np.mod(start + np.arange(frames)[:, None, None] * SPEED * SPACING * wave, BOX)


def nearest(difference):
    return difference - BOX * np.round(difference / BOX)


def edges(position, radius):
    """Senders and receivers of all pairs closer than radius, itself among them, sorted by receiver."""
    distance = np.linalg.norm(nearest(position[:, None] - position[None]), axis=-1)
    receivers, senders = np.nonzero(distance < radius * SPACING)
    return senders, receivers


def metadata(radius):
    """As LagrangeBench's metadata.json."""
    speed = SPEED * SPACING
    return {"dim": 2, "dx": SPACING, "dt": 1.0, "write_every": 1, "num_particles_max": COLUMNS * ROWS,
            "periodic_boundary_conditions": [True, True, True], "bounds": [[0.0, float(size)] for size in BOX],
            "default_connectivity_radius": radius * SPACING, "vel_mean": [0.0, 0.0], "vel_std": [speed, speed],
            "acc_mean": [0.0, 0.0], "acc_std": [0.1 * speed, 0.1 * speed]}
