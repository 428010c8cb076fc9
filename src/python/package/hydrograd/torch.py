"""The solver as a function that PyTorch differentiates through.

>>> q = hydrograd.torch.objective(scene)
>>> design = torch.tensor(scene.design, requires_grad=True)
>>> q(design).backward()
>>> design.grad  # equals scene.value_and_gradient(design)[1] to the bit
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Optional

import numpy as np

from .scene import Progress, Scene

try:
    import torch
    from torch.autograd import Function
except ImportError as error:
    raise ImportError(f"hydrograd.torch needs PyTorch, which can not be imported ({error}): pip install torch") from error

__all__ = ["objective"]


class _Objective(Function):
    """The value; its gradient is found with it, and kept."""

    @staticmethod
    def forward(ctx: Any, design: torch.Tensor, of: Callable[..., tuple[float, Any]], value_of: Callable[..., float]) -> torch.Tensor:
        # Shares the memory if it is in double precision on the CPU.
        numbers = design.detach().to("cpu", torch.float64).numpy()
        if ctx.needs_input_grad[0]:
            value, found = of(numbers)
            gradient = torch.from_numpy(found).to(design.device, design.dtype)
            ctx.save_for_backward(design, gradient)
        else:
            value = value_of(numbers)
        return torch.tensor(value, dtype=design.dtype, device=design.device)

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor) -> tuple[Optional[torch.Tensor], None, None]:
        design, gradient = ctx.saved_tensors
        return _Gradient.apply(design, cotangents[0], gradient), None, None


class _Gradient(Function):
    """The cotangent times the gradient, which can not be differentiated again."""

    @staticmethod
    def forward(ctx: Any, design: torch.Tensor, cotangent: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
        return cotangent * gradient

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor) -> Any:
        raise NotImplementedError(
            "hydrograd has first derivatives only, so the gradient of its objective can not be differentiated again "
            "(create_graph=True, torch.autograd.functional.hessian); take differences of scene.value_and_gradient"
        )


def objective(
    scene: Scene,
    *,
    loss: bool = False,
    progress: Optional[Progress] = None,
) -> Callable[[torch.Tensor], torch.Tensor]:
    """The objective of a scene as a function of a tensor ``[K]`` of design variables.

    Its gradient is that of :meth:`hydrograd.Scene.value_and_gradient` to the bit where the tensor is in double precision; for
    others it is computed in double precision and rounded. The flow is computed on the CPU, whatever the tensor's device is.

    Args:
        scene: a scene with a design.
        loss: take what ``hydrograd optimize`` makes small instead, :meth:`hydrograd.Scene.loss_and_gradient`.
        progress: see :meth:`hydrograd.Scene.value_and_gradient`.
    """
    scene._native.require_design()

    def both(design: Any) -> tuple[float, Any]:
        found = scene.loss_and_gradient if loss else scene.value_and_gradient
        return found(design, progress=progress)

    def value(design: Any) -> float:
        return both(design)[0] if loss else scene.objective(design)

    def evaluate(design: torch.Tensor) -> torch.Tensor:
        if not isinstance(design, torch.Tensor):
            raise TypeError(f"a design is a torch.Tensor [K] here, not {type(design).__name__}: torch.tensor(scene.design)")
        if not design.is_floating_point():
            raise TypeError(f"a design is of floating-point numbers, not {design.dtype}")
        found = _Objective.apply(design, both, value)
        assert isinstance(found, torch.Tensor)
        return found

    return evaluate
