"""What lies between motor and link of a joint where the motor's side alone was measured: its resonance tells.

With e the small angle by which the link of joint j is ahead of its motor, M the links' inertia without that motor's
rotor, f(q, q', q'') the torque that they take if nothing yields, and its slopes D = df/dq' and G = df/dq,

    M_jj e'' + (d + D_jj) e' + (k + G_jj) e = -f_j,      joint i feels M_ij e'' + D_ij e' + G_ij e more than f_i.

M and f follow from the parameters of a rigid arm, so that k and d are all that is unknown, and a rotor that no rigid
arm tells from the links. Two things are there to be wrong. There is no amplitude: a free one has to be about one. And
the link rings after what has moved it: an encoder whose errors are not white looks like a soft transmission, but like
one in time that runs backward as well.
Source: Spong, ASME Journal of Dynamic Systems 109(4), 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares as search

from estimators.arms.transmission import Transmission
from estimators.regression.least_squares import least_squares, outside, robust_covariance
from estimators.selection.data import PreparedData
from estimators.selection.left import Terms
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import links_of
from pendulum_env.physics import Estimate
from pendulum_env.physics.compiled import Recurrence, recurrence
from pendulum_env.physics.symbols import name

PLACE, TILT = 0.02, 1e-4  # [s] between places at which inertia is taken, and [rad], for slopes
SMOOTH = np.array([1.0, 10.0, 1.0]) / 12  # neighbours, as second differences are averages over the triangle
FARTHEST = 10.0  # [rad], of an extension that diverges


@dataclass(frozen=True)
class ResonanceSettings:
    """Numbers of the search for a resonance."""

    frequencies: tuple[float, ...] = tuple(np.geomspace(12.0, 300.0, 24).tolist())  # [rad/s], of the first look,
    ratios: tuple[float, ...] = (0.03, 0.15)  # of damping, and
    rotors: tuple[float, ...] = (0.0, 0.4)  # shares of the least inertia, where the rotor is not known
    most: float = 0.95  # of these shares
    steepest: float = 1.5  # rad from sample to sample, of what can be integrated
    finalists: int = 3  # joints that are looked at closely
    range: float = 5.0  # logarithm of a factor, that stiffness and damping may move by
    turns: tuple[int, int] = (12, 7)  # of the search beside the links as they are, and together with them
    amplitudes: tuple[float, float] = (0.8, 1.25)  # between which a free one has to be
    segments: int = 30  # of a recording, up to which what rings from their starts is fitted
    backward: float = 0.8  # share of the error that is left in time that runs backward
    rest: float = 0.1  # share of what is more than noise at its joint, that may be left

    @property
    def tried(self) -> int:
        """Number of springs of a joint that are tried."""
        return len(self.frequencies) * len(self.ratios)


RESONANCE = ResonanceSettings()


class Spring(NamedTuple):
    """An elastic transmission: number of its joint, stiffness [N m/rad], damping [N m s/rad], its rotor [kg m^2]."""

    joint: int
    stiffness: float
    damping: float
    rotor: float


class Field(NamedTuple):
    """What drives the extension of a joint along a recording.

    Attributes:
        masses: M_ij (N, n) [kg m^2], the rotor included.
        drags: D_ij (N, n) [N m s/rad].
        pulls: G_ij (N, n) [N m/rad].
        load: f_j (N,) [N m], the rotor included; only averages are meaningful.
        still: the same without accelerations (N,) [N m].
    """

    masses: Array
    drags: Array
    pulls: Array
    load: Array
    still: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """The links along one recording, by the windows of each joint and their rows among all."""

    body: Body
    windows: Sequence[Windows]
    where: Sequence[slice]

    @cached_property
    def period(self) -> float:
        """Between samples [s]."""
        return 1.0 / self.windows[0].recording.rate

    @cached_property
    def segments(self) -> list[tuple[int, int]]:
        """First sample and end of each: the motion in a gap is unknown."""
        return list(pairwise((*self.windows[0].recording.starts, len(self.windows[0].moving))))

    @cached_property
    def accelerations(self) -> Array:
        """Of all joints (N, n); only averages are meaningful."""
        return np.column_stack([w.acceleration for w in self.windows])

    @cached_property
    def _places(self) -> list[Index]:
        step = max(1, round(PLACE / self.period))
        return [np.unique(np.r_[begin:end:step, end - 1]) for begin, end in self.segments]

    @cached_property
    def _regressors(self) -> tuple[Array, ...]:
        """Of M, D and G (S, n, n, P), and of torque without accelerations (S, n, P), at places."""
        every, body, units = np.concatenate(self._places), self.body, np.eye(len(self.windows))
        q, speeds = (
            np.column_stack(own)
            for own in zip(*((w.samples.position, w.samples.velocity) for w in self.windows), strict=True)
        )
        rates = np.concatenate([np.gradient(speeds[a:b], self.period, axis=0) for a, b in self.segments])
        q, v, a = q[every], speeds[every], rates[every]
        still = np.zeros_like(q)
        masses = [body.momentum(q, np.broadcast_to(unit, q.shape)) for unit in units]
        drags = [body.torque(q, v + unit, still) - body.torque(q, v - unit, still) for unit in units]
        pulls = [body.torque(q + TILT * unit, v, a) - body.torque(q - TILT * unit, v, a) for unit in units]
        parts = np.stack(masses, axis=2), np.stack(drags, axis=2) / 2, np.stack(pulls, axis=2) / (2 * TILT)
        return *parts, body.torque(q, v, still)

    def field(self, theta: Array, joint: int) -> Field:
        """What drives the extension of a joint, by the links' parameters (P,)."""
        *slopes, torques = self._regressors
        masses, drags, pulls = (self._along(own[:, :, joint] @ theta) for own in slopes)
        still = self._along(torques[:, joint] @ theta)
        smooth = np.convolve(np.pad(still, 1, mode="edge"), SMOOTH, "valid")
        return Field(masses, drags, pulls, smooth + np.sum(masses * self.accelerations, axis=1), still)

    def _along(self, values: Array) -> Array:
        """Values at places (S, ...), at all samples (N, ...)."""
        parts = np.split(values, np.cumsum([len(own) for own in self._places])[:-1])
        every = zip(self.segments, self._places, parts, strict=True)
        return np.concatenate([CubicSpline(places, own)(np.arange(*segment)) for segment, places, own in every])

    def felt(self, field: Field, spring: Spring, time: int = 1, is_forced: bool = False) -> Array:
        """Torque that each joint feels more than on a rigid arm (N, n, C) [N m].

        The first is that of an extension that starts at rest. Two more for each segment are what rings from its start,
        per rad and per rad/s of the extension there, if segments are few, and what is forced is not all that is asked.
        In `time` that runs forward, 1, or backward, -1.
        """
        j, h = spring.joint, self.period
        masses = field.masses - spring.rotor * (np.arange(len(self.windows)) == j)
        load = field.load - spring.rotor * self.accelerations[:, j]
        constants = np.tile(np.array([spring.stiffness, spring.damping, h])[:, None, None], 3)
        rings = 0 if is_forced or len(self.segments) > RESONANCE.segments else 2
        extension = np.zeros((len(load), 1 + rings * len(self.segments)))
        for k, (begin, end) in enumerate(self.segments):
            here = np.arange(begin, end)[::time]
            first = -field.still[here[0]] / (spring.stiffness + field.pulls[here[0], j])
            slopes = np.column_stack([masses[here, j], time * field.drags[here, j], field.pulls[here, j]])
            given = np.concatenate([np.zeros((len(here), 1, 3)), np.repeat(slopes[:, :, None], 3, axis=2)], axis=1)
            given[:, 0, 0] = load[here]  # of three lanes
            path = _newmark()(given[1:-1], constants, np.array([[[first, 1.0, h]], [[first, 1.0, 0.0]]]))[:, :, 0]
            places = [0, 1 + 2 * k, 2 + 2 * k][: 1 + rings]
            extension[here[:, None], places] = np.concatenate([path[:1, 1], path[:, 0]])[:, : 1 + rings]
        extension = np.nan_to_num(extension, nan=FARTHEST).clip(-FARTHEST, FARTHEST)
        bent = np.pad(np.diff(extension, 2, axis=0) / h**2, ((1, 1), (0, 0)))
        rates = np.gradient(extension, h, axis=0)
        motion = np.stack([bent, rates, extension], axis=1)  # (N, 3, C)
        return np.asarray(np.stack([masses, field.drags, field.pulls], axis=2) @ motion)


