"""Scenes of the comparison, for JAX-SPH: its solver, integrator and neighbour lists, set up as its own `simulate` does.

The package carries no case files, so lattice, tags, body force and boundary conditions are written here, after the cases
`ht`, `tgv` and `pf` of tumaer/jax-sph. `check.py` shows that they reproduce its states and its gradient.
"""
import math
import time
import warnings
from dataclasses import dataclass, field
from functools import partial
from typing import Callable

import jax

if not hasattr(jax, "tree_map"):  # gone from jax 0.6; the package still imports it
    jax.tree_map = jax.tree_util.tree_map

import jax.numpy as jnp
import numpy as np
from jax_sph import partition
from jax_sph.eos import TaitEoS
from jax_sph.integrator import si_euler
from jax_sph.jax_md import space
from jax_sph.jax_md.partition import Sparse
from jax_sph.kernel import QuinticKernel
from jax_sph.solver import WCSPH
from jax_sph.utils import Tag

warnings.filterwarnings("ignore", message="scatter inputs have incompatible types")

WALL_ROWS = 3
# Extra reach of neighbour lists, in spacings. JAX-SPH's `simulate` uses 0.
SKINS = (0.0, 0.2)
HEATED_LENGTH, HOT_FROM, HOT_TO = 1.0, 0.25, 0.75
T_INLET, T_HOT = 1.0, 1.23


@dataclass
class Scene:
    """A scene ready to run. `state` is the dictionary that JAX-SPH's `advance(dt, state, neighbors)` takes."""

    name: str
    dimension: int
    dx: float
    dt: float
    box: np.ndarray
    state: dict
    advance: Callable
    allocate: Callable
    tag: np.ndarray
    extra: dict = field(default_factory=dict)

    @property
    def particles(self):
        return len(self.tag)

    def pairs(self, state):
        """Directed pairs within the cutoff whose first particle is fluid, as `hydrograd bench` counts them."""
        i, j = np.asarray(self.allocate(state["r"]).idx)
        i, j = i[i < self.particles], j[i < self.particles]
        fluid = (self.tag[i] == Tag.FLUID) & (i != j)
        r = np.asarray(state["r"], dtype=np.float64)
        d = r[i[fluid]] - r[j[fluid]]
        d -= self.box * np.round(d / self.box)
        return int((np.sum(d * d, axis=1) < (3 * self.dx) ** 2).sum())


def poiseuille(dx, height=1.0, length=0.4, viscosity=100.0, strength=1000.0, reference_velocity=1.25, cfl=0.25, transport=1.0,
               time_step_of=None, **options):
    """Case `pf`: a channel between plane walls, from rest under a constant force."""
    sound_speed = 10 * reference_velocity
    box = np.array([length, height + 2 * WALL_ROWS * dx])
    r = lattice((round(length / dx), round(height / dx) + 2 * WALL_ROWS), dx)
    low, high = WALL_ROWS * dx, height + WALL_ROWS * dx
    r, tag = walls_first(r, (r[:, 1] < low) | (r[:, 1] > high))

    def boundary(state):
        return held_still(dict(state), state["tag"] == Tag.SOLID_WALL)

    dt = time_step_of or time_step(cfl, dx, sound_speed, reference_velocity, viscosity, strength)
    return build(
        "poiseuille", r=r, velocity=np.zeros_like(r), tag=tag, box=box, dx=dx, dt=dt, viscosity=viscosity,
        sound_speed=sound_speed, force=banded_force(strength, low, high), boundary=boundary, transport=transport, walls=True,
        extra={"height": height, "viscosity": viscosity, "strength": strength}, **options)


def time_step(cfl, dx, sound_speed, velocity, viscosity, force):
    """JAX-SPH's own: cfl times the smallest of the acoustic, viscous and body-force limits."""
    limits = [dx / (sound_speed + velocity), dx * dx / viscosity]
    if force > 0:
        limits.append(math.sqrt(dx / force))
    return cfl * min(limits)


def lattice(counts, dx):
    """Cell centres, x fastest in 2D."""
    axes = np.meshgrid(*[np.arange(n) for n in counts], indexing="xy")
    return (np.stack([a.ravel() for a in axes], axis=1) + 0.5) * dx


