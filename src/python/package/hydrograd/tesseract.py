"""hydrograd's designs as a Tesseract: a scene and the numbers of its design in, the objective and its gradient out.

A whole ``tesseract_api.py`` is ``from hydrograd.tesseract import *``; its schemas are there where ``tesseract_core`` is installed.
(Flow from a velocity field to a velocity field, as the Mosaic benchmark has it, is in the folder ``navier_stokes_grid``.)

Inputs (a mapping, or an object that has ``model_dump``): ``design`` ``[K]``, and what :class:`hydrograd.Scene` takes: ``scene``,
``preset``, ``settings``. Outputs: ``q``, the objective.

>>> inputs = {"scene": "heated-channel", "design": design}
>>> apply(inputs)
{'q': array(0.02343...)}
>>> vjp(inputs, {"design"}, {"q"}, {"q": 1.0})
{'design': array([...])}
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from .scene import Scene

__all__ = ["abstract_eval", "apply", "vector_jacobian_product", "vjp"]

_INPUTS, _OUTPUTS = ("design",), ("q",)


@lru_cache(maxsize=8)
def _scene(scene: str, preset: Any, settings: str) -> Scene:
    return Scene(scene, preset, json.loads(settings))


def _read(inputs: Any) -> tuple[Scene, Any]:
    """The scene, built once, and the design."""
    given: Mapping[str, Any] = inputs.model_dump() if hasattr(inputs, "model_dump") else inputs
    unknown = sorted(set(given) - {"scene", "preset", "settings", "design"})
    if unknown:
        raise ValueError(f"unknown input {unknown[0]!r}\n  allowed: scene, preset, settings, design")
    settings = json.dumps(given.get("settings") or {}, sort_keys=True, default=lambda array: np.asarray(array).tolist())
    scene = _scene(str(given.get("scene") or "heated-channel"), given.get("preset"), settings)
    design = given.get("design")
    return scene, scene.design if design is None else np.asarray(design, dtype=np.float64)


def _one_of(names: Iterable[str], allowed: tuple[str, ...], what: str) -> set[str]:
    asked = set(names)
    wrong = sorted(asked - set(allowed))
    if wrong:
        raise ValueError(f"{what} {wrong[0]!r} can not be differentiated\n  allowed: {', '.join(allowed)}")
    return asked


def apply(inputs: Any) -> Any:
    """The objective of a design."""
    scene, design = _read(inputs)
    return {"q": np.asarray(scene.objective(design))}


def vector_jacobian_product(
    inputs: Any,
    vjp_inputs: Iterable[str],
    vjp_outputs: Iterable[str],
    cotangent_vector: Mapping[str, Any],
) -> dict[str, Any]:
    """The cotangents of the inputs from those of the outputs."""
    asked = _one_of(vjp_inputs, _INPUTS, "input")
    if not asked:
        return {}
    scene, design = _read(inputs)
    if not _one_of(vjp_outputs, _OUTPUTS, "output"):
        return {"design": np.zeros_like(design)}
    return {"design": scene.vjp(design, float(np.asarray(cotangent_vector["q"]).reshape(())))}


#: The same by its short name.
vjp = vector_jacobian_product


def abstract_eval(abstract_inputs: Any) -> dict[str, Any]:
    """Shapes and types of the outputs."""
    return {"q": {"shape": (), "dtype": "float64"}}


try:
    from pydantic import BaseModel, Field
    from tesseract_core.runtime import Array, Differentiable, Float64  # type: ignore[import-untyped, unused-ignore]
except ImportError:
    pass
else:
    __all__ += ["InputSchema", "OutputSchema"]

    class InputSchema(BaseModel):
        """What :func:`apply` takes."""

        design: Differentiable[Array[(None,), Float64]] = Field(description="Design variables, [K].")
        scene: str = Field(description="A built-in scene, or the path of a TOML file.", default="heated-channel")
        preset: str | None = Field(description="A preset.", default=None)
        settings: dict[str, Any] = Field(description="Dotted keys and their values.", default_factory=dict)

    class OutputSchema(BaseModel):
        """What :func:`apply` gives."""

        q: Differentiable[Float64] = Field(description="The objective: more is better.")
