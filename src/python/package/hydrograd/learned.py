"""Data sets, and what learned models predict of them."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from typing import Optional, Union

import numpy as np
import numpy.typing as npt

from . import _native

Path = Union[str, os.PathLike[str]]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory of a data set: T frames of N particles in D dimensions."""

    name: str
    position: npt.NDArray[np.float32]
    """``[T, N, D]``."""
    kind: npt.NDArray[np.int32]
    """``[N]``, LagrangeBench's particle types: 0 fluid, 1 wall, 2 moving wall."""
    temperature: Optional[npt.NDArray[np.float32]]
    """``[T, N]``; None without heat."""
    wall_x: npt.NDArray[np.float64]
    """``[M]``: nodes of the wall's shape; empty without one."""
    wall_offset: npt.NDArray[np.float64]
    """``[M]``: its height there."""
    frame_time: float
    """Time between frames."""
    spacing: float
    """Of the particles."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted frames, or the true ones beside them."""

    position: npt.NDArray[np.float64]
    """``[T, N, D]``."""
    temperature: Optional[npt.NDArray[np.float64]]
    """``[T, N]``; None without heat."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """What a model predicts of a trajectory, frame after frame from its own frames."""

    predicted: Prediction
    truth: Prediction
    kind: npt.NDArray[np.int32]
    """``[N]``, see :class:`Trajectory`."""
    broken: Optional[str]
    """Where and why the model gave no usable frame; None if it gave all."""
    seconds: float
    """Spent in the model."""

    @property
    def position_error(self) -> npt.NDArray[np.float64]:
        """Mean squared error of the positions of fluid particles, ``[T]``. (Positions are wrapped into a periodic box: the
        nearest image is not looked for.)"""
        fluid = self.kind == 0
        difference = self.predicted.position[:, fluid] - self.truth.position[:, fluid]
        found: npt.NDArray[np.float64] = np.mean(difference**2, axis=(1, 2))
        return found


def read_trajectory(data: Path, split: str = "valid", trajectory: Optional[str] = None) -> Trajectory:
    """Reads a trajectory of a data set of ``hydrograd generate`` or of LagrangeBench's.

    Args:
        data: the folder: metadata.json, train.h5, valid.h5, test.h5.
        split: ``train``, ``valid`` or ``test``.
        trajectory: its name; the first if None.
    """
    return Trajectory(**_native.read_trajectory(os.fspath(data), split, trajectory))


def rollout(
    model: Path,
    data: Path,
    frames: int = 20,
    *,
    split: str = "valid",
    trajectory: Optional[str] = None,
    start: int = 0,
) -> Rollout:
    """What a model predicts from six true frames on, as ``hydrograd rollout`` does, and the truth beside it.

    Args:
        model: a file of ``hydrograd train``, LagrangeBench's weights, ``linear`` (constant velocity), ``still`` (no change), or
            one that comes with the package: ``heated-channel``, ``taylor-green``.
        data, split, trajectory: see :func:`read_trajectory`.
        frames: how many to predict.
        start: first of the six true frames that the model sees.
    """
    found = _native.rollout(os.fspath(model), os.fspath(data), split, trajectory, int(start), int(frames))
    unlike = found.pop("unlike")
    if unlike is not None:
        warnings.warn(f"{unlike}: its predictions mean little there", stacklevel=2)
    predicted, truth = Prediction(**found.pop("predicted")), Prediction(**found.pop("truth"))
    return Rollout(predicted=predicted, truth=truth, **found)
