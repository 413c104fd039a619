"""The torque constant of a drive that logs its current, from loads of known size.

With current i instead of torque, tau = K i, every parameter comes out per ampere: motion alone cannot tell K. A load of
known inertia dI and gravity dmgl, which differs from recording to recording, can,

    i = (1/K) (dI q'' + dmgl sin q) + (1/K) (I q'' + mgl sin q + friction),

as the column of the known loads has a coefficient of its own. It is fitted beside a model that bends to nearly any
physics, with friction that grows with the torque, with the load, and from recording to recording: friction is odd in
the velocity, the weight of a load is not, so that neither can stand in for the other.

Source: Gautier and Briot, Journal of Dynamic Systems, Measurement, and Control 136(5), 2014 (drive gains of robots from
known payloads).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.equations import Equations, IdentificationError
from estimators.regression.least_squares import least_squares, solve
from estimators.weak_form.dataset import Dataset, prepare, smooth_laws
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Estimate, KnownLoad, Model
from pendulum_env.physics.potential import Cogging, Spring
from pendulum_env.physics.term import LOAD
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.words import plus_minus

TURNS = 3  # in which the weight that presses the gears is told by the fit before
FEWEST = 3  # equations for each column; with less, only the base model stands beside the load
LEAST = 5.0  # standard errors that the constant has to be from none
BETWEEN = 4  # recordings from which on their scatter tells a standard error
NONE = Load(0.0, 0.0)
ALIKE = 1e-6  # of the largest singular value, below which columns repeat each other
LOGGED = {"A": "a current", "V": "a voltage", "duty": "a duty cycle"}
FURTHER = (Spring(), *(Cogging(float(order)) for order in range(4, 9)))  # laws beside the smooth ones


@dataclass(frozen=True)
class Calibrated:
    """Recordings in N m, where their known loads tell the torque constant; else as they are, in the unit of the log.

    Attributes:
        recordings, holdout: each with `torque_constant`, if its torque was a current.
        doubt: why the torque constant is not known, in a sentence; None if it is, or nobody asks.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...]
    doubt: str | None = None

    @classmethod
    def of(cls, recordings: Sequence[Recording], holdout: Sequence[Recording] = ()) -> Calibrated:
        """Recordings in N m, those that are so already as they are. Held-out ones have no say in the constant.

        Torque that is logged a little late is no hindrance: to first order, what comes of it is odd in the velocity.

        Raises:
            IdentificationError: if units differ, or if the recordings hold too little motion to tell anything.
        """
        if unit_of((*recordings, *holdout)) == NEWTON_METRE:
            return cls(tuple(recordings), tuple(holdout))
        found = torque_constant(recordings)
        if isinstance(found, TorqueConstant):
            return cls.by(found, recordings, holdout)
        return cls(tuple(recordings), tuple(holdout), found)

    @classmethod
    def by(
        cls, constant: TorqueConstant | None, recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
    ) -> Calibrated:
        """Recordings by a constant that is known; those in N m already, and all without one, are left as they are."""
        fitted, held_out = (tuple(_turned(recording, constant) for recording in part) for part in (recordings, holdout))
        return cls(fitted, held_out)

    @property
    def constant(self) -> TorqueConstant | None:
        """By which currents were turned into torque; None if they were not."""
        return self.recordings[0].torque_constant

    @property
    def unit(self) -> str:
        """Of the torque: `N m`, or that of what was logged."""
        return self.recordings[0].torque_unit


def unit_of(recordings: Sequence[Recording]) -> str:
    """The unit that the torque of all recordings is in.

    Raises:
        IdentificationError: if they differ.
    """
    units = list(dict.fromkeys(recording.torque_unit for recording in recordings))
    if len(units) > 1:
        one, other = (next(r.name for r in recordings if r.torque_unit == unit) for unit in units[:2])
        raise IdentificationError(
            f"torque is in {units[0]} in {one} and in {units[1]} in {other}: read all recordings alike, with a gain or "
            "with *? for the torque"
        )
    return units[0]


def _turned(recording: Recording, constant: TorqueConstant | None) -> Recording:
    if constant is None or recording.torque_unit != constant.of:
        return recording
    torque = constant.value * recording.torque
    return replace(recording, torque=torque, torque_unit=NEWTON_METRE, torque_constant=constant)


