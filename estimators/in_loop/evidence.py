"""Rollouts as a body of evidence for the one engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.in_loop.rollouts import Rollouts
from estimators.in_loop.screen import LoopScreen
from estimators.selection.data import Errors, Evidence
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class InLoop:
    """Recordings of servos, to be followed in the loop.

    Attributes:
        data: their rollouts.
        windows: the same recordings as windowed equations.
        guide: the fitted recordings, by whose fit these have to be predicted; None of these themselves.
    """

    data: Rollouts
    windows: Evidence
    guide: InLoop | None = None

    segments = ()
    in_loop = True

    @cached_property
    def screen(self) -> LoopScreen:
        """Fits of models to the data."""
        return LoopScreen(self.data, self.windows.screen, self.guide.screen if self.guide else None)

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

    def reach_of(self, joint: str) -> tuple[float, float]:
        """Least and largest position that was recorded [rad]."""
        return self.windows.reach_of(joint)

    def watching(self, model: Model) -> InLoop:
        """The same: a link moves along in a simulation."""
        return self

    def misses(self, terms: Sequence[Term], theta: Array) -> Array:
        """Measured minus simulated positions (R,) [rad]."""
        return -self.data.misses([Point(tuple(terms), theta)])[:, 0]

    def errors(self, model: Model) -> Errors:
        """Errors of a model in the loop."""
        return Errors(np.nan, np.nan).with_loop(self.misses(model.terms, np.asarray(model.theta)))
