"""Differentiable particle flow: weakly compressible SPH with heat, and the exact gradient by the shape of the walls.

>>> import hydrograd
>>> scene = hydrograd.Scene("heated-channel")
>>> q, gradient = scene.value_and_gradient(scene.design)

A :class:`Scene` simulates, differentiates and optimises; everything comes as NumPy arrays. ``hydrograd.torch`` and
``hydrograd.jax`` make it a function that PyTorch and JAX differentiate through, ``hydrograd.mosaic`` the two endpoints that the
Mosaic benchmark asks for. ``python -m hydrograd`` is the command line.
"""

from __future__ import annotations

import importlib
from types import ModuleType

from ._native import Diverged, __version__, set_threads
from .learned import Prediction, Rollout, Trajectory, read_trajectory, rollout
from .scene import Frames, Optimisation, Run, Scene, Steady, presets, scenes

__all__ = [
    "Diverged",
    "Frames",
    "Optimisation",
    "Prediction",
    "Rollout",
    "Run",
    "Scene",
    "Steady",
    "Trajectory",
    "__version__",
    "presets",
    "read_trajectory",
    "rollout",
    "scenes",
    "set_threads",
]


def __getattr__(name: str) -> ModuleType:
    # PyTorch and JAX take a second to import: only who asks for them waits.
    if name in ("jax", "mosaic", "torch"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
