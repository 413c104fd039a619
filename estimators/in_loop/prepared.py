"""Recordings of servos as prepared data: followed in the loop from their goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from estimators.in_loop.regression import LoopRegression
from estimators.in_loop.rollouts import Rollouts
from estimators.in_loop.screen import LoopScreen
from estimators.selection.data import PreparedData
from estimators.selection.errors import Errors
from estimators.simulation.free_running import Segments
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.recording import Recording


@dataclass(frozen=True, eq=False)
class InLoop:
    """Recordings of servos, ready to be compared with models in the loop.

    Attributes:
        data: their rollouts.
        windows: the same recordings as windowed equations.
        guide: the fitted recordings, by whose fit these have to be predicted; None of these themselves.
    """

    data: Rollouts
    windows: PreparedData
    guide: InLoop | None = None

    in_loop: ClassVar[bool] = True
    segments: ClassVar[tuple[Segments, ...]] = ()

    @cached_property
    def regression(self) -> LoopRegression:
        """Fits of sets of terms to the rollouts."""
        return LoopRegression(self.data, self.windows, None if self.guide is None else self.guide.regression)

    @cached_property
    def screen(self) -> LoopScreen:
        """Variants of effects, by how well they follow the motion."""
        return LoopScreen(self.regression)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings that it is of."""
        return self.data.recordings

    @property
    def samples(self) -> Samples:
        """Samples of the motion."""
        return self.windows.samples

    @property
    def motions(self) -> dict[str, Samples]:
        """Those of each joint, by its name."""
        return self.windows.motions

    def reach(self, joint: str = "") -> tuple[float, float]:
        """Least and largest position that was recorded [rad]."""
        return self.windows.reach(joint)

    @cached_property
    def floors(self) -> dict[str, float]:
        """Root mean square error in the loop that encoder and clock may give, by the joint's name [rad]."""
        return dict.fromkeys(self.data.joints, self.data.noise(0.0))

    def inertias(self, base: Sequence[Term]) -> dict[str, float]:
        """Inertia by which noise is scaled, by the joint's name: that of positions needs none."""
        return dict.fromkeys(self.data.joints, 0.0)

    def with_link_states(self, model: Model) -> InLoop:
        """The same: a link moves along in a simulation."""
        return self

    def residual(self, terms: Sequence[Term], theta: Array) -> Array:
        """Measured minus simulated positions (R,) [rad]."""
        return -self.data.misses([Point(tuple(terms), theta)])[:, 0]

    def errors(self, model: Model) -> Errors:
        """Errors of a model in the loop."""
        return Errors(np.nan, np.nan).with_loop(self.residual(model.terms, np.asarray(model.theta)))
