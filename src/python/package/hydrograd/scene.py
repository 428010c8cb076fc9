"""Scenes: what is simulated, differentiated and optimised."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Optional, Union

import numpy as np
import numpy.typing as npt

from . import _native
from ._settings import assignments

Array = npt.NDArray[np.float64]
ArrayLike = npt.ArrayLike

#: Called with how much is done, and of how much: steps, or shares of 1.
Progress = Callable[[float, float], object]


def scenes() -> dict[str, str]:
    """Names of the built-in scenes, and what they are."""
    return dict(_native.scenes())


def presets() -> dict[str, str]:
    """Names of the presets, and what they set."""
    return dict(_native.presets())


@dataclass(frozen=True, eq=False)
class Frames:
    """States of a run on its way: T frames of N particles in D dimensions."""

    time: Array
    """``[T]``."""
    position: Array
    """``[T, N, D]``."""
    velocity: Array
    """``[T, N, D]``."""
    temperature: Optional[Array]
    """``[T, N]``; None without heat."""


@dataclass(frozen=True, eq=False)
class Run:
    """A simulation at its end: N particles in D dimensions, walls included."""

    figures: dict[str, Any]
    """What ``summary.json`` of ``hydrograd simulate`` has: averages over the objective's window, or of a flow with an exact
    solution its errors; ``steps``, ``time_step`` and ``seconds``."""
    time: float
    step: int
    box: list[float]
    """Lengths of the box."""
    position: Array
    """``[N, D]``, as are velocities: a view of numbers that lie as ``[D, N]``."""
    velocity: Array
    temperature: Optional[Array]
    """``[N]``, as are the following; None without heat."""
    density: Array
    pressure: Array
    mass: Array
    tag: npt.NDArray[np.uint8]
    """What a particle is: 0 fluid, others are kinds of walls."""
    history: dict[str, Array] = field(repr=False)
    """Columns of ``history.csv``: about 400 rows over the run."""
    frames: Optional[Frames] = field(repr=False)
    """What was asked for as ``frames``."""

    @property
    def q(self) -> Optional[float]:
        """Outflowing heat, averaged over the objective's window; None in a scene without a design."""
        return self.figures.get("q")

    @property
    def is_fluid(self) -> npt.NDArray[np.bool_]:
        """``[N]``."""
        fluid: npt.NDArray[np.bool_] = self.tag == 0
        return fluid

    def __repr__(self) -> str:
        count, dimension = self.position.shape
        q = "" if self.q is None else f", q={self.q:.6f}"
        return f"<hydrograd.Run of {count} particles in {dimension}D, t={self.time:.4g}{q}>"


@dataclass(frozen=True, eq=False)
class Optimisation:
    """An optimisation at its end: E epochs of K design variables."""

    design_best: Array
    """``[K]``."""
    q_best: float
    best: int
    """The epoch of the best design."""
    designs: Array
    """``[E, K]``."""
    q_per_epoch: Array
    """``[E]``, as are the following, by whoever judged the epoch; not a number where the run of a design diverged."""
    q_predicted_per_epoch: Array
    """What a learned model predicted (``optimise.dynamics``); not a number where none was asked."""
    q_solver_per_epoch: Array
    """What the solver says; not a number where it was not asked."""
    loss_per_epoch: Array
    gradient_norm_per_epoch: Array
    seconds_per_epoch: Array
    is_done: bool
    """Whether the optimiser stopped by itself: no design near by is better."""

    def __repr__(self) -> str:
        first, epochs = self.q_per_epoch[0], len(self.q_per_epoch)
        return f"<hydrograd.Optimisation: {first:.6f} -> {self.q_best:.6f} in epoch {self.best + 1} of {epochs}>"


@dataclass(frozen=True, eq=False)
class Steady:
    """The steady flow of fixed particles around shapes, see :meth:`Scene.steady`.

    Attributes:
        objective: the objective's value.
        gradient: its exact derivative by each of ``numbers`` (per degree for angles), ``[K]``; None if it was not asked for.
        viscosity_gradient: that by ``fluid.viscosity``, together with ``gradient``.
        numbers: the numbers of shapes that it belongs to, ``[K]``.
        variables: their names, such as ``shapes[0].radius``.
        figures: as in ``summary.json``: ``flow_rate``, ``shapes`` (``force``, ``torque``, ``heat`` of each) and more.
        position, velocity: ``[N, 2]``.
        pressure: ``[N]``.
        temperature: ``[N]``; None without heat.
        tag: ``[N]``, 0 for fluid, others for walls.
        grid_velocity: on the scene's ``output.grid``, ``[N, N, 2]``, NaN inside of shapes; None without a grid.
    """

    objective: float
    gradient: Optional[Array]
    viscosity_gradient: Optional[float]
    numbers: Array
    variables: list[str]
    figures: dict[str, Any]
    position: Array
    velocity: Array
    pressure: Array
    temperature: Optional[Array]
    tag: npt.NDArray[np.uint8]
    grid_velocity: Optional[Array]


