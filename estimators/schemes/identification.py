"""Identification: the parameters of a model from recordings, by each of the six schemes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from estimators.arguments import (
    Recordings,
    Schemes,
    Terms,
    chosen_recordings,
    chosen_schemes,
    chosen_terms,
    within_limits,
)
from estimators.checks.alignment import Aligned
from estimators.checks.closed_loop import feedback
from estimators.checks.homogeneity import AGREEMENT, Own, disagreements, misfits, own_fits
from estimators.checks.identifiability import Doubt, identifiability, is_driven, untold
from estimators.checks.remedies import wrong_columns
from estimators.checks.torque_constant import Calibrated, further, told, widened
from estimators.regression.equations import Equations, IdentificationError
from estimators.regression.least_squares import Fit, quietest_most, solve
from estimators.regression.recursive import evenly, history
from estimators.schemes.six import SCHEMES, LowPass, Regressor, Scheme, give
from estimators.selection.data import PreparedData, fit_terms
from estimators.selection.physical import driving_friction
from estimators.signals.measurements import Measurements, measure_segments, remember
from estimators.weak_form.dataset import Dataset, prepare
from pendulum_env._typing import JSON, Array, Index, Mask
from pendulum_env.lookup import find
from pendulum_env.notebook import shown
from pendulum_env.physics import BASE, Estimate, Model, Term
from pendulum_env.physics.term import zero
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.words import json_per, listing, per

SCHEMA = "pendulum-ident/identification@1"
POINTS = 200  # of the history
CLUSTER = 0.5  # [s], longer than residuals stay correlated, except those that drift; shorter in short recordings
CLUSTERS = 30  # at least, in all recordings together
APART = 5.0  # standard errors between two schemes, to which noise alone does not bring them: 2.3 is the most seen,
COARSE = 0.05  # and share of a parameter, to which slow sampling does not: 0.034 is what 50 Hz do
FEWEST = 10  # that hold motion, below which standard errors mean little


@dataclass(frozen=True, eq=False)
class Convergence:
    """How the estimates settle: the paper's recursion at K moments.

    Attributes:
        time: seconds of recording taken in, one recording after the other (K,) [s].
        theta: (K, P), in the order of the model's columns; what was given stays as it is.
        std: standard errors (K, P), in the proportions of the recursion's P and ending at those of the model.
    """

    time: Array
    theta: Array
    std: Array

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"time": self.time.tolist(), "theta": self.theta.tolist(), "std": self.std.tolist()}


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """What one scheme finds.

    Attributes:
        scheme: its id.
        model: terms with estimates and standard errors that hold under correlated residuals.
        convergence: the recursive estimate on its way; it ends at the model up to P(0).
        residual_rms: the paper's norm (10) of the scheme's own residual, in `unit`.
        unit: of y and the residual.
        condition: condition number of the regressor, columns scaled to equal length.
        used: equations that were used, of all there are.
    """

    scheme: str
    model: Model
    convergence: Convergence
    residual_rms: float
    unit: str
    condition: float
    used: tuple[int, int]

    @property
    def withheld(self) -> frozenset[str]:
        """Parameters that are unknown, see the identification's doubts."""
        return frozenset(name for name, estimate in self.model.estimates.items() if estimate.is_unknown)

    def __repr__(self) -> str:
        told = (f"{name} {estimate.text}" for name, estimate in self.model.estimates.items())
        return f"<Identified by {self.scheme}: {', '.join(told)}>"

    def _repr_html_(self) -> str:
        return shown(self)

    def per(self, torque_unit: str) -> Identified:
        """The same numbers, said of a torque that is in another unit."""
        return replace(self, model=self.model.per(torque_unit), unit=per(self.unit, torque_unit))

    def calibrated(self, constant: TorqueConstant, there: Model) -> Identified:
        """The same with the error of the torque constant, one of which more moves the parameters `there`."""
        model = widened(self.model, constant, self.model, there)
        old, new = (np.array([e.std for e in m.estimates.values()])[: len(m.theta)] for m in (self.model, model))
        course = replace(self.convergence, std=self.convergence.std * (new / np.maximum(old, 1e-300)))
        return replace(self, model=model, convergence=course)

    def json(self) -> JSON:
        """Plain dictionary for JSON; withheld estimates are null."""
        theta = {
            name: {"value": None, "std": None, "unit": estimate.unit} if estimate.is_unknown else estimate.json()
            for name, estimate in self.model.estimates.items()
        }
        return {
            "theta": theta,
            "residual": {"rms": self.residual_rms, "unit": self.unit},
            "condition": self.condition,
            "used": list(self.used),
            "convergence": self.convergence.json(),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """What all schemes find in the same recordings.

    Attributes:
        schemes: results by id of the scheme.
        doubts: what the recordings cannot tell, and what was changed because of them.
        recordings: names.
        ends: seconds of recording taken in at the end of each recording; empty where nobody has counted [s].
        torque_unit: `N m`, or that of a current in whose stead parameters are per unit of it.
        torque_constant: by which a current was turned into torque, if one was; standard errors include its own.
        data: windows of the recordings; None where too little of the motion is clear of stick for any.
    """

    schemes: Mapping[str, Identified]
    doubts: tuple[Doubt, ...]
    recordings: tuple[str, ...]
    ends: tuple[float, ...] = ()
    torque_unit: str = NEWTON_METRE
    torque_constant: TorqueConstant | None = None
    data: Dataset | None = field(default=None, repr=False)

    def __getitem__(self, scheme: str) -> Identified:
        return find("scheme", scheme, self.schemes)

    @cached_property
    def windows(self) -> Model:
        """The least-squares fit over windows, on which `compare` and `diagnose` stand, too; raises as `fitted`."""
        terms = next(iter(self.schemes.values())).model.terms
        return self.fitted(lambda data: fit_terms(PreparedData(data, ()), terms)[0])

    def fitted(self, fit: Callable[[Dataset], Model]) -> Model:
        """The model that a fit finds in the windows, in their unit of torque, and with their torque constant.

        Raises:
            IdentificationError: if there are none.
        """
        if self.data is None:
            names = listing(self.recordings)
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick: record longer or faster motion"
            )
        return told(fit(self.data), self.data, fit)

    def __repr__(self) -> str:
        return f"<Identification of {listing(self.recordings)} by {listing(list(self.schemes))}>"

    def _repr_html_(self) -> str:
        return shown(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "recordings": list(self.recordings),
            "torque_unit": self.torque_unit,
            "torque_constant": self.torque_constant.json() if self.torque_constant is not None else None,
            "doubts": json_per([doubt.json() for doubt in self.doubts], self.torque_unit),
            "schemes": {id: result.json() for id, result in self.schemes.items()},
        }


