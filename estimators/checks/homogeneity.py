"""Agreement of recordings: each is fitted separately, and significantly different parameters are named.

A joint fit assumes one plant. If the payload changes between two recordings, a search of both finds effects that do
not exist. The estimate of each recording is therefore compared with the pooled estimate of the others. The test is
Wald's with sandwich covariances, corrected for the number of comparisons. A difference must also be of practical size:
some per cent, and larger than the bias that the residuals allow. Recordings are compared with a model in the same way.

Source: Cochran, Biometrics 10(1), 1954, for pooled estimates and the statistic Q of differences between groups.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from estimators.checks.settings import CHECKS
from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import Policy, decide
from estimators.decisions.gate import Gate
from estimators.findings import Finding, Quantity
from estimators.regression.least_squares import Equations, invert_covariance, solve
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import Column, Model, Term
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.units import TURNING, JointUnits


@dataclass(frozen=True)
class Difference:
    """Parameter of one recording and of the others; `std` is the standard error of the difference."""

    parameter: str
    unit: str
    value: float
    others: float
    std: float


@dataclass(frozen=True)
class Disagreement(Finding):
    """Recording of a different plant than the other recordings or a model.

    Attributes:
        number: its number, from 1; held-out recordings follow the fitted recordings.
        recording: its name.
        others: names of the recordings that agree with each other; none if the recording disagrees with a model.
        differences: parameters that differ, the most significant first; none if no parameters fit the recording.
        is_turned: whether torque or position has the opposite sign in it.
        torque_factor, inertia_factor: factor of the torque or inertia that explains all differences, else None.
        residual: residual torque of a recording that no parameters fit, else None.
        noise_ratio: ratio of this residual to the noise floor.
    """

    number: int
    recording: str
    others: tuple[str, ...]
    differences: tuple[Difference, ...] = ()
    is_turned: bool = False
    torque_factor: float | None = None
    inertia_factor: float | None = None
    residual: Quantity | None = None
    noise_ratio: float | None = None


class ComparedParameters(NamedTuple):
    """Compared parameters of a recording, of several recordings, or of a model.

    Attributes:
        theta, covariance: (P,) and (P, P).
        bias: largest change of each parameter by a missing effect as large as the residual (P,).
    """

    theta: Array
    covariance: Array
    bias: Array


@dataclass(frozen=True)
class RecordingFit:
    """Fit of the compared parameters to one recording.

    Attributes:
        number, name: number and name of the recording.
        columns: columns of the compared parameters.
        estimates: estimates of these parameters.
        is_turned: whether the inertia with the known load is significantly negative, so torque or position has the
            wrong sign.
        rms, floor: RMS of the residual torque and of its noise [N m].
        z_limit: standard errors above which a difference is significant.
        is_free: whether the recording is a free swing; its parameters are relative to the inertia.
        units: units of parameters and residual.
        criterion: limits of the comparison.
    """

    number: int
    name: str
    columns: tuple[Column, ...]
    estimates: ComparedParameters
    is_turned: bool
    rms: float
    floor: float
    z_limit: float
    is_free: bool = False
    units: JointUnits = TURNING
    criterion: Criterion = Criterion()

    @property
    def noise_ratio(self) -> float:
        """Return the ratio of residual and noise."""
        return self.rms / max(self.floor, 1e-300)

    @property
    def is_explained(self) -> bool:
        """Return whether the residual of this recording is noise."""
        return self.noise_ratio <= self.criterion.agreement.explained

    def find_differences(self, other: ComparedParameters) -> tuple[Difference, ...]:
        """Return the parameters that differ from `other` significantly, the most significant first.

        They fail `AGREE`.
        """
        gates = decide(self, replace(self, estimates=other), AGREE).gates
        pairs = zip(gates, self.estimates.theta.tolist(), other.theta.tolist(), strict=True)
        differences = [
            Difference(gate.name, gate.unit, value, others, gate.std or 0.0)
            for gate, value, others in pairs
            if not gate.passed
        ]
        return tuple(sorted(differences, key=lambda d: -abs(d.value - d.others) / d.std))

    def find_factor(self, other: ComparedParameters) -> float | None:
        """Return the factor of all parameters that explains the differences; None without one."""
        if self.is_turned:
            return None
        weight = np.linalg.pinv(self.estimates.covariance + other.covariance, hermitian=True)
        scale = float(other.theta @ weight @ other.theta)
        factor = float(other.theta @ weight @ self.estimates.theta) / max(scale, 1e-300)
        scaled = other._replace(theta=factor * other.theta, covariance=factor**2 * other.covariance)
        (gap, std), least = self.compute_gap(scaled), self.criterion.agreement.difference
        is_equal = np.abs(gap) <= np.maximum(least * np.abs(scaled.theta), self.z_limit * std)
        if len(gap) < 2 or not is_equal.all() or abs(factor - 1) <= least:
            return None
        return factor

    def compute_gap(self, other: ComparedParameters) -> tuple[Array, Array]:
        """Compute the differences of the parameters and their standard errors (P,)."""
        variance = np.diag(self.estimates.covariance + other.covariance)
        return self.estimates.theta - other.theta, np.maximum(np.sqrt(variance), 1e-300)


def require_equal_parameters(after: RecordingFit, before: RecordingFit) -> Iterator[Gate]:
    """Test the difference of each parameter.

    It may be `agreement.difference` of the value before, or the sum of the biases, or `z_limit` standard errors.
    """
    known, own, share = before.estimates, after.estimates, after.criterion.agreement.difference
    gap, std = after.compute_gap(known)
    most = np.maximum(np.maximum(share * np.abs(known.theta), own.bias + known.bias), after.z_limit * std)
    for column, *numbers in zip(after.columns, np.abs(gap).tolist(), most.tolist(), std.tolist(), strict=True):
        size, limit, error = numbers
        yield Gate(column.name, size, limit, size <= limit, after.units.unit(column.unit), error)


# Parameters of one recording are those of others.
AGREE = Policy("agree", (require_equal_parameters,))


def find_disagreements(fits: Sequence[RecordingFit], *, only_if_all_fit: bool = False) -> tuple[Disagreement, ...]:
    """Find the recordings that disagree with the largest agreeing group; of two recordings, the later.

    With `only_if_all_fit`, only a negative inertia counts if a residual of a recording is not noise: a missing effect
    then explains other differences.
    """
    agreeing = [fit for fit in fits if not fit.is_turned] or list(fits)
    turned_only = only_if_all_fit and not all(fit.is_explained for fit in fits)
    while len(agreeing) > 1 and not turned_only:
        others_of = {fit.number: [other for other in agreeing if other is not fit] for fit in agreeing}
        if not any(fit.find_differences(pool_fits(others_of[fit.number])) for fit in agreeing):
            break
        # exclude the recording without which the others agree best; of two, the later
        agreeing = others_of[min(reversed(agreeing), key=lambda fit: compute_spread(others_of[fit.number])).number]
    others = tuple(fit.name for fit in agreeing)
    return (
        _select_differing([fit for fit in fits if fit not in agreeing], pool_fits(agreeing), others) if agreeing else ()
    )


def find_disagreements_with_model(model: Model, fits: Sequence[RecordingFit]) -> tuple[Disagreement, ...]:
    """Find the recordings that disagree with a model, among those that its terms explain."""
    estimates = [model.estimates[column.name] for column in (fits[0].columns if fits else ())]
    covariance = np.diag([estimate.std**2 for estimate in estimates])
    known = ComparedParameters(
        np.array([estimate.value for estimate in estimates]), covariance, np.zeros(len(estimates))
    )
    return _select_differing([fit for fit in fits if fit.is_explained or fit.is_turned], known, ())


def _select_differing(
    fits: Sequence[RecordingFit], known: ComparedParameters, others: tuple[str, ...]
) -> tuple[Disagreement, ...]:
    """Select the fits that differ from known parameters."""
    disagreements = []
    for fit in fits:
        if differences := fit.find_differences(known):
            factor = fit.find_factor(known)
            inertia_factor = 1 / factor if fit.is_free and factor is not None and factor > 0 else None
            torque_factor = factor if inertia_factor is None else None
            disagreements.append(
                Disagreement(
                    fit.number,
                    fit.name,
                    others,
                    differences,
                    is_turned=fit.is_turned,
                    torque_factor=torque_factor,
                    inertia_factor=inertia_factor,
                )
            )
    return tuple(disagreements)


def find_misfits(fits: Sequence[RecordingFit]) -> tuple[Disagreement, ...]:
    """Find the recordings that the terms do not explain; none if fewer recordings are explained.

    A residual between `agreement.explained` and `agreement.unexplained` noise floors is neither explained nor not.
    """
    others = tuple(fit.name for fit in fits if fit.is_explained)
    poor = [fit for fit in fits if fit.noise_ratio > fit.criterion.agreement.unexplained]
    if len(others) < len(poor):
        return ()
    misfits = []
    for fit in poor:
        residual = Quantity(fit.rms, unit=fit.units.unit(NEWTON_METRE))
        misfits.append(Disagreement(fit.number, fit.name, others, residual=residual, noise_ratio=fit.noise_ratio))
    return tuple(misfits)


def fit_each_recording(
    datasets: Sequence[TorqueWindows], terms: Sequence[Term], criterion: Criterion = Criterion()
) -> list[RecordingFit]:
    """Fit the parameters to each recording that excites them; return the fits in order.

    A fit is unweighted and uses the tangent at the joint fit of its data set. Recordings left out keep their number.
    Parameters of time-varying effects and transmissions are fitted but not compared: they may differ by recording.
    Factors of the torque stay at the joint fit: in one recording they equal a scale of all parameters. The inertia of
    free swings is known; free swings are not compared with driven recordings.
    """
    swings = [w.recording.known_inertia for data in datasets for w in data.windows]
    known = [all(swings) and column.name == "inertia" for term in terms for column in term.columns]
    term_columns = [(term, column) for term in terms for column in term.columns]
    fitted = np.array([not column.of_torque for _, column in term_columns]) & ~np.array(known, dtype=bool)
    term_columns = [pair for pair, is_fitted in zip(term_columns, fitted, strict=True) if is_fitted]
    compared = np.array([term.kind not in ("time-varying", "transmission") for term, _ in term_columns], dtype=bool)
    columns = tuple(column for (_, column), is_compared in zip(term_columns, compared, strict=True) if is_compared)
    names, fits, number = [column.name for _, column in term_columns], [], 0
    limits, n_windows = criterion.agreement, sum(len(data.windows) for data in datasets)
    level = 1 - limits.false_alarm / (2 * max(1, n_windows * len(columns)))
    for data in datasets:
        tangent = TorqueRows(data).equations(terms).linearise()
        phi = tangent.slopes[:, fitted]
        y = tangent.error + phi @ tangent.theta[fitted]
        if any(known):
            y = y + tangent.slopes[:, known] @ (tangent.theta[known] - max(swings))
        for k, w in enumerate(data.windows):
            number += 1
            rows = data.recording_of_window == k
            clusters = np.unique(data.clusters[rows], return_inverse=True)[1]
            freedom = int(clusters.max(initial=-1)) + 1 - len(names)
            is_alone = bool(w.recording.known_inertia) and not all(swings)
            if is_alone or len(clusters) < limits.least_windows or freedom < limits.least_freedom:
                continue
            fit = solve(Equations(phi[rows], y[rows]), np.ones(len(clusters)), clusters)
            if fit.condition > CHECKS.max_condition:
                continue
            # RMS torque of a unit of each parameter beyond the span of the other columns [N m]
            torque_of_unit = 1 / np.sqrt(np.diag(np.linalg.inv(phi[rows].T @ phi[rows] / len(clusters))))
            estimates = dict(zip(names, zip(fit.theta.tolist(), fit.std.tolist(), strict=True), strict=True))
            inertia, error = estimates.get("inertia", (w.recording.known_inertia, np.inf))
            z_limit = float(scipy.special.stdtrit(freedom, level))
            fits.append(
                RecordingFit(
                    number,
                    w.recording.name,
                    columns,
                    ComparedParameters(
                        fit.theta[compared],
                        fit.covariance[np.ix_(compared, compared)],
                        (fit.rms / torque_of_unit)[compared],
                    ),
                    bool(inertia + np.max(w.samples.load.inertia) < -z_limit * error),
                    fit.rms,
                    float(np.sqrt(np.mean(tangent.scale[rows] ** 2))) * w.noise.compute_std(abs(inertia)),
                    z_limit,
                    bool(w.recording.known_inertia),
                    w.recording.units,
                    criterion,
                )
            )
    return fits


def pool_fits(fits: Sequence[RecordingFit]) -> ComparedParameters:
    """Combine several fits, weighted by information; the bias of each parameter is the largest of the fits."""
    informations = [invert_covariance(fit.estimates.covariance) for fit in fits]
    covariance = invert_covariance(np.sum(informations, axis=0))
    weighted = sum(information @ fit.estimates.theta for information, fit in zip(informations, fits, strict=True))
    return ComparedParameters(covariance @ weighted, covariance, np.max([fit.estimates.bias for fit in fits], axis=0))


def compute_spread(fits: Sequence[RecordingFit]) -> float:
    """Compute Cochran's Q, the sum of squared differences from the pooled parameters in standard errors."""
    if len(fits) == 1:
        return 0.0  # without rounding errors, which would break ties
    pooled = pool_fits(fits).theta
    gaps = [fit.estimates.theta - pooled for fit in fits]
    return float(
        sum(gap @ invert_covariance(fit.estimates.covariance) @ gap for gap, fit in zip(gaps, fits, strict=True))
    )