@cache
def _newmark() -> Recurrence:
    """Extension from its last two values to the next, its spring's torque smoothed as second differences are."""
    names = ["load", "mass", "drag", "pull"], ["stiffness", "damping", "period"], ["extension", "before"]
    load, mass, more, own, k, d, h, now, before = (name(text) for part in names for text in part)
    inertia, drag, pull = mass / h**2, 0.5 * (d + more) / h, (k + own) / 12
    known = (2 * inertia - 10 * pull) * now - (inertia - drag + pull) * before - load
    return recurrence(*names, [known / (inertia + drag + pull), now])


class Rows:
    """Equations of prepared data beside some terms, and what springs would take from them."""

    def __init__(self, prepared: PreparedData, terms: Terms) -> None:
        regression, windows = prepared.regression, prepared.data.windows
        self.body, self.clusters = links_of(prepared.base), prepared.data.clusters
        self.terms, self.theta, self.weights = terms, regression.solve(terms), regression.weights(terms)
        tangent, ends = regression.tangent(terms), np.cumsum([0, *(len(w.centers) for w in windows)])
        self.runs: dict[int | None, list[int]] = {}
        for k, w in enumerate(windows):
            self.runs.setdefault(w.run, []).append(k)
        self.chains = [
            Chain(self.body, [windows[k] for k in own], [slice(ends[k], ends[k + 1]) for k in own])
            for own in self.runs.values()
        ]
        self.count, self.scale = len(self.body.base), self.weights * tangent.scale
        self.slopes, self.error = tangent.slopes * self.weights[:, None], regression.residual(terms) * self.weights
        self.frame = regression.frame(terms)

    def fields(self, theta: Array, joint: int) -> list[Field]:
        """What drives a joint's extension along each recording."""
        return [own.field(theta[: self.count], joint) for own in self.chains]

    def columns(self, fields: Sequence[Field], spring: Spring, time: int = 1, is_forced: bool = False) -> Array:
        """Weighted columns of what is forced, and else of what rings from the start of each segment (R, C)."""
        felt = [own.felt(field, spring, time, is_forced) for own, field in zip(self.chains, fields, strict=True)]
        columns, first = np.zeros((len(self.error), 1 + sum(own.shape[2] - 1 for own in felt))), 1
        for chain, own in zip(self.chains, felt, strict=True):
            places = [0, *range(first, first := first + own.shape[2] - 1)]
            for k, (w, here) in enumerate(zip(chain.windows, chain.where, strict=True)):
                columns[here, places] = w.rows.narrow @ own[:, k]
        return columns * self.scale[:, None]

    def left(self, columns: Array, frame: Array, off: Array | float = 0.0) -> Array:
        """Errors (R,) beside forced columns and any ringing, less what is taken off and what a frame imitates."""
        columns = outside(frame, columns)
        error = outside(frame, self.error - off) - columns[:, 0]
        return np.asarray(error - columns[:, 1:] @ least_squares(columns[:, 1:], error))

    def springs(self, joint: int, time: int = 1) -> list[tuple[float, Spring]]:
        """Springs of a joint and what each explains with an amplitude of its own, the best one first."""
        fields, found = self.fields(self.theta, joint), []
        masses, error = np.concatenate([own.masses[:, joint] for own in fields]), outside(self.frame, self.error)
        known, least = self.rotor(joint), float(masses.min())
        rotors = [share * least for share in RESONANCE.rotors] if known is None else [float(self.theta[known])]
        fastest = RESONANCE.steepest / max(own.period for own in self.chains)
        for rotor in (rotor for rotor in rotors if rotor < RESONANCE.most * least):
            inertia = float(masses.mean()) - rotor
            for w in (w for w in RESONANCE.frequencies if w < fastest):
                for ratio in RESONANCE.ratios:
                    spring = Spring(joint, inertia * w**2, 2 * ratio * inertia * w, rotor)
                    forced = outside(self.frame, self.columns(fields, spring, time, is_forced=True)[:, 0])
                    size = float(np.linalg.norm(forced)) + 1e-300
                    found.append((max(float(forced @ error) / size, 0.0) ** 2, spring))
        return sorted(found, key=lambda one: -one[0])

    def rotor(self, joint: int) -> int | None:
        """Which base parameter the rotor of a joint is; None where it is part of others."""
        named = f"rotor@{self.body.joints[joint]}"
        return self.body.names.index(named) if named in self.body.names else None

    def fitted(self, spring: Spring, time: int = 1) -> tuple[float, Spring]:
        """The spring of its joint and rotor that fits best beside the links as they are, and its squared error."""
        fields, start = self.fields(self.theta, spring.joint), np.log([spring.stiffness, spring.damping])

        def at(x: Array) -> Spring:
            return spring._replace(stiffness=float(np.exp(x[0])), damping=float(np.exp(x[1])))

        def left(x: Array) -> Array:
            return self.left(self.columns(fields, at(x), time), self.frame)

        bounds = start - RESONANCE.range, start + RESONANCE.range
        found = search(left, start, bounds=bounds, max_nfev=RESONANCE.turns[0], diff_step=1e-4)
        return 2 * float(found.cost), at(found.x)

    def settled(self, spring: Spring) -> Resonance:
        """The spring of its joint that fits best together with all parameters."""
        joint, known, count = spring.joint, self.rotor(spring.joint), self.count
        others = np.linalg.qr(self.slopes[:, count:])[0]
        factor = np.linalg.qr(outside(others, self.slopes[:, :count]), mode="r")
        moves = np.linalg.pinv(factor, rcond=1e-8) * float(np.linalg.norm(outside(self.frame, self.error)))
        least = min(float(own.masses[:, joint].min()) for own in self.fields(self.theta, joint))

        def at(x: Array) -> tuple[Array, Spring]:
            theta = self.theta[:count] + moves @ x[3:]
            rotor = least * float(x[2]) if known is None else float(theta[known])
            return theta, Spring(joint, float(np.exp(x[0])), float(np.exp(x[1])), rotor)

        def left(x: Array) -> Array:
            theta, own = at(x)
            return self.left(
                self.columns(self.fields(theta, joint), own), others, self.slopes[:, :count] @ (moves @ x[3:])
            )

        share = np.clip(spring.rotor / least, 0.01, RESONANCE.most - 0.01)
        start = np.r_[np.log([spring.stiffness, spring.damping]), share, np.zeros(count)]
        reach = np.r_[RESONANCE.range, RESONANCE.range, 1.0, np.full(count, np.inf)]
        low, high = start - reach, start + reach
        low[2], high[2] = 0.0, RESONANCE.most
        found = search(left, start, bounds=(low, high), max_nfev=RESONANCE.turns[1])
        theta, spring = at(found.x)
        fields = self.fields(theta, joint)
        off, ringing = np.split(self.columns(fields, spring), [1], axis=1)
        forced = outside(self.frame, off[:, 0])
        amplitude = 1.0 + float(forced @ found.fun) / (float(forced @ forced) + 1e-300)
        change = least_squares(np.column_stack([ringing, self.slopes]), self.error - off[:, 0])[-len(self.theta) :]
        std = np.sqrt(np.diag(robust_covariance(found.jac, found.fun, self.clusters)))[:2]
        errors = np.hypot(std, amplitude - 1.0) * spring[1:3]  # where a free one is not one, there is more than noise
        return Resonance(spring, (float(errors[0]), float(errors[1])), self.terms, self.theta + change, amplitude)