def identify(
    recordings: Recordings,
    terms: Terms = BASE,
    schemes: Schemes = SCHEMES,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    measured: Callable[[Recording], Sequence[Measurements]] = measure_segments,
) -> Identification:
    """Fit the linear parameters of the terms to recordings, one set for all, by each scheme.

    Parameters are those of the joint without the known loads of the recordings. Where a current was logged, these tell
    the torque constant; where they do not, parameters are per ampere, and a doubt says why.

    Args:
        recordings: one or more; filters start anew with each, and noisier ones count less.
        terms: of the model, with their shape parameters set, or by id.
        schemes: which to use, as they are or by id; one that borrows its inertia comes after the scheme that lends it.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"viscous": (0.0, 0.5)}`; an estimate that would leave them stays at the bound.
        measured: how motion and torque are taken from the segments of a recording.

    Raises:
        IdentificationError: if there is too little motion, or no torque at all.
        ValueError: if a name is unknown, or a scheme borrows from one that was not used before.
        TypeError: if something else is given than recordings, terms and schemes.
    """
    recordings, terms, chosen = chosen_recordings(recordings), chosen_terms(terms), chosen_schemes(schemes)
    terms, _ = within_limits(terms, {}, fixed, bounds)
    calibrated = Calibrated.of(recordings)
    recordings = calibrated.recordings
    segments = [[remember(m, terms) for m in measured(recording)] for recording in recordings]
    measurements = [m for own in segments for m in own]
    names = ", ".join(recording.name for recording in recordings)
    _check_driven(measurements, names)
    rate = min(m.rate for m in measurements)
    slowed = tuple(_slowed(scheme, rate) for scheme in chosen)
    text = f"at {rate:.4g} Hz the filters would pass everything: their cutoff is lowered to {rate:.4g} rad/s"
    doubts = (*identifiability(measurements, terms), *([Doubt(text)] if slowed != chosen else []))
    chosen = slowed
    results = _by_schemes(chosen, segments, terms, names)
    first = next(iter(results.values())).model
    if calibrated.constant is None:
        results = {id: own.per(calibrated.unit) for id, own in results.items()}
    else:
        moved = [[remember(m, terms) for m in measured(recording)] for recording in further(recordings)]
        there = _by_schemes(chosen, moved, terms, names)
        results = {id: own.calibrated(calibrated.constant, there[id].model) for id, own in results.items()}
    results, doubts = _withheld(results, measurements, doubts)
    data, mistakes = _mistaken(recordings, terms, first, list(results.values()))
    doubts = (*doubts, *map(Doubt, (*filter(None, [calibrated.doubt]), *mistakes)))
    ends = tuple(np.cumsum([sum(len(m) * m.period for m in own) for own in segments]).tolist())
    return Identification(
        results,
        doubts,
        tuple(recording.name for recording in recordings),
        ends,
        calibrated.unit,
        calibrated.constant,
        data,
    )