def walls_first(r, wall):
    """JAX-SPH's order of particles: walls, then fluid. Also their tags."""
    order = np.argsort(~wall, kind="stable")
    return r[order], np.where(wall[order], int(Tag.SOLID_WALL), int(Tag.FLUID))


def build(name, *, r, velocity, tag, box, dx, dt, viscosity, sound_speed, force, boundary, transport, background=0.0,
          walls=False, heat=None, dtype=np.float64, backend="jaxmd_vmap", skin=0.0, extra=None):
    n, dimension = r.shape
    box = np.asarray(box, dtype=np.float64)
    displacement, shift = space.periodic(side=box)
    reference_pressure = sound_speed**2
    eos = TaitEoS(reference_pressure, 1.0, background * reference_pressure, 1.0)
    solver = WCSPH(displacement, eos, force, dx, dimension, dt, sound_speed, 3, "SPH", "QSK", walls, False, 0.0, False,
                   False, heat is not None)
    kappa, capacity = heat or (0.0, 0.0)
    of = partial(jnp.asarray, dtype=dtype)
    scalar = lambda value: jnp.full(n, value, dtype=dtype)
    density = scalar(1.0)
    state = {
        "r": of(r), "tag": jnp.asarray(tag, dtype=int), "u": of(velocity), "v": of(velocity),
        "dudt": of(np.zeros_like(r)), "dvdt": of(np.zeros_like(r)), "drhodt": scalar(0.0), "rho": density,
        "p": eos.p_fn(density), "mass": scalar(dx**dimension), "eta": scalar(viscosity), "dTdt": scalar(0.0),
        "T": scalar(T_INLET), "kappa": scalar(kappa), "Cp": scalar(capacity), "nw": of(np.zeros_like(r)),
    }
    state = boundary(state)
    lists = partition.neighbor_list(
        displacement, box, r_cutoff=solver._kernel_fn.cutoff, dr_threshold=skin * dx, backend=backend,
        capacity_multiplier=1.25, mask_self=False, format=Sparse, num_particles_max=n, num_partitions=1,
        pbc=np.array([True, True, True]),
    )

    def allocate(position, extra=0):
        return lists.allocate(position, extra_capacity=extra, num_particles=n)

    integrate = si_euler(transport, solver.forward_wrapper(), shift, boundary, None)

    def advance(step, state, neighbors):
        # The integrator writes into the dictionary that it is given.
        return integrate(step, dict(state), neighbors)

    return Scene(name, dimension, dx, dt, box, state, advance, allocate, np.asarray(tag), extra or {})


def no_boundary(state):
    return dict(state)


def held_still(state, mask):
    for name in ("u", "v", "dudt", "dvdt"):
        state[name] = jnp.where(mask[:, None], 0.0, state[name])
    return state


def banded_force(strength, below, above):
    """A force along x on particles between two heights."""
    def force(r):
        inside = (r[:, 1] > below) & (r[:, 1] < above)
        return jnp.zeros_like(r).at[:, 0].set(jnp.where(inside, strength, 0.0))
    return force


