"""The next experiment: the torque signal that would settle what a diagnosis leaves open.

Open are effects that fit equally well, and effects that the recorded motion does not show. The fitted model is
simulated under a family of candidate signals, and the simulated recordings are put through the same windowed equations
as real ones. What the rival model cannot explain of them, its parameters fitted anew, is what the experiment would
show: the signal that makes it largest against the noise is suggested (T-optimality), of those that show plenty the
gentlest.

Source: Atkinson and Fedorov, Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.diagnosis.questions import Question
from estimators.diagnosis.suggestion import RATE, Aim, Suggestion
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import scale_swing
from estimators.selection.evaluator import ModelEvaluator
from estimators.signals.residual import Region, makes_whole_turns
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.windows import cut
from pendulum_env._typing import Array, ArrayLike
from pendulum_env.excitation import Excitation, draw_family
from pendulum_env.physics import Model, Samples, simulate
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.units import JointUnits

BOLDER = 10.0  # times the largest recorded torque, which a motor is not asked for without a word
USUAL = 6.0  # [N m], the paper's peak torque: what a motor is trusted with unless it is known to give more


@dataclass(frozen=True)
class DesignSettings:
    """Which experiments are simulated, and when one settles a question."""

    seconds: float = 20.0  # [s], length of the experiment
    shown: float = 0.7  # times the noise floor: a difference as large as this is found
    plenty: float = 20.0  # times the noise floor: enough to show a twentieth part of it, too
    alike: float = 0.05  # of the worth, a logarithm: signals as close are as good, and the smallest swing is chosen
    fewest: int = 40  # windows clear of stick that an experiment has to give
    releases: tuple[float, ...] = (0.3, 0.6, 1.0, 1.4, 1.8, 2.2, 2.5, 2.8, 3.0)  # [rad], at which a joint is let go
    shares: tuple[float, ...] = (1.0, 0.3, 0.1)  # of the torque: what small angles and low speeds call for
    fastest: float = 30.0  # times the highest speed that was recorded: of a motion beyond, a model knows nothing
    hanging: float = 0.1  # [rad], as near to which a recording began where any motion begins
    safe: float = 0.9  # share of an angle or speed that is used: the model that foretells the motion is in doubt


DESIGN = DesignSettings()


@dataclass(frozen=True)
class Limits:
    """Limits of an experiment; by default those of the recordings, and the default torque.

    Attributes:
        torque: largest [N m].
        angle: to either side of hanging down [rad].
        speed: largest [rad/s].
        usual: torque that is trusted without limits [N m].
    """

    torque: float | None = None
    angle: float | None = None
    speed: float | None = None
    usual: float = USUAL

    def quantities(self, units: JointUnits) -> dict[str, Quantity]:
        """Return the bounds that were given, by name; without torque where none may be applied."""
        bounds = {"torque": (self.torque or None, "N m"), "angle": (self.angle, "rad"), "speed": (self.speed, "rad/s")}
        return {name: Quantity(own, unit=units.unit(unit)) for name, (own, unit) in bounds.items() if own is not None}

    def with_trusted_torque(self, recordings: Sequence[Recording]) -> Limits:
        """Return the limits with the torque that is trusted where no bound is given, by what was recorded."""
        largest = max(float(np.abs(recording.torque).max()) for recording in recordings)
        bold = min(USUAL, BOLDER * largest) if recordings[0].torque_unit == NEWTON_METRE else 0.0
        usual = max(bold, largest)
        return replace(self, torque=self.torque or usual, usual=usual)

    def find_angle_range(self, recordings: Sequence[Recording]) -> tuple[float, float]:
        """Return the lowest and highest angle of a motion [rad]; a joint that turned may turn as far either way.

        Any motion begins hanging down, which may be beyond the angles that were recorded.
        """
        safe, hanging = DESIGN.safe, DESIGN.hanging
        if self.angle is not None:
            return -safe * self.angle, safe * self.angle
        position = np.concatenate([recording.position for recording in recordings])
        low, high = float(position.min()), float(position.max())
        if makes_whole_turns(position):
            return low - high, high - low
        return (safe * min(low, 0.0), safe * max(high, 0.0)) if -hanging < high and low < hanging else (low, high)

    def find_release_range(self, recordings: Sequence[Recording]) -> tuple[float, float]:
        """Return the lowest and highest angle from which a joint may be released [rad]; it swings no further."""
        bound = self.angle or max(float(np.abs(recording.position).max()) for recording in recordings)
        return -bound, bound

    def find_largest_speed(self, recorded: Samples) -> float:
        """Return the highest speed of a motion [rad/s]."""
        return DESIGN.safe * (float(np.abs(recorded.velocity).max()) if self.speed is None else self.speed)


def suggest_experiment(
    evaluator: ModelEvaluator,
    model: Model,
    asked: Sequence[Question],
    limits: Limits,
    left: Sequence[Region] = (),
) -> tuple[Suggestion | None, list[Aim], Finding | None]:
    """Choose the experiment that settles most questions, and that reaches the angle of the largest region left.

    Returns:
        The experiment, if there is one; aims that no torque up to the usual settles, whatever the limits; and a finding
        on the questions that only the limits keep open.
    """
    if not asked:
        return None, [], None
    recorded, torque = evaluator.train.samples, limits.torque or limits.usual
    (low, high), fastest = limits.find_angle_range(evaluator.train.recordings), limits.find_largest_speed(recorded)
    is_free = evaluator.train.recordings[0].known_inertia > 0
    if is_free:
        runs, (low, high) = simulate_releases(evaluator, model), limits.find_release_range(evaluator.train.recordings)
    else:
        runs = simulate_candidates(evaluator, model, torque)
    allowed = [run for run in runs if low <= run.reach[0] and run.reach[1] <= high and run.peak_speed <= fastest]
    place = next((0.5 * (own.low + own.high) for own in left[:1] if own.axis == "position"), None)
    if place is not None and not makes_whole_turns(recorded.position):
        allowed = [run for run in allowed if run.reach[0] <= place <= run.reach[1]]
    suggestion, unsettled = _choose(evaluator, allowed, asked)
    if not unsettled:
        return suggestion, [], None
    if limits.usual > torque and not is_free:
        runs = [*runs, *simulate_candidates(evaluator, model, limits.usual)]
    if not runs:  # the model runs away under every torque
        return None, [], None
    _, hopeless = _choose(evaluator, runs, unsettled)
    aims = [question.aim for question in hopeless]
    forbidden = [question.aim for question in unsettled if question.aim not in aims]
    if not forbidden:
        return suggestion, aims, None
    units = model.units()
    numbers = limits.quantities(units)
    if place is not None:
        numbers["place"] = Quantity(place, unit=units.unit("rad"))
    pairs = tuple((aim.effect, aim.instead) for aim in forbidden)
    return suggestion, aims, Finding(Kind.BEYOND_LIMITS, numbers, pairs=pairs)


def _choose(
    evaluator: ModelEvaluator, runs: Sequence[Run], asked: Sequence[Question]
) -> tuple[Suggestion | None, list[Question]]:
    """Choose the experiment that answers most questions, and list the questions that no experiment answers."""
    if not runs:
        return None, list(asked)
    shown = np.zeros((len(runs), len(asked)))  # against the noise floor
    for j, run in enumerate(runs):
        if len(run.data.weights) >= DESIGN.fewest:
            rivals = {terms: run.data.equations(terms) for terms in {question.terms for question in asked}}
            told = [question.unexplained(run.data, rivals[question.terms]) for question in asked]
            shown[j] = np.array(told) / evaluator.residuals.noise_floor()
    answerable = shown.max(axis=0) > DESIGN.shown
    # one question well settled and one open is worse than both settled
    worth = np.log1p(np.minimum(shown[:, answerable], DESIGN.plenty)).sum(axis=1)
    best = min(np.flatnonzero(worth >= worth.max() - DESIGN.alike).tolist(), key=lambda j: runs[j].swing)
    settled = tuple(question.aim for question, ratio in zip(asked, shown[best], strict=True) if ratio > DESIGN.shown)
    hopeless = [question for question, hope in zip(asked, answerable, strict=True) if not hope]
    return (runs[best].suggestion(settled) if settled else None), hopeless


@dataclass(frozen=True, eq=False)
class Run:
    """A candidate signal with the motion that the fitted model makes of it.

    Attributes:
        signal: torque over time; None where the joint is let go.
        recording: as it would be recorded.
        half_width: of windows [s].
        peak_speed: its highest speed [rad/s].
    """

    signal: Excitation | None
    recording: Recording
    half_width: float
    peak_speed: float

    @property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest angle [rad]."""
        return float(self.recording.position.min()), float(self.recording.position.max())

    @property
    def swing(self) -> float:
        """Between them [rad]."""
        return self.reach[1] - self.reach[0]

    @cached_property
    def data(self) -> TorqueWindows:
        """The motion as windowed equations."""
        return join_windows([cut(self.recording, self.half_width)])

    def suggestion(self, settled: tuple[Aim, ...]) -> Suggestion:
        """Return the experiment, with its expected result."""
        peak = float(np.abs(self.recording.torque).max())
        release = float(self.recording.position[0]) if self.signal is None else None
        return Suggestion(self.signal, DESIGN.seconds, settled, peak, self.reach, self.peak_speed, release)