def _check_driven(measurements: Sequence[Measurements], names: str) -> None:
    if not any(is_driven(m) for m in measurements):
        raise IdentificationError(
            f"{names}: torque is never applied: only ratios of parameters are known, record with torque"
        )


def _mistaken(
    recordings: Sequence[Recording], terms: Sequence[Term], first: Model, results: Sequence[Identified]
) -> tuple[Dataset | None, list[str]]:
    """Windows of the recordings, where they move enough, and what seems wrong with the columns or the model."""
    mistakes = wrong_columns(first, recordings) or driving_friction(first)
    try:
        data = prepare(recordings)
        fits = own_fits([data], terms)
        return data, [*mistakes, *_mistakes(recordings, fits, terms)] or _lacking(results, fits)
    except IdentificationError:  # windows need more motion than some schemes
        return None, mistakes


def _withheld(
    results: dict[str, Identified], measurements: Sequence[Measurements], doubts: tuple[Doubt, ...]
) -> tuple[dict[str, Identified], tuple[Doubt, ...]]:
    """Results without the numbers that the recordings cannot tell, and doubts that say so.

    What no scheme tells is said; a scheme that alone does not tell a parameter shows no number for it.
    """
    alone = {id: untold(own.model, measurements, doubts) for id, own in results.items()}
    unsaid = {id: {name for doubt in own for name in doubt.withheld} for id, own in alone.items()}
    of_all = set.intersection(*unsaid.values())
    doubts = (*doubts, *(doubt for doubt in next(iter(alone.values())) if of_all.issuperset(doubt.withheld)))
    known = {name for doubt in doubts for name in doubt.withheld}
    return {id: replace(own, model=own.model.withholding(known | unsaid[id])) for id, own in results.items()}, doubts


def _by_schemes(
    schemes: Sequence[Regressor],
    segments: Sequence[Sequence[Measurements]],
    terms: Sequence[Term],
    names: str,
) -> dict[str, Identified]:
    """What each scheme finds in the segments of recordings, by its id."""
    results: dict[str, Identified] = {}
    for scheme in schemes:
        data = _stack(scheme, segments, terms)
        if len(np.unique(data.clusters[data.usable])) < FEWEST:
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick and reversals: record longer, faster or wider "
                "motion"
            )
        if scheme.borrows is not None and scheme.borrows not in results:
            raise ValueError(f"{scheme.id} borrows the inertia of {scheme.borrows}: put {scheme.borrows} before it")
        lender = results[scheme.borrows].model if scheme.borrows is not None else None
        results[scheme.id] = _fit(scheme, data, terms, lender)
    return results


def _mistakes(recordings: Sequence[Recording], fits: Sequence[Own], terms: Sequence[Term]) -> list[str]:
    """What seems to be wrong with the recordings themselves: torque out of time, another plant."""
    aligned = Aligned.of(recordings)
    return [
        *(f"{text}: correct it with --align (`Aligned.of` in Python)" for text in aligned.texts(True)),
        *(loop.text for loop in feedback(recordings)),
        *(aligned.texts(False) if not {"dead_time", "actuator_lag"} & {term.id for term in terms} else ()),
        *(
            f"{one.text}: leave it out, or find out what was changed"
            for one in disagreements(fits, only_if_all_fit=True)
        ),
        *(one.text for one in misfits(fits)),
    ]


