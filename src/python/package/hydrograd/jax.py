"""The solver as a function that JAX differentiates through, also under ``jit`` and, one after the other, ``vmap``.

>>> jax.config.update("jax_enable_x64", True)
>>> q = hydrograd.jax.objective(scene)
>>> jax.grad(q)(jax.numpy.asarray(scene.design))  # equals scene.value_and_gradient(scene.design)[1] to the bit
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from .scene import Scene

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:
    raise ImportError(f"hydrograd.jax needs JAX, which can not be imported ({error}): pip install jax") from error

__all__ = ["objective"]

_Shape: Any = jax.ShapeDtypeStruct


def objective(scene: Scene, *, loss: bool = False) -> Callable[[Any], Any]:
    """The objective of a scene as a function of an array ``[K]`` of design variables.

    Its gradient is that of :meth:`hydrograd.Scene.value_and_gradient` to the bit if JAX computes in double precision
    (``jax.config.update("jax_enable_x64", True)``); otherwise it is computed in double precision and rounded, and a design in
    double precision that JAX would round is warned of. Reverse mode only, and no second derivatives. JAX calls from a thread of
    its own, where Python looks for Ctrl-C only after the evaluation.

    Args:
        scene: a scene with a design.
        loss: take what ``hydrograd optimize`` makes small instead, :meth:`hydrograd.Scene.loss_and_gradient`.
    """
    scene._native.require_design()

    def both(design: Any) -> tuple[Any, Any]:
        design = np.asarray(design)
        found = scene.loss_and_gradient if loss else scene.value_and_gradient
        value, gradient = found(design)
        return np.asarray(value, dtype=design.dtype), np.asarray(gradient, dtype=design.dtype)

    def value(design: Any) -> Any:
        design = np.asarray(design)
        return np.asarray(scene.loss_and_gradient(design)[0] if loss else scene.objective(design), dtype=design.dtype)

    @jax.custom_vjp
    def evaluate(design: Any) -> Any:
        like = _Shape((), design.dtype)
        return jax.pure_callback(value, like, design, vmap_method="sequential")

    def forward(design: Any) -> tuple[Any, Any]:
        like = _Shape((), design.dtype), _Shape(design.shape, design.dtype)
        found: tuple[Any, Any] = jax.pure_callback(both, like, design, vmap_method="sequential")
        return found

    def backward(gradient: Any, cotangent: Any) -> tuple[Any]:
        return (cotangent * gradient,)

    evaluate.defvjp(forward, backward)

    def checked(design: Any) -> Any:
        if getattr(design, "dtype", None) == np.float64 and not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
            warnings.warn(
                'JAX rounds this design to single precision: jax.config.update("jax_enable_x64", True) before anything else',
                stacklevel=2,
            )
        design = jnp.asarray(design)
        if not jnp.issubdtype(design.dtype, jnp.floating):
            raise TypeError(f"a design is of floating-point numbers, not {design.dtype}")
        if design.ndim != 1:
            raise ValueError(f"a design has one axis, [K], not the shape {design.shape}; jax.vmap goes over more")
        return evaluate(design)

    return checked
