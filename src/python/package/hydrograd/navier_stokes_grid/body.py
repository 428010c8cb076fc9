"""The flow around a body between walls or in a periodic box, with fixed particles around it.

Behind an ``inflow_profile`` the fluid leaves at x = L (pressure 0, no change across the side), where the benchmark's box is periodic and
holds the profile at x = 0. The benchmark's drag is a mean over the last half of a run. Where a run is long enough and its Reynolds number
small, here it is that of the steady flow, whose derivative costs a hundredth of that of a run; else it is that mean. Without a profile
nothing drives the flow: it begins with v0, passes the ends along x as in a periodic box (``periodic`` or ``neumann``), and slows down.
Forces are those of the body's surface, which has points of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple, Optional

import hydrograd
import numpy as np
import numpy.typing as npt

#: How often the fluid passes the box, by its mean speed, before its flow counts as steady.
PASSES = 1.5
#: Flows around bodies are steady below this Reynolds number, and resolved below that one.
STEADY, RESOLVED = 40.0, 300.0
#: Spacing of the surface and near it, in diameters, and how coarse particles become far away. Above the Reynolds number FINE the first two
#: are half of that: at 251 the drag of a cylinder is then 0.6 % off that of still finer ones, instead of 10 %.
SURFACE, NEAR, FAR = 0.05, 0.2, 2.0
FINE = 100.0

Array = npt.NDArray[np.float64]


class _Case(NamedTuple):
    """A scene but for the inflow's entries and v0."""

    viscosity: float
    size: tuple[float, float]
    grid: tuple[int, int]
    center: tuple[float, float]
    #: Half widths, or a radius.
    half: tuple[float, ...]
    periodic: tuple[bool, bool]
    speed: float
    #: Entries of the inflow's profile; 0: there is none.
    entries: int
    #: When a flow in time ends; None: the steady flow.
    end: Optional[float]
    #: What spacings are multiplied by.
    finer: float


@lru_cache(maxsize=8)
def _scene(case: _Case) -> hydrograd.Scene:
    across = 2 * max(min(case.half), 0.25 * max(case.half))
    center, half = np.array(case.center), np.array(case.half)
    body: dict[str, Any] = {"kind": "disc", "centre": list(case.center), "radius": case.half[0]}
    if len(half) == 2:
        body = {"kind": "box", "lower": (center - half).tolist(), "upper": (center + half).tolist()}
    scene: dict[str, Any] = {
        "region": {"size": list(case.size), "periodic": list(case.periodic), "acceleration": [0.0, 0.0]},
        "fluid": {"viscosity": case.viscosity, "reference_velocity": case.speed},
        "resolution": {"dx": case.finer * NEAR * across, "surface": case.finer * SURFACE * across, "far": FAR},
        "method": {"name": "fixed", "flow": "steady" if case.end is None else "unsteady"},
        "output": {"frames": 0, "grid": list(case.grid)},
        "objective": {"kind": "drag", "shapes": [0], "goal": "smaller"},
        "shapes": [body],
    }
    if case.end is not None:
        scene["time"] = {"end": case.end}
        scene["objective"]["window"] = 0.5 * case.end
    if case.entries:
        scene["region"]["sides"] = {"right": {"kind": "outflow"}}
        scene["shapes"].append(_inflow(case))
        parameters = [f"shapes[1].parameters[{k}]" for k in range(case.entries)]
        limit = 10 * case.speed
        scene["variables"] = [{"number": name, "lower": -limit, "upper": limit} for name in parameters]
    return hydrograd.Scene(scene)


def _inflow(case: _Case) -> dict[str, Any]:
    # Cubic B-splines at the entries: waves that particles at the inflow could not tell apart are left out, which viscosity would end after
    # a few spacings. Behind the ends the profile goes on as it is there.
    count, (length, height) = case.entries, case.size

    def spline(k: int) -> str:
        away = f"abs({count / height!r}*y - {k})" if k >= 0 else f"abs({count / height!r}*y + {-k})"
        return f"(max(2 - {away}, 0)^3 - 4*max(1 - {away}, 0)^3)/6"

    terms = [f"p{min(max(k, 0), count - 1)}*{spline(k)}" for k in range(-1, count + 2)]
    return {
        "kind": "box",
        "lower": [-length, -height],
        "upper": [0.0, 2 * height],
        "velocity": [" + ".join(terms), 0],
        "parameters": [case.speed] * count,
    }


def _refused(problem: str, allowed: str) -> ValueError:
    return ValueError(f"{problem}\n  allowed: {allowed}")


