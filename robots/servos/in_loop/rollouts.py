"""Rollouts of servos: simulations of whole recordings from the goal alone, compared with the measured motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from estimators.weak_form.point import Point
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array
from pendulum_env.physics import has_link
from pendulum_env.recording import Recording
from robots.servos.in_loop.compared_positions import ComparedPositions, choose_grain
from robots.servos.in_loop.counts import compute_creep_torque, find_encoder_step, make_quantisation_noise
from robots.servos.in_loop.noise import MotionNoise, mistime_recordings
from robots.servos.in_loop.pieces import select_pieces
from robots.servos.in_loop.servo_inputs import make_servos
from robots.servos.in_loop.settings import LOOP
from robots.servos.loop import Servos, simulate_servos
from robots.servos.torque import find_drive


@dataclass(frozen=True)
class Rollouts:
    """Recordings with a goal and a drive, each segment of them a rollout.

    Attributes:
        recordings: of servos.
        steps: of the integrator in the time `LOOP.simulation.grain`.
        shares: begin and end of the compared part of each recording; the whole recording is simulated.
        grain: time between compared positions [s]; None chooses it by the logs, see `choose_grain`.
        has_counts: whether positions are compared in counts of the encoder, if the log shows them; None: if the
            controllers read counts.
        whole: recordings of which `recordings` are pieces; None if they are whole.
    """

    recordings: tuple[Recording, ...]
    steps: int = LOOP.simulation.steps
    shares: Part = WHOLE
    grain: float | None = None
    has_counts: bool | None = None
    whole: tuple[Recording, ...] | None = None

    @classmethod
    def from_pieces(cls, recordings: Sequence[Recording], steps: int = LOOP.simulation.steps, **options: Any) -> Self:
        """Make the rollouts of pieces of long recordings, with fewer steps, or of whole short ones, for a search."""
        pieces = select_pieces(whole := tuple(recordings))
        return cls(pieces, steps if pieces is whole else LOOP.search.steps, **options, whole=whole)

    @property
    def fine(self) -> Self:
        """Return the rollouts of the whole recordings with shorter steps of the integrator."""
        whole = self.whole or self.recordings
        steps = LOOP.simulation.fine_steps if whole is self.recordings else LOOP.search.fine_steps
        return replace(self, recordings=whole, steps=steps)

    @cached_property
    def positions(self) -> ComparedPositions:
        """Measured positions to compare with."""
        return ComparedPositions(self.recordings, self.shares, self.grain or choose_grain(self.recordings))

    @cached_property
    def noise(self) -> MotionNoise:
        """Errors of these positions that no model causes."""
        return MotionNoise(self.recordings, float(np.std(self.positions.measured)))

    @cached_property
    def _steps_per_grain(self) -> int:
        setting = LOOP.simulation
        return max(1, int(np.ceil(self.steps * self.positions.grain / setting.grain - setting.slack)))

    @cached_property
    def servos(self) -> Servos:
        """Return all rollouts in a batch; shorter ones are padded with their last sample."""
        step, segments = self.positions.grain / self._steps_per_grain, self.positions.segments
        ends = self._steps_per_grain * np.array([len(segment.times) for segment in segments])
        encoder_step = (self.encoder_step or LOOP.encoder.unseen) if self._reads_counts else None
        return make_servos([segment.part for segment in segments], step, ends, encoder_step)

    @property
    def _reads_counts(self) -> bool:
        drives = map(find_drive, self.recordings)
        return all(drive.acts_on_position and drive.reads == "counts" for drive in drives)

    @cached_property
    def encoder_step(self) -> float | None:
        """Return the step of the encoder in which positions are compared [rad]; None if they are compared exactly."""
        has_counts = self._reads_counts if self.has_counts is None else self.has_counts
        return find_encoder_step(self.recordings) if has_counts else None

    @cached_property
    def without_counts(self) -> Self:
        """Return the rollouts without counts, in controllers and comparison: their errors change smoothly."""
        return self if self.encoder_step is None else replace(self, has_counts=False)

    @cached_property
    def noise_of_counts(self) -> Array:
        """Return the noise of the encoder in each row (R,) [rad], which the comparison of counts lacks."""
        return make_quantisation_noise(self.encoder_step or 0.0, len(self.positions.measured))

    @property
    def creep_torque(self) -> float:
        """Return the torque of `compute_creep_torque`; 0 if simulated controllers read counts."""
        reads_counts = self._reads_counts and self.encoder_step is not None
        return 0.0 if reads_counts else compute_creep_torque(self.recordings, self.noise.resolution)

    @cached_property
    def mistimed(self) -> list[Self]:
        """Return the rollouts with delayed goals, and those with delayed controllers."""
        return [replace(self, recordings=delayed) for delayed in mistime_recordings(self.recordings)]

    def compute_position_errors(self, points: Sequence[Point]) -> Array:
        """Return simulated minus measured positions (R, V) of V models with terms of equal classes [rad].

        Both are counts of the encoder, if controllers read them.
        """
        paths = self.simulate_paths(points)
        if self.encoder_step is not None:
            origin = self.servos.position
            paths = origin + self.encoder_step * np.rint((paths - origin) / self.encoder_step)
        return self.positions.compare_paths(paths)

    def simulate_paths(self, points: Sequence[Point]) -> Array:
        """Return the positions (N + 1, V, B) of V models with terms of equal classes, a grain apart [rad]."""
        terms = []
        for variants in zip(*(point.terms for point in points), strict=True):
            nonlinear = {
                name: np.array([v.nonlinear_values[name] for v in variants]) for name in variants[0].nonlinear_values
            }
            merged = {
                name: values[0] if np.all(values == values[0]) else values[:, None]
                for name, values in nonlinear.items()
            }
            terms.append(type(variants[0])(**merged))
        rollouts = self._in_contact if has_link(points[0].terms) else self
        theta = np.column_stack([point.theta for point in points])
        return simulate_servos(terms, theta, rollouts.servos, rollouts._steps_per_grain)

    @cached_property
    def _in_contact(self) -> Self:
        """Return the rollouts with the shorter steps of the integrator for a contact."""
        return replace(self, steps=LOOP.simulation.link_factor * self.steps)
