"""Incompressible flow from a velocity field to a velocity field, with the interface of Mosaic's solvers ``ns-grid``, ``ns-3d-grid``.

In a periodic box: fixed particles on the grid's own points, exact derivatives of all modes, steps in time chosen by their error; see
:func:`hydrograd.periodic_flow`. Nothing is compiled: every N, viscosity and number of steps runs at once.

Around a body, see ``body.py``: behind an ``inflow_profile`` its **steady** flow where a run is long enough, and else the flow in time.

    Tesseract.from_tesseract_api(hydrograd.navier_stokes_grid.tesseract_api.__file__)      # without docker
"""

from __future__ import annotations

import math
from typing import Any, Literal, Optional

import hydrograd
import numpy as np
from pydantic import BaseModel, Field
from tesseract_core.runtime import Array, Differentiable, Float32

from hydrograd.navier_stokes_grid import body

#: The error of a step in time.
TOLERANCE = 1e-7
_FACES = ("x_lo", "x_hi", "y_lo", "y_hi", "z_lo", "z_hi")


class Face(BaseModel):
    """What holds at a side of the box."""

    type: Literal["periodic", "no_slip", "neumann", "dirichlet"] = "periodic"
    value: Optional[list[float]] = Field(default=None, description="Velocity, for dirichlet.")


class Faces(BaseModel):
    """What holds at all sides."""

    x_lo: Face = Field(default_factory=Face)
    x_hi: Face = Field(default_factory=Face)
    y_lo: Face = Field(default_factory=Face)
    y_hi: Face = Field(default_factory=Face)
    z_lo: Face = Field(default_factory=Face)
    z_hi: Face = Field(default_factory=Face)


class Obstacle(BaseModel):
    """A body at rest; lengths are shares of the box."""

    shape: Literal["cylinder", "box"] = "cylinder"
    center: list[float] = [0.5, 0.5]
    radius: Optional[float] = None
    half_widths: Optional[list[float]] = None
    bc: Literal["no_slip"] = "no_slip"


def _vortices() -> Any:
    x = np.arange(64) * (2 * math.pi / 64)
    u = np.sin(x)[:, None] * np.cos(x)
    return np.stack([u, -u.T], axis=-1)[:, :, None, :].astype(np.float32)


class InputSchema(BaseModel):
    """What :func:`apply` takes."""

    v0: Differentiable[Array[(None, None, None, None), Float32]] = Field(
        default_factory=_vortices, description="Velocity at the start, [N, N, 1, 2] or [N, N, N, 3]; sample i at i L / N."
    )
    viscosity: Differentiable[Array[(1,), Float32]] = Field(
        default_factory=lambda: np.array([0.05], np.float32), description="Kinematic viscosity."
    )
    dt: Differentiable[Array[(1,), Float32]] = Field(
        default_factory=lambda: np.array([0.01], np.float32), description="Interval; the flow goes on for steps * dt."
    )
    steps: int = Field(default=300, ge=0, description="Number of intervals.")
    domain_extent: float = Field(default=2 * math.pi, gt=0, description="Length of the box along x.")
    boundary_conditions: Faces = Field(default_factory=Faces, description="Sides: periodic; with a body also no_slip along y.")
    obstacle: Optional[Obstacle] = Field(default=None, description="A cylinder with a radius or a box with half_widths, in two dimensions.")
    inflow_profile: Optional[Differentiable[Array[(None,), Float32]]] = Field(
        default=None, description="With a body: the velocity along x at x = 0, [N]; entry j at j L / N."
    )


class OutputSchema(BaseModel):
    """What :func:`apply` gives."""

    result: Differentiable[Array[(None, None, None, None), Float32]] = Field(description="Velocity at the end, as v0.")
    drag: Optional[Differentiable[Array[(1,), Float32]]] = Field(
        default=None, description="Force of the fluid on the body along x, over density and depth; None without a body."
    )


def _flow(inputs: InputSchema) -> hydrograd.Flow:
    for name in _FACES:
        kind = getattr(inputs.boundary_conditions, name).type
        if kind != "periodic":
            raise ValueError(f"boundary_conditions.{name} = {kind!r}\n  allowed: periodic")
    if inputs.inflow_profile is not None:
        raise ValueError("inflow_profile without an obstacle\n  allowed: both, or a periodic box")
    v0 = np.asarray(inputs.v0, dtype=np.float64)
    if v0.shape[-1] not in (2, 3) or (v0.shape[-1] == 2 and v0.shape[2] != 1):
        raise ValueError(f"v0 of shape {v0.shape}\n  allowed: [N, N, 1, 2] or [N, N, N, 3]")
    return hydrograd.periodic_flow(
        v0[:, :, 0] if v0.shape[-1] == 2 else v0,
        viscosity=float(np.asarray(inputs.viscosity)[0]),
        time=inputs.steps * float(np.asarray(inputs.dt)[0]),
        size=inputs.domain_extent,
        tolerance=TOLERANCE,
    )


def apply(inputs: InputSchema) -> OutputSchema:
    """The velocity after ``steps * dt``, and the drag of a body."""
    if inputs.obstacle is not None:
        velocity, drag = body.apply(inputs)
        return OutputSchema(result=velocity, drag=np.array([drag], np.float32))
    flow = _flow(inputs)
    return OutputSchema(result=flow.velocity.reshape(np.shape(inputs.v0)).astype(np.float32))


def vector_jacobian_product(
    inputs: InputSchema, vjp_inputs: set[str], vjp_outputs: set[str], cotangent_vector: dict[str, Any]
) -> dict[str, Any]:
    """The cotangents of v0, viscosity and dt from that of the result: exact, for the steps in time that were taken. With a body those of
    v0, viscosity and inflow_profile from those of result and drag."""
    if inputs.obstacle is not None:
        return body.cotangents(inputs, vjp_inputs, {name: cotangent_vector.get(name) for name in vjp_outputs})
    flow = _flow(inputs)
    shape = np.shape(inputs.v0)
    cotangent = cotangent_vector.get("result") if "result" in vjp_outputs else None
    by_result = np.zeros(shape) if cotangent is None else np.asarray(cotangent, dtype=np.float64)
    found = flow.vjp(by_result.reshape(flow.velocity.shape))
    all_of_them = {
        "v0": found.velocity.reshape(shape),
        "viscosity": [found.viscosity],
        "dt": [found.time * inputs.steps],
    }
    return {name: np.asarray(all_of_them[name], dtype=np.float32) for name in vjp_inputs}


def abstract_eval(abstract_inputs: Any) -> dict[str, Any]:
    """Shapes and types of the outputs."""
    given = abstract_inputs.model_dump()
    v0 = given["v0"]
    shape = v0["shape"] if isinstance(v0, dict) and "shape" in v0 else np.shape(v0)
    drag = None if given["obstacle"] is None else {"shape": (1,), "dtype": "float32"}
    return {"result": {"shape": tuple(shape), "dtype": "float32"}, "drag": drag}
