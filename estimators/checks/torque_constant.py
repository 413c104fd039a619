"""The torque constant of a drive that logs its current, from loads of known size.

With current i instead of torque, tau = K i, every parameter comes out per ampere: motion alone cannot tell K. A load of
known inertia dI and gravity dmgl, which differs from recording to recording, can,

    i = (1/K) (dI q'' + dmgl sin q) + (1/K) (I q'' + mgl sin q + friction),

as the torque of the known loads is a column like any other. All columns are functions of the motion, those of friction
under load too, which is odd in the velocity as the weight of a load is not: where the drive pushes along the motion all
the time, as in most servos, |i| sgn q' is i itself, and would take the place of the loads.

Source: Gautier and Briot, Journal of Dynamic Systems, Measurement, and Control 136(5), 2014 (drive gains of robots from
known payloads).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.arguments import within_limits
from estimators.regression.equations import IdentificationError
from estimators.regression.least_squares import least_squares
from estimators.selection.candidates import Screen
from estimators.selection.data import Evidence, fit_terms
from estimators.weak_form.dataset import Dataset, prepare, smooth_laws
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.physics import BASE, Column, Estimate, KnownLoad, Model, Term
from pendulum_env.physics.friction import LoadDependentFriction
from pendulum_env.physics.term import LOAD
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.words import plus_minus

TURNS = 4  # in which the constant and the weight that presses the gears are told by the fit before
FEWEST = 3  # equations for each column; with less, only the base model stands beside the load
DRIVEN = 0.9  # share of the motion that the motor drives, from which nothing tells what it loses in the gears
LEAST = 5.0  # standard errors that the constant has to be from none
BETWEEN = 4  # recordings from which on their scatter tells a standard error
NONE = Load(0.0, 0.0)
LOGGED = {"A": "a current", "V": "a voltage", "duty": "a duty cycle"}


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


def told(model: Model, data: Dataset, fit: Callable[[Dataset], Model] | None = None, is_whole: bool = False) -> Model:
    """A model that was fitted to data, in the unit of their torque, with the torque constant and what it errs by.

    Args:
        model: in which nothing is said of either.
        data: what it was fitted to.
        fit: finds parameters of the same names in data, by which it is seen what another constant makes of them; if not
            given, the model's terms are fitted as they are.
        is_whole: whether the model lacks nothing: then the constant is the one beside it, and its parameters follow.
    """
    recordings = [w.recording for w in data.windows]
    first = recordings[0].torque_constant
    if first is None:
        return model.per(recordings[0].torque_unit)

    def by(constant: float) -> Model:
        scaled = _scaled(data, constant / first.value)
        return fit_terms(Evidence(scaled, ()), model.terms)[0] if fit is None else fit(scaled)

    found = first
    if is_whole and first.loads:
        beside = torque_constant([_logged(recording) for recording in recordings], model, first.value)
        found = beside if isinstance(beside, TorqueConstant) else first
    before = by(first.value)
    here, there = before if found is first else by(found.value), by(found.value + found.std)
    estimates = {}
    for name, own in model.estimates.items():
        moved = here.estimates[name].value - before.estimates[name].value
        estimates[name] = replace(own, value=own.value + moved)
    return widened(replace(model, estimates=estimates), found, here, there)


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


def _logged(recording: Recording) -> Recording:
    """The recording as it was logged, its torque constant unknown."""
    known = recording.torque_constant
    if known is None:
        return recording
    return replace(recording, torque=recording.torque / known.value, torque_unit=known.of, torque_constant=None)


def constant_of(model: Model, first: TorqueConstant | None) -> TorqueConstant | None:
    """The torque constant of a model that was `told`."""
    own = model.torque_constant
    return first if own is None or first is None else replace(first, value=own.value, std=own.std)


def torque_constant(
    recordings: Sequence[Recording], model: Model | None = None, start: float = 1.0
) -> TorqueConstant | str:
    """Torque constant from recordings of a current under known loads, or in a sentence why there is none.

    A recording of which no load is known counts as one without a load.

    Args:
        recordings: of a current.
        model: what the joint is beside its loads; a first guess bends to nearly any physics.
        start: torque constant that the model's shape parameters are by [N m/A].

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
    data, value, weight = prepare(recordings), start, 0.0
    moved = {load for load, w in zip(loads, data.windows, strict=True) if len(w.centers)}
    if len(moved) < 2:
        return (
            f"the {name} is not known, and every parameter is per {unit}: of {len(set(loads))} known loads only one was"
            " moved; move the joint under each of them, clear of stick"
        )
    rubbing = Pressed if driven(data) > DRIVEN else LoadDependentFriction
    laws = smooth_laws(data.windows[0])
    laws = laws if len(data.weights) >= FEWEST * (len(laws) + 3) else BASE
    for _ in range(TURNS):  # friction under load is known in N m
        if model is None:
            terms: Sequence[Term] = (*laws, rubbing(weight))
        else:
            terms = _with_known_motor(model) if rubbing is Pressed else model.terms
        share, std, weight = _share(_in_newton_metres(data, loads, value), terms)
        if share <= LEAST * std:
            break
        value = value / share
    share, std = share / value, std / value  # 1/K
    if abs(share) <= LEAST * std:
        return (
            f"the {name} is not known, and every parameter is per {unit}: all that {len(moved)} known loads tell "
            f"of its inverse is {plus_minus(share, std)} {unit}/(N m); take loads that differ more, or move further"
        )
    if share < 0:
        return (
            f"the {name} is not known, and every parameter is per {unit}: it would be negative, "
            f"{plus_minus(1 / share, std / share**2)} N m/{unit}; turn torque or position round with a minus sign"
        )
    return TorqueConstant(value, std * value**2, unit, len(moved))


