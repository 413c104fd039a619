"""Whether recordings agree: each is fitted on its own, and parameters that differ by more than chance are named.

A joint fit takes one plant for granted. Where somebody changed the payload between two recordings, the joint estimate
lies somewhere in between, and a search finds effects that nobody hid. So each recording's own estimate is compared with
the pooled one of the others (Wald's test with sandwich covariances, corrected for the number of comparisons). A
difference counts if it is of practical size, too: some per cent, and more torque than the fits leave unexplained.

Source: Cochran, Biometrics 10(1), 1954, for pooled estimates and the statistic Q of what is left between groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from scipy.stats import t as student

from estimators.dataset import Dataset
from estimators.equations import Equations
from estimators.least_squares import solve
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Term

CHANCE = 1e-3  # of a false alarm in all comparisons of one diagnosis
PRACTICAL = 0.03  # of a parameter: a smaller difference is of no use to anybody
FEWEST = 40  # windows that a recording needs to have a say,
FREEDOM = 6  # stretches of time that it has more than parameters,
CONDITION = 1e4  # and condition number of its regressor: beyond, it cannot tell the parameters from one another
FITS = 1.3  # times the noise floor that a fit leaves at most where the model lacks nothing


@dataclass(frozen=True)
class Difference:
    """One parameter as one recording has it, and as the others have it; `std` is the difference's."""

    parameter: str
    unit: str
    value: float
    others: float
    std: float

    @property
    def share(self) -> float:
        """Difference relative to the value of the others."""
        return (self.value - self.others) / max(abs(self.others), 1e-300)

    @property
    def text(self) -> str:
        """`inertia 12 % higher`."""
        if abs(self.share) > 1:  # of a parameter near zero
            return f"{self.parameter} {self.value:.3g} instead of {self.others:.3g} {self.unit}"
        return f"{self.parameter} {100 * abs(self.share):.2g} % {'higher' if self.share > 0 else 'lower'}"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"name": self.parameter, "value": self.value, "others": self.others, "std": self.std, "unit": self.unit}


@dataclass(frozen=True)
class Disagreement:
    """A recording that does not show the plant that the others show.

    Attributes:
        recording: its number, from 1, held-out recordings following the fitted ones.
        name: of the recording.
        others: names of the recordings that agree with one another.
        differences: parameters that differ, the surest first.
    """

    recording: int
    name: str
    others: tuple[str, ...]
    differences: tuple[Difference, ...]

    @property
    def text(self) -> str:
        """One sentence for people."""
        others = "the others" if len(self.others) > 1 else f"'{self.others[0]}'"
        what = ", ".join(difference.text for difference in self.differences)
        return f"recording {self.recording} ({self.name}) disagrees with {others}: {what}"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "recording": self.recording,
            "name": self.name,
            "others": list(self.others),
            "parameters": [difference.json() for difference in self.differences],
            "text": self.text,
        }


@dataclass(frozen=True)
class Own:
    """The fit of the compared parameters to one recording alone.

    Attributes:
        number, name: of the recording.
        theta, covariance: (P,) and (P, P).
        load: RMS of each regressor column (P,): what torque a unit of the parameter makes.
        rms, floor: torque that the fit leaves, and that noise alone would leave [N m].
        freedom: degrees of freedom of the covariance.
    """

    number: int
    name: str
    theta: Array
    covariance: Array
    load: Array
    rms: float
    floor: float
    freedom: int