def _case(inputs: Any) -> tuple[_Case, Array, Array]:
    """The scene, the inflow's entries and v0 as ``[N, N, 2]``."""
    body, profile, faces = inputs.obstacle, inputs.inflow_profile, inputs.boundary_conditions
    viscosity = float(np.asarray(inputs.viscosity)[0])
    v0 = np.asarray(inputs.v0, dtype=np.float64)
    if v0.shape[-1] != 2 or v0.shape[2] != 1:
        raise _refused(f"an obstacle with v0 of shape {v0.shape}", "two dimensions, [N, N, 1, 2]")
    grid = (v0.shape[0], v0.shape[1])
    extent = float(inputs.domain_extent)
    half = [body.radius] if body.shape == "cylinder" else list(body.half_widths or [])
    if len(half) != (1 if body.shape == "cylinder" else 2) or not all(x and 0 < x < 0.5 for x in half):
        raise _refused(
            f"obstacle.shape = {body.shape!r}, radius = {body.radius}, half_widths = {body.half_widths}",
            "a cylinder with a radius, or a box with two half_widths, above 0 and below 0.5",
        )
    kinds = {name: getattr(faces, name).type for name in ("x_lo", "x_hi", "y_lo", "y_hi")}
    in_y = {kinds["y_lo"], kinds["y_hi"]}
    if in_y != {"no_slip"} and (profile is not None or in_y != {"periodic"}):
        wrong = next(name for name in ("y_lo", "y_hi") if kinds[name] != "no_slip")
        raise _refused(
            f"boundary_conditions.{wrong} = {kinds[wrong]!r} around an obstacle", "no_slip at both; without an inflow_profile also periodic at both"
        )
    if profile is None:
        for name in ("x_lo", "x_hi"):
            if kinds[name] not in ("periodic", "neumann"):
                raise _refused(f"boundary_conditions.{name} = {kinds[name]!r} around an obstacle", "periodic, neumann")
    numbers = np.zeros(0) if profile is None else np.asarray(profile, dtype=np.float64)
    start = v0[:, :, 0]
    speed = float(np.mean(np.abs(numbers)) if len(numbers) else np.sqrt(np.mean(start**2) * 2))
    if not speed > 0:
        raise _refused("a flow around an obstacle that is at rest", "a v0 or an inflow_profile that is not 0")
    end = inputs.steps * float(np.asarray(inputs.dt)[0])
    if not end > 0:
        raise _refused(f"steps * dt = {end:g} around an obstacle", "above 0")
    # A box is as broad as it is high for the flow along x.
    reynolds = 2 * extent * half[-1] * speed / viscosity if viscosity > 0 else float("inf")
    if reynolds > RESOLVED:
        raise _refused(f"a Reynolds number of {reynolds:.3g} around an obstacle", f"{RESOLVED:g} or less")
    is_steady = len(numbers) > 0 and reynolds <= STEADY and end * speed / extent >= PASSES
    case = _Case(
        viscosity=viscosity,
        size=(extent, extent * grid[1] / grid[0]),
        grid=grid,
        center=(extent * body.center[0], extent * body.center[1]),
        half=tuple(extent * x for x in half),
        periodic=(profile is None, in_y == {"periodic"}),
        # One scene for all flows of about this speed.
        speed=float(2 ** np.round(np.log2(speed))),
        entries=len(numbers),
        end=None if is_steady else end,
        finer=1.0 if reynolds <= FINE else 0.5,
    )
    return case, numbers, start


@lru_cache(maxsize=2)
def _steady(case: _Case, numbers: tuple[float, ...]) -> hydrograd.Steady:
    # The gradient costs little, and whoever asks for the drag asks for it next.
    return _scene(case).steady(numbers)


def apply(inputs: Any) -> tuple[Any, float]:
    """The velocity at the points of v0, 0 inside of the body, and the drag."""
    case, numbers, start = _case(inputs)
    if case.end is None:
        found = _steady(case, tuple(numbers.tolist()))
    else:
        found = _scene(case).unsteady(numbers, gradient=False, velocity=start)
    velocity = np.nan_to_num(np.asarray(found.grid_velocity), nan=0.0)
    return velocity.reshape(np.shape(inputs.v0)).astype(np.float32), found.objective


def cotangents(inputs: Any, wanted: set[str], by_outputs: Mapping[str, Any]) -> dict[str, Any]:
    """The cotangents of v0, viscosity and inflow_profile from those of the result and the drag. A steady flow does not depend on v0."""
    unknown = sorted(wanted - {"v0", "viscosity", "inflow_profile"})
    if unknown:
        raise _refused(f"the derivative by {unknown[0]} around an obstacle", "those by v0, viscosity and inflow_profile")
    case, numbers, start = _case(inputs)
    by_v0, by_profile, by_viscosity = np.zeros_like(start), np.zeros(len(numbers)), 0.0
    for name, by in by_outputs.items():
        cotangent = None if by is None else np.asarray(by, dtype=np.float64)
        if cotangent is None or not cotangent.any():
            continue
        is_drag = name == "drag"
        more: dict[str, Any] = {} if is_drag else {"by_grid_velocity": cotangent.reshape(start.shape)}
        weight = float(cotangent.reshape(())) if is_drag else 1.0
        if case.end is not None:
            found = _scene(case).unsteady(numbers, velocity=start, **more)
            by_v0 += weight * np.asarray(found.velocity_gradient)
        else:
            found = _steady(case, tuple(numbers.tolist())) if is_drag else _scene(case).steady(numbers, **more)
        by_profile += weight * np.asarray(found.gradient)
        by_viscosity += weight * (found.viscosity_gradient or 0.0)
    all_of_them = {"v0": by_v0.reshape(np.shape(inputs.v0)), "viscosity": [by_viscosity], "inflow_profile": by_profile}
    return {name: np.asarray(all_of_them[name], dtype=np.float32) for name in wanted}
