from os import PathLike
from typing import Any, Callable, Optional, Union, final

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[np.float64]
_Path = Union[str, PathLike[str]]

__all__ = [
    "Diverged",
    "Flow",
    "Scene",
    "__version__",
    "command_line",
    "presets",
    "read_trajectory",
    "rollout",
    "scenes",
    "set_threads",
]

__version__: str

class Diverged(RuntimeError):
    """A run whose numbers left all bounds: its input is not one to use, but another may be.

    Where that was found; None if that is not known.
    """

    step: Optional[int]
    particle: Optional[int]
    position: Optional[list[float]]
    """Of the particle, in the last state that was good."""
    quantity: Optional[str]
    value: Optional[float]

def scenes() -> list[tuple[str, str]]: ...
def presets() -> list[tuple[str, str]]: ...
def set_threads(threads: int) -> None:
    """Sets the number of worker threads, 0 for every core that the process may use; before anything has run in this process."""

def command_line(program: list[str], arguments: list[str]) -> int: ...
def rollout(
    model_name: str, data: _Path, split: str, trajectory: Optional[str], start: int, steps: int
) -> dict[str, Any]: ...
def read_trajectory(data: _Path, split: str, trajectory: Optional[str]) -> dict[str, Any]: ...

@final
class Flow:
    def __new__(
        cls,
        velocity: _Array,
        temperature: Optional[_Array],
        size: list[float],
        time: float,
        numbers_of: list[float],
        force: list[float],
        buoyancy: Optional[tuple[list[float], float]],
        fits: bool,
    ) -> Flow: ...
    def end(self) -> dict[str, Any]: ...
    def vjp(self, velocity: _Array, temperature: Optional[_Array]) -> dict[str, Any]: ...

@final
class Scene:
    def __new__(cls, scene: str, preset: Optional[str], settings: list[str]) -> Scene: ...
    @property
    def text(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def dimension(self) -> int: ...
    @property
    def has_design(self) -> bool: ...
    def require_design(self) -> None: ...
    def design(self) -> dict[str, Any]: ...
    def nearest(self, design: _Array) -> _Array: ...
    def wall(self, design: _Array) -> tuple[_Array, _Array]: ...
    def simulate(
        self, design: Optional[_Array], frames: int, progress: Optional[Callable[..., object]]
    ) -> dict[str, Any]: ...
    def objective(self, design: _Array) -> float: ...
    def steady(self, numbers: Optional[_Array], gradient: bool, by_grid: Optional[_Array]) -> dict[str, Any]: ...
    def unsteady(
        self,
        numbers: Optional[_Array],
        gradient: bool,
        by_grid: Optional[_Array],
        velocity: Optional[_Array],
        progress: Optional[Callable[..., object]],
    ) -> dict[str, Any]: ...
    def value_and_gradient(
        self, design: _Array, progress: Optional[Callable[..., object]]
    ) -> tuple[float, _Array]: ...
    def loss_and_gradient(
        self, design: _Array, progress: Optional[Callable[..., object]]
    ) -> tuple[float, _Array]: ...
    def verify(
        self, best: _Array, first: Optional[_Array], progress: Optional[Callable[..., object]]
    ) -> str: ...
    def optimise(
        self, first: Optional[_Array], epochs: Optional[int], progress: Optional[Callable[..., object]]
    ) -> dict[str, Any]: ...
