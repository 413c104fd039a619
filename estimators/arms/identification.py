"""Identification of an arm: base parameters and friction of its joints, by each of the six schemes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from estimators.arms.balance import VIEWS, Joints, measure_arm, rows, series
from estimators.arms.untold import untold
from estimators.checks.identifiability import Doubt, inseparable
from estimators.regression.equations import Equations, IdentificationError
from estimators.regression.least_squares import Fit, least_squares, solve
from estimators.regression.recursive import evenly
from estimators.schemes.identification import (
    CLUSTER,
    CLUSTERS,
    FEWEST,
    POINTS,
    Identification,
    Identified,
    converge,
)
from estimators.schemes.six import SCHEMES, Regression, Regressor, Scheme, give
from estimators.selection.errors import Step
from pendulum_env._typing import JSON, Array, Index, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links, check_places, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.lookup import find
from pendulum_env.physics import Term
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.words import listing

SCHEMA = "pendulum-ident/arm-identification@1"


def for_arms(schemes: Sequence[Regressor]) -> tuple[Scheme, ...]:
    """Schemes as arms need them: those of energy without a guard, as one of many joints is always near a reversal."""
    chosen = (cast(Scheme, scheme) for scheme in schemes)
    return tuple(replace(one, guard=None) if one.view == "energy" else one for one in chosen)


ARM_SCHEMES = for_arms(SCHEMES)


@dataclass(frozen=True, eq=False, repr=False)
class ArmIdentified(Identified):
    """What one scheme finds of an arm.

    Attributes:
        residuals: root mean square of the scheme's own residual, of each joint or of all together, in `units`.
        units: of y and the residual, as many.
    """

    model: ArmModel
    residuals: tuple[float, ...] = ()
    units: tuple[str, ...] = ()

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return super().json() | {"residual": {"rms": list(self.residuals), "units": list(self.units)}}


@dataclass(frozen=True, eq=False, repr=False)
class ArmIdentification(Identification):
    """What all schemes find in the same recordings of an arm."""

    schemes: Mapping[str, ArmIdentified]

    def __getitem__(self, scheme: str) -> ArmIdentified:
        return find("scheme", scheme, self.schemes)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return super().json() | {"schema": SCHEMA}


def identify_arm(
    recordings: ArmRecording | Sequence[ArmRecording],
    body: Body,
    terms: Sequence[Term] | None = None,
    schemes: Sequence[Scheme] = ARM_SCHEMES,
) -> ArmIdentification:
    """Fit base parameters and the terms' linear parameters to recordings of an arm, by each scheme.

    A sample in which a joint sticks is left out of the row of that joint alone.

    Args:
        recordings: one or more; filters start anew with each.
        body: its links.
        terms: at joints, with their shape parameters set; viscous and Coulomb friction at each joint by default.
        schemes: which to use. One that borrows takes the parameters that make the momentum from the scheme of that
            name, as the paper does, and fits the others.

    Raises:
        IdentificationError: if there is too little motion.
        ValueError: if a scheme borrows from one that was not used before, or a term is at no joint.
    """
    recordings = [recordings] if isinstance(recordings, ArmRecording) else list(recordings)
    placed = friction(body) if terms is None else tuple(terms)
    check_places(placed, body.joints)
    terms = (Links(body), *placed)
    measured = [m for recording in recordings for m in measure_arm(recording)]
    names = tuple(recording.name for recording in recordings)
    for k, joint in enumerate(body.joints):
        if not any(m[k].moving.any() for m in measured):
            raise IdentificationError(f"{', '.join(names)}: joint '{joint}' never moves: record with all joints moving")
    results: dict[str, ArmIdentified] = {}
    doubts: list[Doubt] = []
    balances = {view: [rows(m, terms, VIEWS[view]) for m in measured] for view in {s.view for s in schemes}}
    for scheme in schemes:
        data = stack(scheme, measured, balances[scheme.view])
        if len(np.unique(data.clusters[data.usable])) < FEWEST:
            raise IdentificationError(
                f"{', '.join(names)}: too little of the motion is clear of stick and reversals: record longer, faster "
                "or wider motion"
            )
        hidden = [joint for k, joint in enumerate(body.joints) if not data.usable[data.joint == k].any()]
        if hidden and not VIEWS[scheme.view].adds_up:
            raise IdentificationError(
                f"{', '.join(names)}: joint '{hidden[0]}' is never clear of stick and reversals: record longer, faster "
                "or wider motion of it"
            )
        if scheme.borrows is not None and scheme.borrows not in results:
            raise ValueError(f"{scheme.id} borrows from {scheme.borrows}: put {scheme.borrows} before it")
        lender = results[scheme.borrows].model if scheme.borrows is not None else None
        results[scheme.id] = _fit(scheme, data, terms, lender)
        if scheme is schemes[0]:  # the same of all
            phi, columns = data.equations.phi, results[scheme.id].model.columns
            doubts = inseparable(phi[data.usable], [column.name for column in columns], np.any(phi, axis=0))
    parts = [series(m, "position", "velocity", "held") for m in measured]
    seen = [np.concatenate(each) for each in zip(*parts, strict=True)]
    alike = {name for doubt in doubts for name in doubt.withheld}
    unknown = {id: untold(one.model, *seen) for id, one in results.items()}
    if alone := sorted(frozenset.intersection(*unknown.values()) - alike):  # by no scheme; others show no number for it
        text = f"{listing(alone)} cannot be told: these data hardly depend on {'it' if len(alone) == 1 else 'them'}"
        doubts.append(Doubt(f"{text}, move all joints faster, wider and together", tuple(alone)))
    results = {id: replace(one, model=one.model.withholding(unknown[id] | alike)) for id, one in results.items()}
    return ArmIdentification(results, tuple(doubts), names)


@dataclass(frozen=True, eq=False)
class Stack:
    """Equations of all samples (R,), those of the joints at one instant in a row."""

    equations: Equations
    usable: Mask
    joint: Index  # or 0 where joints add up
    clusters: Index  # stretches of time
    time: Array  # seconds of recording taken in [s]


def stack(scheme: Scheme, measured: Sequence[Joints], balances: Sequence[Sequence[Equations]]) -> Stack:
    """What a scheme makes of the balances of all recordings, one after the other."""
    length = min(CLUSTER, sum(len(m[0]) * m[0].period for m in measured) / CLUSTERS)
    parts, times, seconds = [], [], 0.0
    for m, own in zip(measured, balances, strict=True):
        joints = [through(scheme, equations, m, k) for k, equations in enumerate(own)]
        both = [np.column_stack([one.equations.phi, one.equations.y, one.usable]) for one in joints]
        parts.append(np.stack(both, axis=1).reshape(-1, both[0].shape[1]))
        elapsed = seconds + np.arange(1, len(m[0]) + 1) * m[0].period
        seconds = float(elapsed[-1])
        times.append(np.repeat(elapsed, len(joints)))
    whole, time, count = np.concatenate(parts), np.concatenate(times), len(balances[0])
    joint = np.tile(np.arange(count), len(whole) // count)
    equations = Equations(whole[:, :-2], whole[:, -2])
    return Stack(equations, whole[:, -1] > 0, joint, (time / length).astype(np.intp), time)


def through(scheme: Scheme, equations: Equations, m: Joints, joint: int) -> Regression:
    """What a scheme makes of the balance of one joint, or of that of all."""
    if VIEWS[scheme.view].adds_up:
        clear = np.all([own.clear(scheme.guard) for own in m], axis=0)
    else:
        clear = m[joint].clear(scheme.guard)
    return scheme.through(equations, scheme.gate(clear), m[0].period)


def _fit(scheme: Scheme, data: Stack, terms: tuple[Term, ...], lender: ArmModel | None) -> ArmIdentified:
    body = ArmModel(terms).body
    use, count = data.usable, data.equations.phi.shape[1]
    given = np.flatnonzero(_of_momentum(body)) if lender is not None else np.empty(0, dtype=np.intp)
    free = np.setdiff1d(np.arange(count), given)
    lent = np.array([]) if lender is None else lender.theta[given]
    equations = give(data.equations, given.tolist(), lent)
    fit, weights = weighted(Equations(equations.phi[use], equations.y[use]), data.joint[use], data.clusters[use])
    theta, std = np.empty(count), np.zeros(count)
    theta[free], theta[given], std[free] = fit.theta, lent, fit.std
    if lender is not None:
        std[given] = [lender.estimates[name].std for name in np.array(body.names)[given]]
    model = ArmModel.build(terms, theta, std)
    # the recursion takes rows of one instant one after the other
    last = evenly(len(data.time) // len(weights), POINTS) * len(weights) + len(weights) - 1
    return ArmIdentified(
        scheme=scheme.id,
        model=model,
        convergence=converge(equations, weights[data.joint], use, data.time, fit, free, theta, std, last),
        residual_rms=fit.rms,
        unit=scheme.unit,
        residuals=tuple((1.0 / weights).tolist()),
        units=(scheme.unit,)
        if VIEWS[scheme.view].adds_up
        else tuple(body.worded(at, scheme.unit) for at in body.joints),
        condition=fit.condition,
        used=(int(use.sum()), len(use)),
    )


def weighted(equations: Equations, joint: Index, clusters: Index) -> tuple[Fit, Array]:
    """Least squares in which joints with less noise count more, and the weight of each joint [1/(N m)]."""
    clusters = np.unique(clusters, return_inverse=True)[1]
    phi, y = equations.phi, equations.y
    w = 1.0 / _levels(y, joint)[joint]
    theta = least_squares(phi * w[:, None], y * w)
    fit = solve(equations, 1.0 / _levels(y - phi @ theta, joint)[joint], clusters)
    return fit, 1.0 / _levels(fit.residual, joint)


def _levels(values: Array, joint: Index) -> Array:
    """Root mean square of each joint (n,)."""
    return np.sqrt(np.maximum(np.bincount(joint, values**2) / np.maximum(np.bincount(joint), 1), 1e-24))


def _of_momentum(body: Body) -> Mask:
    """Base parameters that the momentum has (P,)."""
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-np.pi, np.pi, (2, 20, len(body.joints)))
    return np.asarray(np.abs(body.momentum(q, v)).max(axis=(0, 1)) > 1e-9)


@dataclass(frozen=True)
class JointError:
    """How far a model's torque is from a joint's, clear of stick.

    Attributes:
        joint: its name.
        torque_rms: measured minus modelled torque, in `unit`.
        share: of the root mean square of the measured torque; None of a joint without a motor.
        unit: N m, or N of a joint that slides.
    """

    joint: str
    torque_rms: float
    share: float | None
    unit: str = NEWTON_METRE

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"joint": self.joint, "torque_rms": self.torque_rms, "share": self.share, "unit": self.unit}


def compare_arm(model: ArmModel, recordings: ArmRecording | Sequence[ArmRecording]) -> tuple[JointError, ...]:
    """Torque errors of a model of an arm on recordings, joint by joint: the paper's norm (10).

    Raises:
        IdentificationError: if a recording is too short, or a joint is never clear of stick.
    """
    recordings = [recordings] if isinstance(recordings, ArmRecording) else list(recordings)
    measured = [m for recording in recordings for m in measure_arm(recording)]
    data = stack(ARM_SCHEMES[0], measured, [rows(m, model.terms, VIEWS["torque"]) for m in measured])
    left = data.equations.y - data.equations.phi @ model.theta
    torque = np.concatenate([series(m, "torque")[0].ravel() for m in measured])
    found = []
    for k, joint in enumerate(model.body.joints):
        own = data.usable & (data.joint == k)
        if not own.any():
            raise IdentificationError(
                f"{recordings[0].name}: joint '{joint}' is never clear of stick and reversals: its error cannot be told"
            )
        rms, size = (float(np.sqrt(np.mean(values[own] ** 2))) for values in (left, torque))
        found.append(JointError(joint, rms, rms / size if size else None, model.body.worded(joint, NEWTON_METRE)))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class ArmStep(Step):
    """A model of an arm with one effect more than the one before, and its torque errors joint by joint."""

    model: ArmModel
    errors: Mapping[str, tuple[JointError, ...]]  # type: ignore[assignment]  # no simulation follows an arm

    @classmethod
    def of(cls, added: str | None, model: ArmModel, **parts: Sequence[ArmRecording]) -> ArmStep:
        """The model with its errors on parts of the data, `train` and `holdout`; raises as `compare_arm` does."""
        return cls(added, model, {part: compare_arm(model, own) for part, own in parts.items()})