def _lacking(results: Sequence[Identified], fits: Sequence[Own]) -> list[str]:
    """One line where the terms surely do not explain the recordings: by what they leave, or by schemes that disagree.

    Schemes see the same noise, so that their estimates differ by less than independent ones would; but they take what
    the terms lack each for something else.
    """
    times = max((fit.times for fit in fits), default=0.0)
    apart, name = max(_gaps(results), default=(0.0, ""))
    found = [f"what these terms leave is {times:.2g} times what noise gives"] if times > AGREEMENT.misfits else []
    found += [f"the schemes differ by up to {apart:.2g} of their standard errors ({name})"] if apart > APART else []
    return [f"{listing(found)}: something is missing, run diagnose"] if found else []


def _gaps(results: Sequence[Identified]) -> Iterator[tuple[float, str]]:
    """How far two schemes are apart in a parameter that was estimated, in standard errors, and its name."""
    for one, other in combinations(results, 2):
        for name in one.model.estimates.keys() - one.withheld - other.withheld:
            first, second = (own.model.estimates[name] for own in (one, other))
            gap = abs(first.value - second.value)
            if first.std > 0 and second.std > 0 and gap > COARSE * max(abs(first.value), abs(second.value)):
                yield gap / float(np.hypot(first.std, second.std)), name


def _slowed(scheme: Regressor, rate: float) -> Regressor:
    """The scheme, its filter at one radian per sample if it is beyond the Nyquist frequency."""
    operator = scheme.operator if isinstance(scheme, Scheme) else None
    if isinstance(operator, LowPass) and operator.cutoff >= np.pi * rate:
        return replace(scheme, operator=replace(operator, cutoff=rate))  # type: ignore[type-var]
    return scheme


@dataclass(frozen=True, eq=False)
class _Stack:
    """Equations of all recordings in a row (R,), and where each of their segments starts."""

    equations: Equations
    usable: Mask
    weights: Array
    clusters: Index  # short stretches of time, never across recordings
    time: Array  # seconds of recording taken in [s]
    starts: tuple[int, ...]


def _stack(scheme: Regressor, segments: Sequence[Sequence[Measurements]], terms: Sequence[Term]) -> _Stack:
    """Equations of every segment of each recording, recordings weighted by what they leave unexplained."""
    measurements = [m for own in segments for m in own]
    parts = [scheme.regression(m, terms) for m in measurements]
    length = min(CLUSTER, sum(len(m) * m.period for m in measurements) / CLUSTERS)
    clusters, times, seconds, count = [], [], 0.0, 0
    for m in measurements:
        elapsed = np.arange(1, len(m) + 1) * m.period
        cluster = np.minimum((elapsed / length).astype(np.intp), max(0, round(elapsed[-1] / length) - 1))
        clusters.append(count + cluster)
        times.append(seconds + elapsed)
        seconds, count = seconds + float(elapsed[-1]), count + int(cluster[-1]) + 1
    equations = Equations(
        np.concatenate([part.equations.phi for part in parts]), np.concatenate([part.equations.y for part in parts])
    )
    usable = np.concatenate([part.usable for part in parts])
    weights = np.ones(len(usable))
    if len(segments) > 1:
        theta = np.linalg.lstsq(equations.phi[usable], equations.y[usable], rcond=None)[0]
        residual = (equations.y - equations.phi @ theta) * usable
        owner = np.repeat(np.arange(len(segments)), [sum(len(m) for m in own) for own in segments])
        weights = quietest_most(
            np.asarray(np.bincount(owner, residual**2), dtype=float), np.bincount(owner, usable), 0.0
        )[owner]
    starts = tuple(np.cumsum([0, *(len(m) for m in measurements[:-1])]).tolist())
    return _Stack(equations, usable, weights, np.concatenate(clusters), np.concatenate(times), starts)


