"""Whether recordings agree: each is fitted on its own, and parameters that differ by more than chance are named.

A joint fit takes one plant for granted. Where somebody changed the payload between two recordings, the joint estimate
lies somewhere in between, and a search finds effects that nobody hid. So each recording's own estimate is compared with
the pooled one of the others (Wald's test with sandwich covariances, corrected for the number of comparisons). A
difference counts if it is of practical size, too: some per cent, and more torque than the fits leave unexplained.
In the same way recordings are compared with a model that is given.

Source: Cochran, Biometrics 10(1), 1954, for pooled estimates and the statistic Q of what is left between groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from estimators.regression.equations import Equations
from estimators.regression.least_squares import solve
from estimators.selection.candidates import Screen
from estimators.weak_form.dataset import Dataset
from pendulum_env._typing import JSON, Array, Mask
from pendulum_env.physics import Column, Model, Term

CHANCE = 1e-3  # of a false alarm in all comparisons of one diagnosis
PRACTICAL = 0.03  # of a parameter: a smaller difference is of no use to anybody
FEWEST = 40  # windows that a recording needs to have a say,
FREEDOM = 6  # stretches of time that it has more than parameters,
CONDITION = 1e4  # and condition number of its regressor: beyond, it cannot tell the parameters from one another
FITS = 1.3  # times the noise floor that a fit leaves at most where the model lacks nothing
MISFITS = 2.0  # times the noise floor that it leaves where the model surely lacks something


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
        percent = float(f"{100 * abs(self.share):.2g}")
        return f"{self.parameter} {percent:g} % {'higher' if self.share > 0 else 'lower'}"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"name": self.parameter, "value": self.value, "others": self.others, "std": self.std, "unit": self.unit}


@dataclass(frozen=True)
class Disagreement:
    """A recording that does not show the plant that the others show, or that a model is of.

    Attributes:
        recording: its number, from 1, held-out recordings following the fitted ones.
        name: of the recording.
        others: names of the recordings that agree with one another; none if it is a model that it disagrees with.
        differences: parameters that differ, the surest first; none if no parameters fit the recording.
        reason: what it looks like, in words, where that says more than the differences.
    """

    recording: int
    name: str
    others: tuple[str, ...]
    differences: tuple[Difference, ...]
    reason: str | None = None

    @property
    def text(self) -> str:
        """One sentence for people."""
        one = f"'{self.others[0]}'" if self.others else "the model"
        others = "the others" if len(self.others) > 1 else one
        what = self.reason or ", ".join(difference.text for difference in self.differences)
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
        carried: inertia that is known to hang on the joint besides [kg m^2].
        rms, floor: torque that the fit leaves, and that noise alone would leave [N m].
        freedom: degrees of freedom of the covariance.
    """

    number: int
    name: str
    theta: Array
    covariance: Array
    load: Array
    carried: float
    rms: float
    floor: float
    freedom: int

    @property
    def std(self) -> Array:
        """Standard errors (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def is_explained(self) -> bool:
        """Whether the model lacks nothing that shows in this recording."""
        return self.rms <= FITS * self.floor


@dataclass(frozen=True)
class Comparing:
    """How parameters are compared: names and units of the P columns, and the level of each single comparison."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    level: float

    @classmethod
    def of(cls, terms: Sequence[Term], fits: Sequence[Own]) -> Comparing:
        """Comparison of all fits of the parameters that are compared."""
        columns = _compared(terms)
        level = 1 - CHANCE / (2 * max(1, len(fits) * len(columns)))
        return cls(tuple(column.name for column in columns), tuple(column.unit for column in columns), level)

    def surprising(self, fit: Own, gap: Array, std: Array) -> Mask:
        """Which gaps (P,) with standard errors (P,) are no chance."""
        chance: Mask = np.abs(gap) > stdtrit(fit.freedom, self.level) * np.maximum(std, 1e-300)
        return chance

    def is_turned(self, fit: Own) -> bool:
        """Whether inertia, with what is known to hang there, is surely negative: torque or position is turned round."""
        if "inertia" not in self.names:
            return False
        moved = fit.theta + fit.carried * (np.array(self.names) == "inertia")
        negative = self.surprising(fit, moved, fit.std) & (moved < 0)
        return bool(negative[self.names.index("inertia")])

    def differences(self, fit: Own, theta: Array, covariance: Array, left: float) -> tuple[Difference, ...]:
        """How a fit differs from parameters (P,) with a covariance (P, P) by more than chance and `left` [N m]."""
        gap, std = fit.theta - theta, np.sqrt(np.diag(fit.covariance + covariance))
        large = (np.abs(gap) > PRACTICAL * np.abs(theta)) & (fit.load * np.abs(gap) > left)
        told, surprise = np.flatnonzero(large & self.surprising(fit, gap, std)), np.abs(gap) / np.maximum(std, 1e-300)
        return tuple(
            Difference(self.names[j], self.units[j], float(fit.theta[j]), float(theta[j]), float(std[j]))
            for j in sorted(told, key=lambda j: -surprise[j])
        )

    def reason(self, fit: Own, theta: Array, covariance: Array) -> str | None:
        """What the torque of a recording looks like if all its parameters differ from (P,) by one factor."""
        if self.is_turned(fit):
            return "torque or position has the opposite sign in it"
        weight = np.linalg.pinv(fit.covariance + covariance, hermitian=True)
        factor = float(theta @ weight @ fit.theta) / max(float(theta @ weight @ theta), 1e-300)
        gap, std = fit.theta - factor * theta, np.sqrt(np.diag(fit.covariance + factor**2 * covariance))
        alike = (np.abs(gap) <= PRACTICAL * np.abs(factor * theta)) | ~self.surprising(fit, gap, std)
        if len(theta) < 2 or not alike.all() or abs(factor - 1) <= PRACTICAL:
            return None
        return f"its torque is {factor:.3g} times what the same motion takes there"


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
            that a missing effect is not taken for another plant; a negative inertia is no missing effect, and is said.
    """
    if sum(len(data.windows) for data in datasets) < 2:
        return ()
    fits = own_fits(datasets, terms)
    comparing = Comparing.of(terms, fits)

    def differences(fit: Own, others: Sequence[Own]) -> tuple[Difference, ...]:
        return comparing.differences(fit, *pool(others), max(fit.rms, *(other.rms for other in others)))

    agreeing = [fit for fit in fits if not comparing.is_turned(fit)] or list(fits)
    turned_only = only_if_all_fit and not all(fit.is_explained for fit in fits)
    while len(agreeing) > 1 and not turned_only:
        rest = {fit.number: [other for other in agreeing if other is not fit] for fit in agreeing}
        if not any(differences(fit, rest[fit.number]) for fit in agreeing):
            break
        # the one without whom the rest agree best; of two, the later one
        agreeing = rest[min(reversed(agreeing), key=lambda fit: spread(rest[fit.number])).number]
    others = tuple(fit.name for fit in agreeing)
    return tuple(
        Disagreement(fit.number, fit.name, others, told, comparing.reason(fit, *pool(agreeing)))
        for fit in fits
        if fit not in agreeing and (told := differences(fit, agreeing))
    )


def disagreements_with(model: Model, data: Dataset) -> tuple[Disagreement, ...]:
    """Recordings of another plant than a model's, in order; not those that the model's terms cannot explain."""
    fits = own_fits([data], model.terms)
    comparing = Comparing.of(model.terms, fits)
    estimates = [model.estimates[name] for name in comparing.names]
    theta = np.array([estimate.value for estimate in estimates])
    covariance = np.diag([estimate.std**2 for estimate in estimates])
    return tuple(
        Disagreement(fit.number, fit.name, (), told, comparing.reason(fit, theta, covariance))
        for fit in fits
        if (fit.is_explained or comparing.is_turned(fit))
        and (told := comparing.differences(fit, theta, covariance, fit.rms))
    )


def misfits(data: Dataset, terms: Sequence[Term]) -> tuple[Disagreement, ...]:
    """Recordings that the terms cannot explain beside as many or more that they do explain, in order."""
    fits = own_fits([data], terms)
    others = tuple(fit.name for fit in fits if fit.is_explained)
    poor = [fit for fit in fits if fit.rms > MISFITS * fit.floor]
    if len(others) < len(poor):
        return ()
    return tuple(
        Disagreement(
            fit.number,
            fit.name,
            others,
            (),
            f"no parameters fit it ({fit.rms:.2g} N m are left, {fit.rms / fit.floor:.2g} times the noise), so that "
            "something was changed, or an effect shows there only",
        )
        for fit in poor
    )


def _compared(terms: Sequence[Term]) -> list[Column]:
    """Columns whose parameters are compared: not what changes with time, nor factors of the torque itself.

    Those one recording alone hardly tells from the size of all the others.
    """
    of_motion = [term for term in terms if term.kind != "time-varying"]
    return [column for term in of_motion for column in term.columns if not column.of_torque]


def own_fits(datasets: Sequence[Dataset], terms: Sequence[Term]) -> list[Own]:
    """Fits of the parameters that are compared to each recording alone, where it allows one."""
    columns = [column for term in terms for column in term.columns if not column.of_torque]
    fitted = np.array([not column.of_torque for term in terms for column in term.columns], dtype=bool)
    names, told = ([column.name for column in some] for some in (columns, _compared(terms)))
    compared = np.isin(names, told)
    fits, number = [], 0
    for data in datasets:
        near = Screen(data).balance(terms).tangent()
        phi = near.slopes[:, fitted]
        y = near.error + phi @ near.theta[fitted]
        for place, w in enumerate(data.windows):
            number += 1
            rows = data.recording_of_window == place
            clusters = np.unique(data.clusters[rows], return_inverse=True)[1]
            freedom = int(clusters.max(initial=-1)) + 1 - len(columns)
            if len(clusters) < FEWEST or freedom < FREEDOM:
                continue
            own = Equations(phi[rows], y[rows])
            fit = solve(own, np.ones(len(clusters)), clusters)
            if fit.condition > CONDITION:
                continue
            inertia = abs(float(fit.theta[names.index("inertia")])) if "inertia" in names else 0.0
            fits.append(
                Own(
                    number,
                    w.recording.name,
                    fit.theta[compared],
                    fit.covariance[np.ix_(compared, compared)],
                    np.sqrt(np.mean(own.phi[:, compared] ** 2, axis=0)),
                    float(np.max(w.samples.load.inertia)),
                    fit.rms,
                    float(np.sqrt(np.mean(near.scale[rows] ** 2))) * w.noise(inertia),
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
