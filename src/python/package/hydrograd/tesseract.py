"""hydrograd's designs as a Tesseract: a scene and the numbers of its design in, the objective and its gradient out.

A whole ``tesseract_api.py`` is ``from hydrograd.tesseract import *``; its schemas are there where ``tesseract_core`` is installed.
(Flow from a velocity field to a velocity field, as the Mosaic benchmark has it, is in the folder ``navier_stokes_grid``.)

Inputs (a mapping, or an object that has ``model_dump``): ``design`` ``[K]``, what :class:`hydrograd.Scene` takes: ``scene`` (a name,
or the path of a scene of one's own), ``preset``, ``settings``; and ``figures``. Outputs: ``q``, the objective, and, if they are asked for,
``figures``, all that ``summary.json`` has. Of a scene of one's own whose particles are fixed and whose flow is steady ``design`` are the
numbers of its ``variables`` in their own units.

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


def _is_steady(scene: Scene) -> bool:
    """Whether it is a scene of one's own with fixed particles and a steady flow."""
    method = scene.text.partition("\n[method]\n")[2].partition("\n[")[0]
    return scene.name == "custom" and '\nname = "fixed"' in method and '\nflow = "unsteady"' not in method


def _read(inputs: Any) -> tuple[Scene, Any, bool]:
    """The scene, built once, the design, and whether figures are wanted."""
    given: Mapping[str, Any] = inputs.model_dump() if hasattr(inputs, "model_dump") else inputs
    known = ("scene", "preset", "settings", "design", "figures")
    unknown = sorted(set(given) - set(known))
    if unknown:
        raise ValueError(f"unknown input {unknown[0]!r}\n  allowed: {', '.join(known)}")
    settings = json.dumps(given.get("settings") or {}, sort_keys=True, default=lambda array: np.asarray(array).tolist())
    scene = _scene(str(given.get("scene") or "heated-channel"), given.get("preset"), settings)
    design = given.get("design")
    if design is None:
        design = scene.steady(gradient=False).numbers if _is_steady(scene) else scene.design
    return scene, np.asarray(design, dtype=np.float64), bool(given.get("figures"))


def _one_of(names: Iterable[str], allowed: tuple[str, ...], what: str) -> set[str]:
    asked = set(names)
    wrong = sorted(asked - set(allowed))
    if wrong:
        raise ValueError(f"{what} {wrong[0]!r} can not be differentiated\n  allowed: {', '.join(allowed)}")
    return asked


def apply(inputs: Any) -> Any:
    """The objective of a design. Figures are those of a run of the scene's own particles, which they cost where the flow is not steady."""
    scene, design, wants_figures = _read(inputs)
    if _is_steady(scene):
        steady = scene.steady(design, gradient=False)
        found: dict[str, Any] = {"q": np.asarray(steady.objective)}
        return {**found, "figures": steady.figures} if wants_figures else found
    found = {"q": np.asarray(scene.objective(design))}
    return {**found, "figures": scene.simulate(design).figures} if wants_figures else found


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
    scene, design, _ = _read(inputs)
    if not _one_of(vjp_outputs, _OUTPUTS, "output"):
        return {"design": np.zeros_like(design)}
    weight = float(np.asarray(cotangent_vector["q"]).reshape(()))
    if _is_steady(scene):
        return {"design": weight * np.asarray(scene.steady(design).gradient)}
    return {"design": scene.vjp(design, weight)}


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
        figures: bool = Field(description="Whether figures are wanted.", default=False)

    class OutputSchema(BaseModel):
        """What :func:`apply` gives."""

        q: Differentiable[Float64] = Field(description="The objective.")
        figures: dict[str, Any] = Field(description="What summary.json has, if it was asked for.", default_factory=dict)