def disagreements(
    datasets: Sequence[Dataset], terms: Sequence[Term], *, only_if_all_fit: bool = False
) -> tuple[Disagreement, ...]:
    """Recordings that disagree with the largest agreeing part of them, in order; of two, the later one.

    Recordings that excite too little to be fitted on their own have no say. Parameters that an effect changes within
    a recording are not compared: each recording has a course of its own.

    Args:
        datasets: windowed equations of the recordings.
        terms: of the model that all of them share.
        only_if_all_fit: whether to say nothing unless the terms explain every single recording down to its noise, so
            that a missing effect is not taken for another plant.
    """
    if sum(len(data.windows) for data in datasets) < 2:
        return ()
    columns = [column for term in terms if term.kind != "time-varying" for column in term.columns]
    fits = own_fits(datasets, terms)
    if only_if_all_fit and any(fit.rms > FITS * fit.floor for fit in fits):
        return ()
    sure = CHANCE / (2 * max(1, len(fits) * len(columns)))

    def differences(fit: Own, others: Sequence[Own]) -> tuple[Difference, ...]:
        pooled, covariance = pool(others)
        gap, std = fit.theta - pooled, np.sqrt(np.diag(fit.covariance + covariance))
        surprise = np.abs(gap) / np.maximum(std, 1e-300)
        left = max(fit.rms, *(other.rms for other in others))
        large = (np.abs(gap) > PRACTICAL * np.abs(pooled)) & (fit.load * np.abs(gap) > left)
        told = np.flatnonzero(large & (surprise > student.ppf(1 - sure, fit.freedom)))
        return tuple(
            Difference(columns[j].name, columns[j].unit, float(fit.theta[j]), float(pooled[j]), float(std[j]))
            for j in sorted(told, key=lambda j: -surprise[j])
        )

    agreeing = list(fits)
    while len(agreeing) > 1:
        rest = {fit.number: [other for other in agreeing if other is not fit] for fit in agreeing}
        if not any(differences(fit, rest[fit.number]) for fit in agreeing):
            break
        # the one without whom the rest agree best; of two, the later one
        agreeing = rest[min(reversed(agreeing), key=lambda fit: spread(rest[fit.number])).number]
    others = tuple(fit.name for fit in agreeing)
    found = ((fit, differences(fit, agreeing)) for fit in fits if fit not in agreeing)
    return tuple(Disagreement(fit.number, fit.name, others, told) for fit, told in found if told)


def own_fits(datasets: Sequence[Dataset], terms: Sequence[Term]) -> list[Own]:
    """Fits of the parameters that do not change with time to each recording alone, where it allows one."""
    constant = np.array([term.kind != "time-varying" for term in terms for _ in term.columns], dtype=bool)
    fits, number = [], 0
    for data in datasets:
        equations = data.equations(terms)
        ends = accumulate((len(w.centers) for w in data.windows), initial=0)
        for w, (first, stop) in zip(data.windows, pairwise(ends), strict=True):
            number += 1
            rows = slice(first, stop)
            clusters = np.unique(data.clusters[rows], return_inverse=True)[1]
            freedom = int(clusters.max(initial=-1)) + 1 - len(constant)
            if stop - first < FEWEST or freedom < FREEDOM:
                continue
            own = Equations(equations.phi[rows], equations.y[rows])
            fit = solve(own, np.ones(stop - first), clusters)
            if fit.condition > CONDITION:
                continue
            fits.append(
                Own(
                    number,
                    w.recording.name,
                    fit.theta[constant],
                    fit.covariance[np.ix_(constant, constant)],
                    np.sqrt(np.mean(own.phi[:, constant] ** 2, axis=0)),
                    fit.rms,
                    w.noise(abs(float(fit.theta[0]))),
                    freedom,
                )
            )
    return fits


def pool(fits: Sequence[Own]) -> tuple[Array, Array]:
    """Common parameters (P,) of several fits, weighted by what each knows, and their covariance (P, P)."""
    information = [np.linalg.inv(fit.covariance) for fit in fits]
    covariance = np.linalg.inv(sum(information))
    weighted = sum(part @ fit.theta for part, fit in zip(information, fits, strict=True))
    return covariance @ weighted, covariance


def spread(fits: Sequence[Own]) -> float:
    """Cochran's Q: how far several fits are from their common parameters, in standard errors squared."""
    if len(fits) == 1:
        return 0.0  # exactly, so that ties are ties
    pooled, _ = pool(fits)
    gaps = [fit.theta - pooled for fit in fits]
    return float(sum(gap @ np.linalg.solve(fit.covariance, gap) for gap, fit in zip(gaps, fits, strict=True)))