def _fit(scheme: Regressor, data: _Stack, terms: Sequence[Term], lender: Model | None) -> Identified:
    """Batch estimate with honest standard errors, and the recursion on its way there."""
    columns = [column for term in terms for column in term.columns]
    loans = {
        j: lender.estimates[column.name]
        for j, column in enumerate(columns)
        if lender is not None and column.mass is not zero
    }
    known = {j: Estimate(column.least, 0.0, column.unit) for j, column in enumerate(columns) if column.is_known}
    loans = {j: loan for j, loan in loans.items() if j not in known}
    use = data.usable
    clusters = np.unique(data.clusters[use], return_inverse=True)[1]
    while True:
        given = loans | known
        free = [j for j in range(len(columns)) if j not in given]
        lent = np.array([estimate.value for estimate in given.values()])
        equations = give(data.equations, list(given), lent)
        # What was lent comes from the same data: its uncertainty widens that of the others
        jacobian = data.equations.phi[use][:, list(loans)] if loans else None
        fit = solve(Equations(equations.phi[use], equations.y[use]), data.weights[use], clusters, jacobian)
        values = dict(zip(free, fit.theta.tolist(), strict=True))
        left = [j for j, value in values.items() if not columns[j].allows(value)]
        if not left:
            break
        known |= {j: Estimate(columns[j].nearest(values[j]), 0.0, columns[j].unit) for j in left}  # stays at its bound
    if scheme.drifts:
        fit = replace(fit, covariance=_random_walk_covariance(equations, data, fit.theta))

    theta, std = np.empty(len(columns)), np.empty(len(columns))
    count = len(free)
    theta[free], theta[list(given)] = fit.theta, lent
    std[free], std[list(given)] = fit.std[: len(free)], [estimate.std for estimate in given.values()]
    return Identified(
        scheme=scheme.id,
        model=Model.build(terms, theta, std).correlated(
            [columns[j].name for j in free], fit.covariance[:count, :count]
        ),
        convergence=converge(
            equations, data.weights, use, data.time, fit, free, theta, std, evenly(len(data.time), POINTS)
        ),
        residual_rms=fit.rms,
        unit=scheme.unit,
        condition=fit.condition,
        used=(int(use.sum()), len(use)),
    )


def _random_walk_covariance(equations: Equations, data: _Stack, theta: Array) -> Array:
    """Covariance (F, F) of a least-squares fit whose errors are running sums of independent increments.

    theta - truth = (phi' phi)^-1 sum_k phi_k e_k with e_k = sum_{j <= k} d_j, and so = (phi' phi)^-1 sum_j d_j S_j with
    S_j the sum of phi from j to the end of the recording: one score for each cluster of increments.
    """
    weights = (data.weights * data.usable)[:, None]
    phi, error = equations.phi * weights, (equations.y - equations.phi @ theta) * data.usable
    ends = [*data.starts[1:], len(error)]
    rest, increment = np.empty_like(phi), np.empty_like(error)
    for begin, end in zip(data.starts, ends, strict=True):
        rest[begin:end] = np.cumsum((phi * weights)[begin:end][::-1], axis=0)[::-1]
        increment[begin:end] = np.diff(error[begin:end], prepend=0.0)
    scores = np.zeros((int(data.clusters.max()) + 1, phi.shape[1]))
    np.add.at(scores, data.clusters, rest * increment[:, None])
    bread = np.linalg.pinv(phi.T @ phi, hermitian=True)
    covariance: Array = bread @ (scores.T @ scores) @ bread * (len(scores) / max(1, len(scores) - phi.shape[1]))
    return covariance


def converge(
    equations: Equations,
    weights: Array,
    usable: Mask,
    time: Array,
    fit: Fit,
    free: Sequence[int] | Index,
    theta: Array,
    std: Array,
    points: Index,
) -> Convergence:
    """The recursion's history at some points, with P scaled so that its errors end at the batch estimate's."""
    weighted = Equations(equations.phi * weights[:, None], equations.y * weights)
    course = history(weighted, usable, points)
    spread = np.sqrt(np.diagonal(course.P, axis1=1, axis2=2))  # (K, F)
    thetas, stds = np.tile(theta, (len(spread), 1)), np.tile(std, (len(spread), 1))
    thetas[:, free] = course.theta
    stds[:, free] = spread * fit.std[: len(free)] / spread[-1]
    return Convergence(time[course.points], thetas, stds)