def heated_channel(height=0.26, dx=0.02, cfl=0.25, jitter=0.05, seed=0, transport=0.0, developed=False, time_step_of=None,
                   **options):
    """Case `ht`: a hot section in the bottom wall of a channel driven by a body force, from rest or with a parabola."""
    viscosity, strength, sound_speed = 0.01, 2.3, 10.0
    rows = round(height / dx)
    box = np.array([HEATED_LENGTH, height + 2 * WALL_ROWS * dx])
    r = lattice((round(HEATED_LENGTH / dx), rows + 2 * WALL_ROWS), dx)
    low, high = WALL_ROWS * dx, box[1] - WALL_ROWS * dx
    r, tag = walls_first(r, (r[:, 1] < low) | (r[:, 1] > high))
    hot = (r[:, 1] < low) & (r[:, 0] > HOT_FROM) & (r[:, 0] < HOT_TO)
    tag = np.where(hot, int(Tag.DIRICHLET_WALL), tag)
    fluid = tag == Tag.FLUID
    r[fluid] += jitter * dx * np.random.default_rng(seed).standard_normal((fluid.sum(), 2))
    r = np.mod(r, box)
    ends = WALL_ROWS * dx
    velocity = np.zeros_like(r)
    if developed:
        y = r[:, 1] - low
        velocity[:, 0] = np.where(tag == Tag.FLUID, np.maximum(0.5 * strength / viscosity * y * (height - y), 0.0), 0.0)

    def boundary(state):
        state = dict(state)
        tags, x = state["tag"], state["r"][:, 0]
        fluid, hot, solid = tags == Tag.FLUID, tags == Tag.DIRICHLET_WALL, tags == Tag.SOLID_WALL
        entering, leaving = fluid & (x < ends), fluid & (x > HEATED_LENGTH - ends)
        state["T"] = jnp.where(hot, T_HOT, jnp.where(entering | solid, T_INLET, state["T"]))
        state["dTdt"] = jnp.where(hot | entering | leaving | solid, 0.0, state["dTdt"])
        return held_still(state, hot | solid)

    return build(
        "heated-channel", r=r, velocity=velocity, tag=tag, box=box, dx=dx,
        dt=time_step_of or time_step(cfl, dx, sound_speed, 1.0, viscosity, strength), viscosity=viscosity, sound_speed=sound_speed,
        force=banded_force(strength, low, high), boundary=boundary, transport=transport, background=0.05, walls=True,
        heat=(7.313, 305.27), extra={"height": height, "strength": strength}, **options)


def taylor_green(per_side=50, dimension=2, cfl=0.25, reynolds=100.0, transport=1.0, jitter=0.0, seed=0, time_step_of=None,
                 **options):
    """Case `tgv`: decaying vortices in a periodic box."""
    size = 1.0 if dimension == 2 else 2 * math.pi
    dx, viscosity, sound_speed = size / per_side, 1.0 / reynolds, 10.0
    r = lattice((per_side,) * dimension, dx)
    r = np.mod(r + jitter * dx * np.random.default_rng(seed).standard_normal(r.shape), size)
    if dimension == 2:
        velocity = taylor_green_velocity(r, 0.0, reynolds)
    else:
        x, y, z = r.T
        velocity = np.stack([np.sin(x) * np.cos(y) * np.cos(z), -np.cos(x) * np.sin(y) * np.cos(z), 0 * x], axis=1)
    dt = time_step_of or time_step(cfl, dx, sound_speed, 1.0, viscosity, 0.0)
    return build(
        "taylor-green", r=r, velocity=velocity, tag=np.zeros(len(r), dtype=int), box=np.full(dimension, size), dx=dx, dt=dt,
        viscosity=viscosity, sound_speed=sound_speed, force=jnp.zeros_like, boundary=no_boundary, transport=transport,
        extra={"reynolds": reynolds}, **options)


def taylor_green_velocity(r, time, reynolds):
    """Exact solution in the unit box (Taylor and Green 1937)."""
    x, y = 2 * math.pi * r.T
    decay = math.exp(-8 * math.pi**2 * time / reynolds)
    return decay * np.stack([-np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)], axis=1)


def run_for(scene, steps):
    """A compiled function (state, neighbors) -> the same after `steps` steps: one scan."""
    def body(carry, _):
        return scene.advance(scene.dt, *carry), None

    @jax.jit
    def run(state, neighbors):
        return jax.lax.scan(body, (state, neighbors), None, length=steps)[0]

    return run


class Run:
    """A run in pieces. Compiles apart from the timed part, and makes a longer list when one overflows, as `simulate` does."""

    def __init__(self, scene):
        self.scene, self.compiled = scene, {}
        # The first update gives the list the shapes that it keeps.
        self.state, self.neighbors = scene.state, scene.allocate(scene.state["r"])

    def prepare(self, steps):
        key = (steps, self.neighbors.idx.shape, self.neighbors.cell_list_capacity)
        if key not in self.compiled:
            self.compiled[key] = run_for(self.scene, steps).lower(self.state, self.neighbors).compile()
        return self.compiled[key]

    def advance(self, steps):
        """Seconds that the steps took."""
        seconds = 0.0
        while True:
            run = self.prepare(steps)
            clock = time.perf_counter()
            state, neighbors = jax.block_until_ready(run(self.state, self.neighbors))
            seconds += time.perf_counter() - clock
            if not neighbors.did_buffer_overflow:
                self.state, self.neighbors = state, neighbors
                return seconds
            self.neighbors = self.scene.allocate(self.state["r"], extra=10)

    def finite(self):
        return bool(jnp.all(jnp.isfinite(self.state["r"])) & jnp.all(jnp.isfinite(self.state["u"])))