def simulate_candidates(evaluator: ModelEvaluator, model: Model, torque: float) -> list[Run]:
    """Simulate candidate signals up to a torque [N m], sampled and windowed much as the recordings are.

    Motions that are far faster than any recorded are left out: a light joint with little friction runs away.
    """
    seconds, shares = DESIGN.seconds, DESIGN.shares
    signals = [signal for share in shares for signal in draw_family(np.random.default_rng(0), seconds, share * torque)]
    time = _make_times(evaluator)
    return _simulate_experiments(
        evaluator, model, signals, np.column_stack([signal.signal(time) for signal in signals]), 0.0
    )


def simulate_releases(evaluator: ModelEvaluator, model: Model) -> list[Run]:
    """Simulate free swings from several angles alike."""
    angles = np.array(DESIGN.releases)
    still = np.zeros((len(_make_times(evaluator)), len(angles)))
    return _simulate_experiments(evaluator, model, [None] * len(angles), still, angles)


def _make_times(evaluator: ModelEvaluator) -> Array:
    """Make the times of the samples of an experiment (N,) [s]."""
    rate = min(RATE, evaluator.train.data.windows[0].recording.rate)
    return np.arange(round(DESIGN.seconds * rate)) / rate


def _simulate_experiments(
    evaluator: ModelEvaluator, model: Model, signals: Sequence[Excitation | None], torques: Array, position: ArrayLike
) -> list[Run]:
    """Simulate experiments under torques (N, K) from rest at a position (K,) [rad]."""
    windows, time = evaluator.train.data.windows[0], _make_times(evaluator)
    recorded, half_width = windows.recording, (len(windows.kernel) // 2) / windows.recording.rate
    fastest = DESIGN.fastest * float(np.abs(evaluator.train.samples.velocity).max())
    path = simulate(model.terms, model.theta, 1 / min(RATE, recorded.rate), torques, position, 0.0)
    motions = zip(signals, torques.T, path.position[:-1].T, path.velocity.T, strict=True)
    runs = []
    for signal, torque, angle, velocity in motions:
        if (speed := float(np.abs(velocity).max())) <= fastest:
            run = Recording(time, angle, torque, name="experiment", is_checked=True)
            run = scale_swing(run, recorded.known_inertia, recorded.torque_unit) if signal is None else run
            runs.append(Run(signal, run, half_width, speed))
    return runs