def further(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings as a torque constant that is one standard error larger has them.

    What that moves the parameters by is what they err by for it: see `widened`.
    """
    return [
        recording
        if (k := recording.torque_constant) is None
        else replace(recording, torque=recording.torque * (1 + k.std / k.value))
        for recording in recordings
    ]


def told(model: Model, recordings: Sequence[Recording], fit: Callable[[Sequence[Recording]], Model]) -> Model:
    """A model that was fitted to recordings, in the unit of their torque, with the torque constant and what it errs by.

    Args:
        model: in which nothing is said of either.
        recordings: what it was fitted to.
        fit: finds parameters of the same names in recordings, by which it is seen what another constant makes of them.
    """
    constant = recordings[0].torque_constant
    if constant is None:
        return model.per(recordings[0].torque_unit)
    return widened(model, constant, fit(recordings), fit(further(recordings)))


def widened(model: Model, constant: TorqueConstant, here: Model, there: Model) -> Model:
    """A model whose standard errors include that of the torque constant, which moves parameters from `here` to `there`.

    The error of the constant and those of a fit that is given it have nothing to do with each other, since the constant
    is fitted beside the columns of that fit: squares add up.
    """
    estimates = {}
    for name, own in model.estimates.items():
        if "." in name and name not in {column.name for column in model.columns}:  # a shape parameter, searched for
            moved = own.value * constant.std / constant.value if own.unit.startswith(NEWTON_METRE) else 0.0
        else:
            moved = there.estimates[name].value - here.estimates[name].value
        estimates[name] = replace(own, std=float(np.hypot(own.std, moved)))
    known = Estimate(constant.value, constant.std, constant.unit)
    return replace(model, estimates=estimates, torque_constant=known)


def torque_constant(recordings: Sequence[Recording]) -> TorqueConstant | str:
    """Torque constant from recordings of a current under known loads, or in a sentence why there is none.

    A recording of which no load is known counts as one without a load.

    Raises:
        IdentificationError: if the recordings hold too little motion.
    """
    unit = unit_of(recordings)
    loads = [recording.load or NONE for recording in recordings]
    name = "torque constant" if unit == "A" else "torque gain"
    if len(set(loads)) < 2:
        hung = "known loads that differ are needed" if loads[0] == NONE else "all recordings have the same load"
        return (
            f"the {name} is not known, and every parameter is per {unit}: the log has {LOGGED.get(unit, unit)} for the "
            f"torque, and {hung}; record with another known load, or without any, and give `load` in the study"
        )
    data = prepare(recordings)
    columns, current = _spanned(_columns(data, loads), data.weights), data.torque()
    fit = solve(Equations(columns, current), data.weights, data.clusters)
    share, std = float(fit.theta[0]), float(fit.std[0])  # 1/K
    if len(recordings) >= BETWEEN:
        std = max(std, _between(columns, current, data, loads))
    if abs(share) <= LEAST * std:
        return (
            f"the {name} is not known, and every parameter is per {unit}: all that {len(set(loads))} known loads tell "
            f"of its inverse is {plus_minus(share, std)} {unit}/(N m); take loads that differ more, or move further"
        )
    if share < 0:
        return (
            f"the {name} is not known, and every parameter is per {unit}: it would be negative, "
            f"{plus_minus(1 / share, std / share**2)} N m/{unit}; turn torque or position round with a minus sign"
        )
    return TorqueConstant(1 / share, std / share**2, unit, len(set(loads)))


def _columns(data: Dataset, loads: Sequence[Load]) -> Array:
    """Column of the known loads, then those of a model that bends to nearly any physics (R, P)."""
    windows = [
        replace(w, samples=replace(w.samples, load=KnownLoad(load.inertia, load.gravity)))
        for w, load in zip(data.windows, loads, strict=True)
    ]
    load = np.concatenate([w.column(LOAD, w.samples) for w in windows])
    x = data.samples
    sign, weight = np.sign(x.velocity), np.abs(np.sin(x.position))
    owner = data.recording_of_window
    heavy = np.array([one.gravity for one in loads])[owner]
    own = np.eye(len(loads))[owner][:, 1:]  # the first recording has what all share
    laws = [data.columns([law])[0][0] for law in (*smooth_laws(data.windows[0]), *FURTHER)]
    rubbing = [weight * sign, heavy * weight * sign, heavy * sign]
    columns = np.column_stack([load, *laws, *rubbing, own * sign[:, None], own * np.asarray(x.velocity)[:, None]])
    if len(load) < FEWEST * columns.shape[1]:
        columns = np.column_stack([load, *laws[:4], heavy * weight * sign])
    # Gears are pressed by the motor, or by the motor and by what hangs on them. The current stands on both sides then;
    # but what no column explains of it is a per cent or so, and can feign no more friction than that.
    # What does is told by the base model: beside laws that bend like it, gravity is not known well enough.
    base = [column.name for law in BASE for column in law.columns]
    by_motor = by_both = _pressed(data, np.zeros(len(loads)))
    for _ in range(TURNS):
        plain = np.column_stack([columns[:, : 1 + len(base)], by_motor, by_both])
        theta = least_squares(plain * data.weights[:, None], data.torque() * data.weights)
        hanging = theta[1 + base.index("gravity")] + theta[0] * np.array([one.gravity for one in loads])
        by_both = _pressed(data, hanging)
    return np.column_stack([columns, by_motor, by_both])


def _spanned(columns: Array, weights: Array) -> Array:
    """The first column, and what the others span without those that nearly repeat each other (R, P')."""
    others = columns[:, 1:] * weights[:, None]
    left, singular, _ = np.linalg.svd(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300), full_matrices=False)
    return np.column_stack([columns[:, 0], left[:, singular > ALIKE * singular[0]] / weights[:, None]])


def _pressed(data: Dataset, hanging: Array) -> Array:
    """Column of friction under the current and a weight, |i + w sin q| sgn q', w of each recording (R,).

    A current that chatters from sample to sample presses by its size, not by its mean.
    """
    parts = []
    for w, weight in zip(data.windows, hanging, strict=True):
        held, hung = w.recording.torque, weight * np.sin(np.asarray(w.samples.position))
        after, before = np.abs(held + hung), np.abs(np.append(held[0], held[:-1]) + hung)
        parts.append(w.average(0.5 * (after + before) * np.sign(w.samples.velocity)))
    return np.concatenate(parts)


def _between(columns: Array, current: Array, data: Dataset, loads: Sequence[Load]) -> float:
    """Standard error of the first parameter from the scatter between recordings: each is left out once (jackknife).

    One without which all others have the same load is not: they would know nothing.
    """
    owner, w = data.recording_of_window, data.weights
    numbers = [k for k in range(len(loads)) if len({*loads[:k], *loads[k + 1 :]}) > 1]
    left = [
        least_squares(columns[owner != k] * w[owner != k, None], current[owner != k] * w[owner != k])[0]
        for k in numbers
    ]
    if len(left) < 2:
        return 0.0
    return float(np.sqrt((len(left) - 1) * np.var(left)))