def of_the_drive(model: Model, constant: TorqueConstant, data: Dataset) -> list[str]:
    """What a torque constant leaves open, in sentences.

    Args:
        model: in N m, by it.
        constant: that was found.
        data: what it was fitted to.
    """
    said = []
    share = driven(data)
    name = "torque constant" if constant.of == "A" else "torque gain"
    if share > DRIVEN:
        said.append(
            f"the motor pushes along the motion {share:.0%} of the time: what its gears lose of its torque and the "
            f"{name} are one number, of which {constant.value:.4g} {constant.unit} is the product; a weight that is "
            "let down slowly, so that it turns the motor, would tell them apart"
        )
    if constant.of != "A" and "viscous" in model.estimates:
        most = model.estimates["viscous"].value / constant.value
        said.append(
            f"the log has {LOGGED[constant.of]}: back-EMF, {name} times k_e q', is part of the viscous friction, and "
            f"k_e is {most:.3g} {constant.of} s/rad at most"
        )
    return said


def driven(data: Dataset) -> float:
    """Share of the motion that the torque pushes along."""
    return float(np.mean(data.torque() * data.samples.velocity > 0))


class KnownLoads(Term):
    """What the torque of known loads counts for beyond its size: nothing, where the torque constant is right."""

    id = "known_loads"
    law = "s (dI q'' + dmgl sin q)"
    kind = "inertial"

    @property
    def columns(self) -> tuple[Column, ...]:
        """The loads' own column."""
        return (LOAD,)


class Pressed(LoadDependentFriction):
    """Friction by what hangs on the output alone: what the motor presses is no function of the motion."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """Without that of the motor."""
        return super().columns[1:]


def _with_known_motor(model: Model) -> tuple[Term, ...]:
    """A model's terms, friction by the motor's torque as it is: beside an unknown scale of the torque, it is none."""
    known = {name: e.value for name, e in model.estimates.items() if name == "load_dependent_friction"}
    return within_limits(model.terms, {}, known, {})[0]


def _scaled(data: Dataset, factor: float) -> Dataset:
    """Data whose torque is larger by a factor."""

    def scaled(w: Windows) -> Windows:
        recording = replace(w.recording, torque=factor * w.recording.torque)
        samples = replace(w.samples, torque=factor * w.samples.torque)
        return replace(w, recording=recording, samples=samples, torque_noise=factor * w.torque_noise)

    return replace(data, windows=tuple(map(scaled, data.windows)))


def _in_newton_metres(data: Dataset, loads: Sequence[Load], constant: float) -> Dataset:
    """Windows of currents as those of torques, by a constant that is tried [N m/A]."""

    def turned(w: Windows, load: Load) -> Windows:
        samples = replace(w.samples, load=KnownLoad(load.inertia, load.gravity))
        return replace(w, recording=replace(w.recording, torque_unit=NEWTON_METRE), samples=samples)

    windows = zip(_scaled(data, constant).windows, loads, strict=True)
    return replace(data, windows=tuple(turned(w, load) for w, load in windows))


def _share(data: Dataset, terms: Sequence[Term]) -> tuple[float, float, float]:
    """What the torque of the known loads counts in that which was recorded, 1 if the torque constant is right.

    With its standard error, and the weight of the joint without loads [N m].
    """
    balance = Screen(data).balance((KnownLoads(), *terms))
    fit = balance.fit(data.clusters)
    names = [column.name for term in terms for column in term.columns]
    loads = [tuple(map(float, w.samples.load)) if len(w.centers) else None for w in data.windows]
    between = _between(balance.slopes(fit.theta), fit.residual, balance.weights, data.recording_of_window, loads)
    weight = float(fit.theta[1 + names.index("gravity")]) if "gravity" in names else 0.0
    return 1.0 + float(fit.theta[0]), max(float(fit.std[0]), between), weight


def _between(slopes: Array, error: Array, weights: Array, owner: Index, loads: Sequence[object]) -> float:
    """Standard error of the first parameter from the scatter between recordings: each is left out once (jackknife).

    One without which all others have the same load is not: they would know nothing.
    """
    if len(loads) - loads.count(None) < BETWEEN:
        return 0.0
    phi, left = slopes * weights[:, None], error * weights
    others = [owner != k for k, own in enumerate(loads) if own and len({*loads[:k], *loads[k + 1 :]} - {None}) > 1]
    told = [least_squares(phi[own], left[own])[0] for own in others]
    return float(np.sqrt((len(told) - 1) * np.var(told))) if len(told) > 1 else 0.0
