"""The next experiment: the torque signal that decides most open questions of a diagnosis.

Questions are about effects that fit equally well, and effects that the recorded motion does not show. The fitted model
is simulated under a family of candidate signals. The rival model of a question is fitted to the simulated recordings by
the same windowed equations as to real ones; its residual is the answer that the experiment would give. The signal with
the largest residuals over the noise is suggested (T-optimality); of signals that are as good, that with the smallest
range of angles.

Source: Atkinson and Fedorov, Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.diagnosis.questions import Question
from estimators.diagnosis.suggestion import RATE, Aim, Suggestion
from estimators.findings import Finding, Quantity
from estimators.free_swings import scale_swing
from estimators.selection.evidence import Evidence
from estimators.signals.residual import Region, makes_whole_turns
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.windows import cut
from pendulum_env.errors import UserError
from pendulum_env.excitation import Excitation, draw_family
from pendulum_env.physics import Model, simulate
from pendulum_env.reading import quote_value
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.units import JointUnits

MAX_TORQUE_RATIO = 10.0  # default torque limit over the largest recorded torque, at most
DEFAULT_TORQUE = 6.0  # [N m], default torque limit, the paper's peak torque
EXPERIMENT_TIME = 20.0  # length of the experiment [s]
MIN_RESIDUAL_RATIO = 0.7  # residual of the rival model above which a question is decided [noise floors]
MAX_RESIDUAL_RATIO = 20.0  # residual above which more does not count [noise floors]
EQUAL_WORTH = 0.05  # difference of worth, a sum of logarithms, up to which experiments are equal
MIN_WINDOWS = 40  # least number of windows clear of stick
RELEASES = (0.3, 0.6, 1.0, 1.4, 1.8, 2.2, 2.5, 2.8, 3.0)  # angles of free swings [rad]
TORQUE_SHARES = (1.0, 0.3, 0.1)  # of the torque limit, for small angles and low speeds
MAX_SPEED_RATIO = 30.0  # highest speed of a simulation over the highest recorded speed
HANGING_RANGE = 0.1  # largest distance of a recording from hanging down that counts as reaching it [rad]
SAFE_SHARE = 0.9  # share of a limit of angle or speed that the simulated motion may use


@dataclass(frozen=True)
class ExperimentLimits:
    """Limits of an experiment; None for a limit by the recordings.

    Attributes:
        torque: largest torque [N m].
        angle: largest angle to either side of hanging down [rad].
        speed: largest speed [rad/s].
        default_torque: torque limit without a bound of the user [N m].
    """

    torque: float | None = None
    angle: float | None = None
    speed: float | None = None
    default_torque: float = DEFAULT_TORQUE

    def __post_init__(self) -> None:
        for name in ("torque", "angle", "speed"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, float | int | np.number) and value >= 0):
                raise UserError(f"max_{name}={quote_value(value)}: give a number of at least zero, in SI units")

    def list_quantities(self, units: JointUnits) -> dict[str, Quantity]:
        """Return the limits that are not None, by name; a torque of zero is left out."""
        bounds = {"torque": (self.torque or None, "N m"), "angle": (self.angle, "rad"), "speed": (self.speed, "rad/s")}
        return {name: Quantity(x, unit=units.unit(unit)) for name, (x, unit) in bounds.items() if x is not None}

    def with_default_torque(self, recordings: Sequence[Recording]) -> ExperimentLimits:
        """Return the limits with `default_torque` by the recordings, also as `torque` if that is None or zero.

        The default is max(largest, min(`DEFAULT_TORQUE`, `MAX_TORQUE_RATIO` largest)), where `largest` is the largest
        recorded torque; in other units than N m it is `largest`.
        """
        largest = max(float(np.abs(recording.torque).max()) for recording in recordings)
        trusted = min(DEFAULT_TORQUE, MAX_TORQUE_RATIO * largest) if recordings[0].torque_unit == NEWTON_METRE else 0.0
        default = max(trusted, largest)
        return replace(self, torque=self.torque or default, default_torque=default)

    def find_angle_range(self, recordings: Sequence[Recording]) -> tuple[float, float]:
        """Return the lowest and highest angle of the motion [rad]: `safe` of the limit, else of the recorded range.

        The range includes hanging down, from which the motion begins. A joint that made whole turns may turn through
        the recorded range in either direction. A range away from hanging down is used fully. The release of a free
        swing has the full limit, else the largest recorded angle, to either side.
        """
        safe, hanging = SAFE_SHARE, HANGING_RANGE
        position = np.concatenate([recording.position for recording in recordings])
        if recordings[0].known_inertia > 0:  # a free swing
            bound = self.angle or float(np.abs(position).max())
            return -bound, bound
        if self.angle is not None:
            return -safe * self.angle, safe * self.angle
        low, high = float(position.min()), float(position.max())
        if makes_whole_turns(position):
            return low - high, high - low
        return (safe * min(low, 0.0), safe * max(high, 0.0)) if -hanging < high and low < hanging else (low, high)


@dataclass(frozen=True)
class UnreachableAims(Finding):
    """Aims that no experiment reaches within its limits, or under any torque.

    Attributes:
        aims: effects, and terms of the model from which no experiment tells them.
        limits: bounds of torque, angle and speed, by name, the recorded ones if left out; None: under any torque.
        place: position of the largest residual, which an experiment would have to reach; else None.
    """

    aims: tuple[Aim, ...]
    limits: Mapping[str, Quantity] | None = None
    place: Quantity | None = None


def suggest_experiment(
    evidence: Evidence,
    model: Model,
    questions: Sequence[Question],
    limits: ExperimentLimits,
    regions: Sequence[Region] = (),
) -> tuple[Suggestion | None, list[Aim], Finding | None]:
    """Choose the experiment within limits that decides most questions.

    `regions` are those of the residual; if the first is over position, the motion must reach it.

    Returns:
        The experiment or None; aims that no candidate reaches without limits of angle and speed, up to the usual
        torque; a finding on aims that only the limits forbid, or None.
    """
    if not questions:
        return None, [], None
    recorded, torque = evidence.train.samples, limits.torque or limits.default_torque
    recordings = evidence.train.recordings
    (low, high), is_free = limits.find_angle_range(recordings), recordings[0].known_inertia > 0
    fastest = SAFE_SHARE * (float(np.abs(recorded.velocity).max()) if limits.speed is None else limits.speed)
    runs = simulate_experiments(evidence, model, None if is_free else torque)
    slow = [run for run in runs if run.expected.peak_speed <= fastest]
    allowed = [run for run in slow if low <= run.expected.reach[0] and run.expected.reach[1] <= high]
    place = next((0.5 * (region.low + region.high) for region in regions[:1] if region.axis == "position"), None)
    if place is not None and not makes_whole_turns(recorded.position):
        allowed = [run for run in allowed if run.expected.reach[0] <= place <= run.expected.reach[1]]
    suggestion, unsettled = _choose_experiment(evidence, allowed, questions)
    if not unsettled:
        return suggestion, [], None
    if limits.default_torque > torque and not is_free:
        runs = [*runs, *simulate_experiments(evidence, model, limits.default_torque)]
    if not runs:  # the model runs away under every torque
        return None, [], None
    _, unanswerable = _choose_experiment(evidence, runs, unsettled)
    aims = [question.aim for question in unanswerable]
    limited_aims = [question.aim for question in unsettled if question.aim not in aims]
    if not limited_aims:
        return suggestion, aims, None
    units = model.units()
    target = None if place is None else Quantity(place, unit=units.unit("rad"))
    return suggestion, aims, UnreachableAims(tuple(limited_aims), limits.list_quantities(units), target)


def _choose_experiment(
    evidence: Evidence, runs: Sequence[SimulatedExperiment], questions: Sequence[Question]
) -> tuple[Suggestion | None, list[Question]]:
    """Choose the experiment that decides most questions, or None, and list questions that no run decides."""
    if not runs:
        return None, list(questions)
    residual_ratios = np.zeros((len(runs), len(questions)))  # [noise floors]
    for j, run in enumerate(runs):
        if len(run.data.weights) >= MIN_WINDOWS:
            rivals = {terms: run.data.equations(terms) for terms in {question.terms for question in questions}}
            residuals = [question.measure_unexplained(run.data, rivals[question.terms]) for question in questions]
            residual_ratios[j] = np.array(residuals) / evidence.residuals.noise_floor()
    answerable = residual_ratios.max(axis=0) > MIN_RESIDUAL_RATIO
    worth = np.log1p(np.minimum(residual_ratios[:, answerable], MAX_RESIDUAL_RATIO)).sum(axis=1)
    equal = np.flatnonzero(worth >= worth.max() - EQUAL_WORTH).tolist()
    best = min(equal, key=lambda j: np.ptp(runs[j].expected.reach))
    pairs = zip(questions, residual_ratios[best], strict=True)
    settled = tuple(question.aim for question, ratio in pairs if ratio > MIN_RESIDUAL_RATIO)
    hopeless = [question for question, hope in zip(questions, answerable, strict=True) if not hope]
    return (replace(runs[best].expected, settles=settled) if settled else None), hopeless


@dataclass(frozen=True, eq=False)
class SimulatedExperiment:
    """Simulated experiment.

    Attributes:
        expected: the experiment as a suggestion without aims.
        recording: simulated recording.
        half_width: of windows [s].
    """

    expected: Suggestion
    recording: Recording
    half_width: float

    @cached_property
    def data(self) -> TorqueWindows:
        """Windowed equations of the recording."""
        return join_windows([cut(self.recording, self.half_width)])


def simulate_experiments(evidence: Evidence, model: Model, torque: float | None) -> list[SimulatedExperiment]:
    """Simulate the family of signals at each of `TORQUE_SHARES` of a torque [N m], or free swings for None.

    Signals start from rest hanging down, free swings from `RELEASES`. Motions above `MAX_SPEED_RATIO` times the highest
    recorded speed are left out. Rate and windows are those of the first recording, or `RATE` if that is lower.
    """
    windows = evidence.train.data.windows[0]
    recorded, half_width = windows.recording, windows.half_width
    rate, fastest = (
        min(RATE, recorded.rate),
        MAX_SPEED_RATIO * float(np.abs(evidence.train.samples.velocity).max()),
    )
    time = np.arange(round(EXPERIMENT_TIME * rate)) / rate
    signals: list[Excitation | None] = [None] * len(RELEASES)
    torques, position = np.zeros((len(time), len(RELEASES))), np.array(RELEASES)
    if torque is not None:
        peaks = [share * torque for share in TORQUE_SHARES]
        drawn = [signal for peak in peaks for signal in draw_family(np.random.default_rng(0), EXPERIMENT_TIME, peak)]
        torques, position = np.column_stack([signal.signal(time) for signal in drawn]), np.zeros(len(drawn))
        signals = [*drawn]
    path = simulate(model.terms, model.theta, 1 / rate, torques, position, 0.0)
    motions = zip(signals, torques.T, path.position[:-1].T, path.velocity.T, strict=True)
    runs = []
    for signal, applied, angle, velocity in motions:
        if (speed := float(np.abs(velocity).max())) <= fastest:
            run = Recording(time, angle, applied, name="experiment", is_checked=True)
            run = scale_swing(run, recorded.known_inertia, recorded.torque_unit) if signal is None else run
            peak, reach = float(np.abs(run.torque).max()), (float(angle.min()), float(angle.max()))
            release = float(angle[0]) if signal is None else None
            expected = Suggestion(signal, EXPERIMENT_TIME, (), peak, reach, speed, release, model.units())
            runs.append(SimulatedExperiment(expected, run, half_width))
    return runs