@dataclass(frozen=True)
class Resonance:
    """An elastic transmission that explains what some terms leave.

    Attributes:
        spring: that it has.
        errors: standard errors of its stiffness and damping.
        terms: beside it.
        theta: their parameters (P,).
        amplitude: that the link's motion has if it is free.
    """

    spring: Spring
    errors: tuple[float, float]
    terms: Terms
    theta: Array
    amplitude: float

    def transmission(self, body: Body, left: float) -> Transmission:
        """The same as it is reported, with the torque that remains [N m]."""
        joint = body.joints[self.spring.joint]
        values = zip(self.spring[1:3], self.errors, ("N m/rad", "N m s/rad"), strict=True)
        stiffness, damping = (Estimate(value, std, body.worded(joint, unit)) for value, std, unit in values)
        return Transmission(joint, stiffness, damping, None, left)

    def rigid(self, prepared: PreparedData) -> PreparedData:
        """The same motion under the torque that a rigid arm would have felt."""
        rows, windows = Rows(prepared, self.terms), list(prepared.data.windows)
        fields = rows.fields(self.theta, self.spring.joint)
        columns = rows.columns(fields, self.spring)
        error = prepared.regression.equations(self.terms).error(self.theta) * rows.weights
        start = iter(least_squares(columns[:, 1:], error - columns[:, 0]))
        for run, chain, field in zip(rows.runs.values(), rows.chains, fields, strict=True):
            felt = chain.felt(field, self.spring)
            torques = felt @ np.r_[1.0, [next(start) for _ in range(felt.shape[2] - 1)]]
            for k, torque in zip(run, torques.T, strict=True):
                w = windows[k]
                windows[k] = w.under(w.recording.torque - torque, w.samples.torque - torque)
        return replace(prepared, data=replace(prepared.data, windows=tuple(windows)))


def find_resonance(train: PreparedData, holdout: PreparedData, terms: Terms) -> Resonance | None:
    """The elastic transmission that explains most of what terms leave, if it looks like one; None if none does."""
    rows = Rows(train, terms)
    firsts = sorted((one for joint in range(len(rows.body.joints)) for one in rows.springs(joint)[:1]), reverse=True)
    found = [rows.fitted(spring) for gain, spring in firsts[: RESONANCE.finalists] if gain > 0]
    if not found:
        return None
    left, spring = min(found)
    missed, reverse = rows.fitted(rows.springs(spring.joint, -1)[0][1], -1)
    if left > RESONANCE.backward * missed:
        return None
    unseen = Rows(holdout, terms)
    fields = unseen.fields(rows.theta, spring.joint)
    columns = unseen.columns(fields, spring), unseen.columns(fields, reverse, -1)
    left, missed = (float(np.sum(unseen.left(own, unseen.frame) ** 2)) for own in columns)
    if left > RESONANCE.backward * missed:
        return None
    settled, (least, most) = rows.settled(spring), RESONANCE.amplitudes
    return settled if least < settled.amplitude < most else None
