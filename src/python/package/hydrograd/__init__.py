"""Differentiable particle flow: weakly compressible SPH with heat, and the exact gradient by the shape of the walls.

>>> import hydrograd
>>> scene = hydrograd.Scene("heated-channel")
>>> q, gradient = scene.value_and_gradient(scene.design)

A :class:`Scene` simulates, differentiates and optimises; everything comes as NumPy arrays. ``hydrograd.torch`` and
``hydrograd.jax`` make it a function that PyTorch and JAX differentiate through, ``hydrograd.tesseract`` the endpoints of a
Tesseract. :func:`periodic_flow` goes from a velocity field to a velocity field. ``python -m hydrograd`` is the command line.
"""

from __future__ import annotations

import importlib
from types import ModuleType

from ._native import Diverged, __version__, set_threads
from .flow import Flow, FlowGradient, periodic_flow
from .learned import Prediction, Rollout, Trajectory, read_trajectory, rollout
from .scene import Frames, Optimisation, Run, Scene, Steady, Unsteady, presets, scenes

__all__ = [
    "Diverged",
    "Flow",
    "FlowGradient",
    "Frames",
    "Optimisation",
    "Prediction",
    "Rollout",
    "Run",
    "Scene",
    "Steady",
    "Unsteady",
    "Trajectory",
    "__version__",
    "periodic_flow",
    "presets",
    "read_trajectory",
    "rollout",
    "scenes",
    "set_threads",
]


def __getattr__(name: str) -> ModuleType:
    # PyTorch and JAX take a second to import: only who asks for them waits.
    if name in ("jax", "mosaic", "tesseract", "torch"):
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
