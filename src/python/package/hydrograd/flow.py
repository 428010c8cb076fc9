"""Incompressible flow in a periodic box: a velocity field in, a velocity field out, and the exact derivative.

>>> flow = hydrograd.periodic_flow(velocity, viscosity=0.01, time=1.0)
>>> gradient = flow.vjp(velocity=2 * flow.velocity)
>>> gradient.velocity, gradient.viscosity
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Optional, Union

import numpy as np
import numpy.typing as npt

from . import _native

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FlowGradient:
    """The derivative of a number by all that a flow depends on, as :meth:`Flow.vjp` gives it.

    Attributes:
        velocity, temperature: by the fields at the start, of their shapes; the temperature's is None without heat.
        viscosity, diffusivity, time: numbers.
        force: ``[D]``.
    """

    velocity: Array
    temperature: Optional[Array]
    viscosity: float
    diffusivity: float
    force: Array
    time: float


class Flow:
    """A flow at its end, see :func:`periodic_flow`.

    Attributes:
        velocity: of the shape of the velocity at the start.
        pressure: pressure over density, mean 0, ``[N, N]`` or ``[N, N, N]``.
        temperature: the same; None without heat.
        sizes: of the steps in time that were taken.
    """

    velocity: Array
    pressure: Array
    temperature: Optional[Array]
    sizes: Array

    def __init__(self, native: _native.Flow) -> None:
        self._native = native
        end = native.end()
        self.velocity, self.pressure, self.temperature = end["velocity"], end["pressure"], end["temperature"]
        self.sizes = end["sizes"]

    def vjp(self, velocity: npt.ArrayLike, temperature: Optional[npt.ArrayLike] = None) -> FlowGradient:
        """The derivative of a number, given that by the velocity (and the temperature) at the end.

        It is that of the steps that were taken, exactly; their sizes count as given.
        """
        by_temperature = None if temperature is None else _array(temperature)
        return FlowGradient(**self._native.vjp(_array(velocity), by_temperature))

    def __repr__(self) -> str:
        return f"<hydrograd.Flow on {' x '.join(map(str, self.pressure.shape))} particles, {len(self.sizes)} steps>"


def _array(values: npt.ArrayLike) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def periodic_flow(
    velocity: npt.ArrayLike,
    *,
    viscosity: float,
    time: float,
    size: Union[float, Sequence[float]] = 2 * np.pi,
    force: Optional[Sequence[float]] = None,
    temperature: Optional[npt.ArrayLike] = None,
    diffusivity: float = 0.0,
    buoyancy: Optional[tuple[Sequence[float], float]] = None,
    derivatives: str = "spectral",
    tolerance: float = 1e-6,
    step: Optional[float] = None,
) -> Flow:
    """Incompressible flow of density 1 in a periodic box, with fixed particles on a lattice.

    Args:
        velocity: at the start, ``[N, N, 2]`` or ``[N, N, N, 3]``: that of the particle i, j, k at i L / N, j L / N, k L / N; the
            first axis is x. Its part with a divergence is taken away.
        viscosity: kinematic viscosity, 0 or more.
        time: how long the flow goes on.
        size: lengths of the box, L; a number is that along x, and the spacing of particles is the same along all axes.
        force: body force per mass, ``[D]``.
        temperature: at the start, ``[N, N]`` or ``[N, N, N]``; None: no heat.
        diffusivity: thermal diffusivity.
        buoyancy: ``(by, at)``: the acceleration ``by * (temperature - at)``, ``by`` being ``[D]``.
        derivatives: "spectral" (of all modes exactly) or "fits" (of fourth order, by the 24 or 124 nearest particles).
        tolerance: error of a step in time, root mean square over that of the velocity.
        step: a size for all steps instead.

    Raises:
        ValueError: input that can not be.
        Diverged: a flow that is not finite.
    """
    if derivatives not in ("spectral", "fits"):
        raise ValueError(f"derivatives = {derivatives!r}\n  allowed: spectral, fits")
    start = _array(velocity)
    dimension = start.ndim - 1
    spacing = float(size) / start.shape[0] if isinstance(size, (int, float)) else 0.0
    lengths = [spacing * n for n in start.shape[:-1]] if isinstance(size, (int, float)) else [float(x) for x in size]
    native = _native.Flow(
        start,
        None if temperature is None else _array(temperature),
        lengths,
        float(time),
        [float(viscosity), float(diffusivity), float(tolerance), 0.0 if step is None else float(step)],
        [0.0] * dimension if force is None else [float(x) for x in force],
        None if buoyancy is None else ([float(x) for x in buoyancy[0]], float(buoyancy[1])),
        derivatives == "fits",
    )
    return Flow(native)
