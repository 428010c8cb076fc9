"""The flow around a cylinder between two walls, behind an inflow whose profile is given, with fixed particles around it.

The benchmark's box is periodic along x, and holds the profile at x = 0; here the fluid leaves at x = L instead (pressure 0, no change
across the side). Its drag is a mean over the last half of a run. Where a run is long enough and its Reynolds number small, here it is that of
the steady flow, whose derivative costs a hundredth of that of a run; else it is that mean. Forces are those of the body's surface,
which has points of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Optional

import hydrograd
import numpy as np
import numpy.typing as npt

#: How often the fluid passes the box, by its mean speed, before its flow counts as steady.
PASSES = 1.5
#: Flows around a cylinder are steady below this Reynolds number, and resolved below that one.
STEADY, RESOLVED = 40.0, 200.0
#: Spacing of the surface and near it, in diameters, and how coarse particles become far away.
SURFACE, NEAR, FAR = 0.05, 0.2, 2.0

Array = npt.NDArray[np.float64]


@lru_cache(maxsize=8)
def _scene(
    viscosity: float,
    size: float,
    center: tuple[float, float],
    radius: float,
    count: int,
    speed: float,
    in_time: Optional[tuple[float, float, float]],
) -> hydrograd.Scene:
    # Cubic B-splines at the entries: waves that particles at the inflow could not tell apart are left out, which viscosity would end after
    # a few spacings. Behind the ends the profile goes on as it is there.
    def spline(k: int) -> str:
        away = f"abs({count / size!r}*y - {k})" if k >= 0 else f"abs({count / size!r}*y + {-k})"
        return f"(max(2 - {away}, 0)^3 - 4*max(1 - {away}, 0)^3)/6"

    terms = [f"p{min(max(k, 0), count - 1)}*{spline(k)}" for k in range(-1, count + 2)]
    parameters = [f"shapes[1].parameters[{k}]" for k in range(count)]
    return hydrograd.Scene(
        {
            "region": {
                "size": [size, size],
                "periodic": [False, False],
                "acceleration": [0.0, 0.0],
                "sides": {"right": {"kind": "outflow"}},
            },
            "fluid": {"viscosity": viscosity, "reference_velocity": speed},
            "resolution": {"dx": NEAR * 2 * radius, "surface": SURFACE * 2 * radius, "far": FAR},
            "method": {"name": "fixed", "flow": "steady" if in_time is None else "unsteady"},
            **(
                {}
                if in_time is None
                else {"time": {"end": in_time[0]}, "initial": {"velocity": list(in_time[1:])}, "output": {"frames": 0}}
            ),
            "objective": {"kind": "drag", "shapes": [0], "goal": "smaller"}
            | ({} if in_time is None else {"window": 0.5 * in_time[0]}),
            "shapes": [
                {"kind": "disc", "centre": list(center), "radius": radius},
                {
                    "kind": "box",
                    "lower": [-size, -size],
                    "upper": [0.0, 2 * size],
                    "velocity": [" + ".join(terms), 0],
                    "parameters": [speed] * count,
                },
            ],
            "variables": [{"number": name, "lower": -10 * speed, "upper": 10 * speed} for name in parameters],
        }
    )


def _refused(problem: str, allowed: str) -> ValueError:
    return ValueError(f"{problem}\n  allowed: {allowed}")


@lru_cache(maxsize=2)
def _solved(key: tuple[Any, ...], profile: tuple[float, ...], gradient: bool) -> hydrograd.Steady:
    scene = _scene(*key)
    return scene.steady(profile, gradient=gradient) if key[-1] is None else scene.unsteady(profile, gradient=gradient)


def flow(inputs: Any, gradient: bool = False) -> tuple[hydrograd.Steady, Any]:
    """The flow, and a function that gives its velocity at the points of v0."""
    body, profile = inputs.obstacle, inputs.inflow_profile
    size, viscosity = float(inputs.domain_extent), float(np.asarray(inputs.viscosity)[0])
    if body.shape != "cylinder" or body.radius is None:
        raise _refused(f"obstacle.shape = {body.shape!r}, radius = {body.radius}", "a cylinder with a radius")
    if profile is None:
        raise _refused("an obstacle without an inflow_profile", "both: nothing else drives the flow, and it would not become steady")
    if np.shape(inputs.v0)[-1] != 2:
        raise _refused("an obstacle in three dimensions", "two")
    for name in ("y_lo", "y_hi"):
        kind = getattr(inputs.boundary_conditions, name).type
        if kind != "no_slip":
            raise _refused(f"boundary_conditions.{name} = {kind!r} around an obstacle", "no_slip")
    numbers = np.asarray(profile, dtype=np.float64)
    speed, radius = float(np.mean(np.abs(numbers))), size * body.radius
    end = inputs.steps * float(np.asarray(inputs.dt)[0])
    reynolds = 2 * radius * speed / viscosity if viscosity > 0 else float("inf")
    if reynolds > RESOLVED:
        raise _refused(f"a Reynolds number of {reynolds:.3g} around an obstacle", f"{RESOLVED:g} or less")
    in_time = None
    if reynolds > STEADY or end * speed / size < PASSES:
        start = np.asarray(inputs.v0, dtype=np.float64).reshape(-1, 2)
        if np.ptp(start, axis=0).max() > 1e-6 * max(speed, 1e-30):
            raise _refused("a v0 that varies around an obstacle, in a run that does not become steady", "the same velocity everywhere")
        in_time = (end, *map(float, start[0]))
    center = (size * body.center[0], size * body.center[1])
    # One scene for all profiles of about this speed.
    scale = float(2 ** np.round(np.log2(speed)))
    # Of a steady flow the gradient costs little, and whoever asks for the drag asks for it next.
    key = (viscosity, size, center, radius, len(numbers), scale, in_time)
    found = _solved(key, tuple(numbers.tolist()), gradient or in_time is None)
    return found, lambda: _on_grid(found, np.shape(inputs.v0), size, center, radius)


def _on_grid(steady: hydrograd.Steady, shape: tuple[int, ...], size: float, center: tuple[float, float], radius: float) -> Any:
    """Velocities at the points i L / N, 0 inside the body: linear fits to the nine nearest particles."""
    axes = [np.arange(n) * size / shape[0] for n in shape[:2]]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    apart = ((points[:, None] - steady.position[None]) ** 2).sum(axis=-1)
    near = np.argpartition(apart, 9, axis=1)[:, :9]
    away = steady.position[near] - points[:, None]
    # Nearer particles count more; one at the point itself alone.
    square = np.take_along_axis(apart, near, axis=1)
    weight = 1 / (square / square.mean(axis=1, keepdims=True) + 1e-12)
    basis = np.concatenate([np.ones((*near.shape, 1)), away / np.sqrt(square.mean(axis=1))[:, None, None]], axis=-1)
    matrix = np.einsum("pn,pni,pnj->pij", weight, basis, basis)
    right = np.einsum("pn,pni,pna->pia", weight, basis, steady.velocity[near])
    found = np.linalg.solve(matrix, right)[:, 0]
    found[((points - center) ** 2).sum(axis=-1) < radius**2] = 0
    return found.reshape(shape).astype(np.float32)


def cotangents(inputs: Any, wanted: set[str], by_outputs: Mapping[str, Any]) -> dict[str, Any]:
    """The cotangent of the inflow_profile from that of the drag; steady flow does not depend on v0, and the others are refused."""
    by_result, by_drag = by_outputs.get("result"), by_outputs.get("drag")
    if by_result is not None and np.any(by_result):
        raise _refused("the derivative of result around an obstacle", "that of drag")
    unknown = sorted(wanted - {"v0", "inflow_profile"})
    if unknown:
        raise _refused(f"the derivative by {unknown[0]} around an obstacle", "that by inflow_profile")
    found: dict[str, Any] = {}
    if "v0" in wanted:
        if isinstance(flow(inputs, gradient=True)[0], hydrograd.Unsteady):
            raise _refused("the derivative by v0 around an obstacle, in a run that does not become steady", "that by inflow_profile")
        found["v0"] = np.zeros(np.shape(inputs.v0), np.float32)
    if "inflow_profile" in wanted:
        gradient: Any = flow(inputs, gradient=True)[0].gradient if by_drag is not None else 0.0
        weight = 0.0 if by_drag is None else float(np.asarray(by_drag).reshape(()))
        found["inflow_profile"] = np.broadcast_to(weight * gradient, np.shape(inputs.inflow_profile)).astype(np.float32)
    return found