def with_faster_list(make, steps=20):
    """The scene with a new neighbour list in each step (JAX-SPH's setting) or with a skin, whichever steps faster."""
    def speed(skin):
        run = Run(make(skin=skin))
        run.advance(steps)
        return min(run.advance(steps) for _ in range(2))

    skin = min(SKINS, key=speed)
    return make(skin=skin), skin


def gradient_of(scene, value, start, steps, segment=None):
    """A compiled function (variables, neighbors) -> (value of the end state, its gradient by the variables).

    `start` makes the initial state of the variables. Each step is a checkpoint: the reverse sweep computes it again rather
    than read back what it left (half the time of checkpoints every sqrt(steps) steps alone, measured). With `segment`,
    states are also only kept every so many steps, and computed again in between: less memory, one more forward run.
    """
    def advance(carry, _):
        return jax.checkpoint(lambda state, neighbors: scene.advance(scene.dt, state, neighbors))(*carry), None

    def part(carry, _):
        return jax.lax.scan(advance, carry, None, length=segment)[0], None

    def final(variables, neighbors):
        carry = (start(variables), neighbors)
        if segment is None:
            state, neighbors = jax.lax.scan(advance, carry, None, length=steps)[0]
        else:
            state, neighbors = jax.lax.scan(jax.checkpoint(part), carry, None, length=steps // segment)[0]
        return value(state), neighbors.did_buffer_overflow

    if segment is not None and steps % segment != 0:
        raise ValueError(f"segments of {segment} do not divide {steps} steps")
    return jax.jit(jax.value_and_grad(final, has_aux=True))


def walls_moved(scene, columns):
    """Design variables of the heated channel: how far the hot wall's particle columns stand above its straight line.

    Fluid above a moved column is squeezed linearly between it and the top wall. `columns` tells each particle's column.
    """
    height, base = scene.extra["height"], scene.state["r"]
    moved = np.flatnonzero(np.bincount(columns, weights=scene.tag == Tag.DIRICHLET_WALL) > 0)
    variable = np.full(columns.max() + 1, -1)
    variable[moved] = np.arange(len(moved))
    variable = variable[columns]
    hot, fluid = scene.tag == Tag.DIRICHLET_WALL, (scene.tag == Tag.FLUID) & (variable >= 0)

    def start(offsets):
        offset = offsets[jnp.maximum(variable, 0)]
        above = base[:, 1] - WALL_ROWS * scene.dx
        y = base[:, 1] + jnp.where(hot, offset, jnp.where(fluid, offset * (1 - above / height), 0.0))
        return {**scene.state, "r": base.at[:, 1].set(y)}

    return start, len(moved)


def heat_outflow(scene, x=0.9):
    """Q of the original report: sum over a column of targets of rho u (T - T_in), each a Shepard mean over the fluid."""
    height, dx = scene.extra["height"], scene.dx
    rows = np.arange(round(height / dx))
    targets = jnp.asarray(np.stack([np.full(len(rows), x), (WALL_ROWS + rows + 0.5) * dx], axis=1))
    kernel = QuinticKernel(h=dx, dim=2)
    fluid = jnp.asarray(scene.tag == Tag.FLUID)

    def value(state):
        difference = targets[:, None, :] - state["r"][None, :, :]
        square = jnp.sum(difference * difference, axis=-1)
        near = (square < kernel.cutoff**2) & fluid[None, :]
        weight = jnp.where(near, kernel.w(jnp.sqrt(jnp.where(near, square, 1.0))), 0.0)
        mean = lambda f: weight @ f / jnp.sum(weight, axis=1)
        return jnp.sum(mean(state["rho"]) * mean(state["u"][:, 0]) * mean(state["T"] - T_INLET))

    return value


def kinetic_energy(state):
    return 0.5 * jnp.sum(state["mass"][:, None] * state["u"] ** 2)