@dataclass(frozen=True, eq=False)
class Unsteady(Steady):
    """A flow in time of fixed particles around shapes, at its end, see :meth:`Scene.unsteady`.

    The objective, and figures, are means over the objective's window.

    Attributes:
        history: ``time``, and figures after each step, such as ``shapes[0].drag``.
        velocity_gradient: the derivative by the velocity at the start, of its shape; None if that was not given as an array.
    """

    history: dict[str, Array] = field(repr=False)
    velocity_gradient: Optional[Array] = None


class Scene:
    """A flow to simulate, and where it has walls to shape, to differentiate and to optimise.

    Names, keys and units are those of the command line: ``hydrograd scenes heated-channel`` prints every key with a comment.

    Args:
        scene: name of a built-in scene (:func:`scenes`), path of a TOML file, or a scene of one's own as a dict of its
            sections and keys, such as ``{"region": {"size": [1, 0.4]}, "shapes": [{"kind": "disc", ...}]}``.
        preset: name of a preset (:func:`presets`).
        settings: dotted keys and their values, such as ``{"resolution.dx": 0.04}``.
        **more: the same as keywords, ``**{"time.end": 2}``; they win.

    Raises:
        ValueError: something in the configuration that can not be, with what is allowed and what to try.

    Numbers do not depend on the number of threads: the scene's ``run.threads`` and :func:`set_threads` count before the first
    run of the process.
    """

    def __init__(
        self,
        scene: Union[str, os.PathLike[str], Mapping[str, Any]] = "heated-channel",
        preset: Optional[str] = None,
        settings: Optional[Mapping[str, Any]] = None,
        **more: Any,
    ) -> None:
        if isinstance(scene, Mapping):
            settings = {**_flat(scene), **(settings or {})}
            scene = settings.pop("scene", "custom")
        self._arguments = (os.fspath(scene), preset, {**(settings or {}), **more})
        self._native = _native.Scene(os.fspath(scene), preset, assignments(settings or {}, more))
        self._known: Optional[dict[str, Any]] = None

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), self._arguments)

    def __repr__(self) -> str:
        scene, preset, settings = self._arguments
        parts = [repr(scene)]
        if preset is not None:
            parts.append(f"preset={preset!r}")
        if settings:
            parts.append(f"settings={settings!r}")
        return f"hydrograd.Scene({', '.join(parts)})"

    @property
    def name(self) -> str:
        """The scene's family, such as ``heated-channel``."""
        return self._native.name

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._native.dimension

    @property
    def text(self) -> str:
        """The whole configuration as TOML, with a comment on every key: a file of it is the same scene."""
        return self._native.text

    @property
    def has_design(self) -> bool:
        """Whether there is something to differentiate by and to optimise."""
        return self._native.has_design

    def _design(self) -> dict[str, Any]:
        if self._known is None:
            self._native.require_design()
            self._known = self._native.design()
        return self._known

    @property
    def design(self) -> Array:
        """The design variables to begin with, ``[K]``: offsets of the wall at its nodes, control points, or of a scene of your
        own shares of the way between the limits of the numbers that its ``variables`` name."""
        return np.array(self._design()["first"])

    @property
    def bounds(self) -> Array:
        """Lower and upper limits of the variables, ``[K, 2]``, as SciPy takes them. See :meth:`nearest` for what else is held."""
        known = self._design()
        return np.stack([known["lower"], known["upper"]], axis=1)

    @property
    def nodes(self) -> Array:
        """x of the place where each variable acts, ``[K]``; numbers of shapes have none and are counted."""
        return np.array(self._design()["nodes"])

    @property
    def nodes_z(self) -> Optional[Array]:
        """z of these places where the wall varies along z; else None."""
        across = self._design()["across"]
        return None if across is None else np.array(across)

    @property
    def variables(self) -> list[str]:
        """Names of the numbers of shapes in a scene of your own; else empty."""
        return list(self._design()["names"])

    @property
    def symbol(self) -> str:
        """What the objective is called, such as ``Q``."""
        return str(self._design()["symbol"])

    @property
    def quantity(self) -> str:
        """What the objective is, such as ``outflowing heat``; more of it is better."""
        return str(self._design()["quantity"])

    def nearest(self, design: ArrayLike) -> Array:
        """The nearest design that is allowed: within :attr:`bounds`, and neighbours that differ by at most twice their
        distance. To be called after each step of an optimiser that knows no limits."""
        return self._native.nearest(_numbers(design))

    def wall(self, design: Optional[ArrayLike] = None) -> tuple[Array, Array]:
        """Points of a design's wall: places along x and offsets there, as ``shape.csv`` has them. (Of a scene of your own:
        counts, and the numbers of its shapes.)"""
        return self._native.wall(_numbers(self.design if design is None else design))

    def simulate(
        self,
        design: Optional[ArrayLike] = None,
        *,
        frames: int = 0,
        progress: Optional[Progress] = None,
    ) -> Run:
        """Runs the scene forward, as ``hydrograd simulate`` does, and writes no files.

        Args:
            design: ``[K]``; the scene's own if None.
            frames: about how many states on the way to keep.
            progress: called with the steps that are done and all steps, at most ten times a second.

        Raises:
            Diverged: the run's numbers left all bounds.
            KeyboardInterrupt: Ctrl-C, within a tenth of a second.
        """
        given = None if design is None else _numbers(design)
        found = self._native.simulate(given, int(frames), progress)
        kept = found.pop("frames", None)
        figures = json.loads(found.pop("figures"))
        return Run(figures=figures, frames=None if kept is None else Frames(**kept), **found)

    def errors(self, accuracy: Optional[float] = None) -> dict[str, Any]:
        """How far the figures of this scene may be off, as ``hydrograd simulate --error`` finds it: the scene runs here and at two
        coarser spacings, each in a process of its own.

        Args:
            accuracy: the share of the first figure (Q, or the objective) that its error may be; the spacing is chosen for it. None:
                the scene's own spacing.

        Returns:
            What ``summary.json`` has: the figures, and ``errors``, a list with the ``name``, ``value``, ``error``, ``parts`` and
            ``observed_order`` of each figure that changes with the spacing. 19 of 20 true errors are smaller.

        Raises:
            ValueError: input that is bad.
            RuntimeError: a run that diverges, or an accuracy that is not reached.
        """
        how = ["--error"] if accuracy is None else ["--accuracy", repr(accuracy)]
        with tempfile.TemporaryDirectory() as folder:
            file = os.path.join(folder, "scene.toml")
            with open(file, "w", encoding="utf-8") as out:
                out.write(self.text)
            command = [sys.executable, "-m", "hydrograd", "simulate", file, *how, "--json", "--out", os.path.join(folder, "run")]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not done.stdout:
            raise ValueError(done.stderr.strip())
        found = json.loads(done.stdout)
        if found["error"] is not None:
            raise (ValueError if found["exit_code"] == 2 else RuntimeError)(found["error"])
        return dict(found["result"])

    def steady(
        self, numbers: Optional[ArrayLike] = None, *, gradient: bool = True, by_grid_velocity: Optional[ArrayLike] = None
    ) -> Steady:
        """The steady flow of a scene of one's own with ``method.name = "fixed"``, with its exact gradient.

        The particles are placed in the first call. Later ones begin with the flow of the call before, so they agree with a first one to
        the residual that Newton's method leaves, 1e-11 of that of a fluid at rest (1e-9 in space), and not to the bit.

        Args:
            numbers: ``[K]``, in the order and the units of the scene's ``variables``; the scene's own if None.
            gradient: whether to take the objective's derivative by all of them: one more, transposed solve.
            by_grid_velocity: weights of :attr:`Steady.grid_velocity`, of its shape: the gradient is that of their sum instead of the
                objective's.

        Raises:
            ValueError: particles that move, or shapes that cannot be resolved.
            Diverged: no steady flow, or particles that fold.
        """
        found = self._native.steady(_or_none(_numbers, numbers), bool(gradient), _or_none(_field, by_grid_velocity))
        return Steady(**{**found, "figures": json.loads(found["figures"])})

    def unsteady(
        self,
        numbers: Optional[ArrayLike] = None,
        *,
        gradient: bool = True,
        by_grid_velocity: Optional[ArrayLike] = None,
        velocity: Optional[ArrayLike] = None,
        progress: Optional[Progress] = None,
    ) -> Unsteady:
        """The flow in time of a scene of one's own with ``method.name = "fixed"`` and ``method.flow = "unsteady"``, with the exact gradient
        of the objective's mean along the steps that were taken.

        Args:
            numbers: ``[K]``, in the order and the units of the scene's ``variables``; the scene's own if None.
            gradient: whether to take the objective's derivative by all of them: about three more runs.
            by_grid_velocity: as of :meth:`steady`, at the end.
            velocity: what the flow begins with instead of ``initial``, ``[N, N, 2]`` of any N, entry i, j at i L / N, j L / N.
            progress: called with the share of the run that is done, and 1, at most ten times a second.

        Raises:
            ValueError: particles that move, a steady flow, or shapes that cannot be resolved.
            Diverged: a flow that is not finite, or particles that fold.
        """
        found = self._native.unsteady(
            _or_none(_numbers, numbers), bool(gradient), _or_none(_field, by_grid_velocity), _or_none(_field, velocity), progress
        )
        return Unsteady(**{**found, "figures": json.loads(found["figures"])})

    def objective(self, design: Optional[ArrayLike] = None) -> float:
        """The objective of a design, as ``hydrograd optimize`` judges it: where the scene allows, by fixed particles and their
        steady state (``optimise.search``), so it is near but not equal to :attr:`Run.q` of moving ones."""
        return self._native.objective(_numbers(self.design if design is None else design))

    def value_and_gradient(
        self,
        design: Optional[ArrayLike] = None,
        *,
        progress: Optional[Progress] = None,
    ) -> tuple[float, Array]:
        """The objective of a design and its exact derivative by the variables, ``[K]``.

        Args:
            design: ``[K]``; the scene's own if None.
            progress: called with the share of the work that is done, and 1, at most ten times a second.

        Raises:
            ValueError: a design of another length, or beyond its limits.
            Diverged: the run's numbers, or the gradient's, left all bounds.
        """
        return self._native.value_and_gradient(_numbers(self.design if design is None else design), progress)

    def loss_and_gradient(
        self,
        design: Optional[ArrayLike] = None,
        *,
        progress: Optional[Progress] = None,
    ) -> tuple[float, Array]:
        """What ``hydrograd optimize`` makes small, and its derivative: the penalty on roughness less the objective."""
        return self._native.loss_and_gradient(_numbers(self.design if design is None else design), progress)

    def vjp(self, design: ArrayLike, cotangent: float) -> Array:
        """``cotangent`` times the derivative of the objective by the variables, ``[K]``."""
        return np.asarray(cotangent, dtype=np.float64) * self.value_and_gradient(design)[1]

    def optimise(
        self,
        design: Optional[ArrayLike] = None,
        *,
        epochs: Optional[int] = None,
        progress: Optional[Callable[[int, int, float], object]] = None,
    ) -> Optimisation:
        """Improves a design as ``hydrograd optimize`` does, to the bit, and writes no files: by the scene's own optimiser
        (``optimise.method``), judged by the solver, by a learned model or by both (``optimise.dynamics``).

        Args:
            design: ``[K]`` to begin with; the scene's own if None.
            epochs: most evaluations; ``optimise.epochs`` if None.
            progress: called after each epoch with the epochs that are done, all epochs, and the objective of the last one.
        """
        first = None if design is None else _numbers(design)
        found = self._native.optimise(first, None if epochs is None else int(epochs), progress)
        best = found["best"]
        return Optimisation(
            design_best=found["designs"][best].copy(),
            q_best=float(found["q_solver"][best]),
            best=best,
            designs=found["designs"],
            q_per_epoch=found["q"],
            q_predicted_per_epoch=found["q_predicted"],
            q_solver_per_epoch=found["q_solver"],
            loss_per_epoch=found["loss"],
            gradient_norm_per_epoch=found["gradient_norm"],
            seconds_per_epoch=found["seconds"],
            is_done=found["is_done"],
        )

    optimize = optimise

    def verify(
        self,
        best: ArrayLike,
        first: Optional[ArrayLike] = None,
        *,
        progress: Optional[Progress] = None,
    ) -> dict[str, Any]:
        """Evaluates a gain again with one thing changed at a time, as ``hydrograd verify`` does: at a finer spacing, with other
        particles, over twice the time and from another seed.

        Args:
            best: ``[K]``, the design that is better.
            first: ``[K]``, the design that it is compared with; the scene's own if None.
            progress: as for :meth:`value_and_gradient`.

        Returns:
            What ``verification.json`` has: ``verification`` (a list of checks, each with both objectives and the ``gain``), ``gain`` at the finer spacing,
            ``gain_error`` with its parts ``gain_error_parts``, ``gain_survives``, the gain less its error, and whether it is ``proved``;
            ``q_error``, the error of the best design's objective.
        """
        return dict(json.loads(self._native.verify(_numbers(best), None if first is None else _numbers(first), progress)))


def _flat(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Sections and keys as dotted keys; lists of shapes and the like are values."""
    found: dict[str, Any] = {}
    for key, value in scene.items():
        if isinstance(value, Mapping):
            found.update({f"{key}.{inner}": one for inner, one in value.items()})
        else:
            found[key] = value
    return found


def _or_none(convert: Callable[[ArrayLike], Array], given: Optional[ArrayLike]) -> Optional[Array]:
    return None if given is None else convert(given)


def _field(given: ArrayLike) -> Array:
    return np.asarray(given, dtype=np.float64)


def _numbers(design: ArrayLike) -> Array:
    """A design as the solver takes it, ``[K]`` in double precision."""
    try:
        found = np.ascontiguousarray(design, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"a design is an array of numbers, [K]: {error}") from None
    if np.ndim(design) != 1:
        raise ValueError(f"a design has one axis, [K], not the shape {np.shape(design)}")
    return found
