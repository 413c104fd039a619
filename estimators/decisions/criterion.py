"""Limits of all decisions: on models, recordings, timing, columns of a log and controllers."""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple, cast

import numpy as np

from estimators.decisions.score import BLOCK
from pendulum_env.errors import UserError


class ResidualStructure(NamedTuple):
    """Size of a residual and of its correlated part.

    Attributes:
        correlated_rms: root of the covariance of neighbouring rows beyond sensor noise [N m], or [rad] of rollouts.
        z_score: correlation of neighbouring rows over its standard error.
        rms: root mean square of the residual [N m], or [rad].
    """

    correlated_rms: float
    z_score: float
    rms: float


class Limits:
    """Mixin of dataclasses whose representation has the fields that differ from their default."""

    __slots__ = ()

    def __repr__(self) -> str:
        own = ((field.name, getattr(self, field.name), field.default) for field in fields(cast(Any, self)))
        changed = [f"{name}={value!r}" for name, value, default in own if value != default]
        return f"{type(self).__name__}({', '.join(changed)})"


@dataclass(frozen=True, repr=False)
class SearchLimits(Limits):
    """Extent of the search.

    Attributes:
        max_effects: largest number of effects in one model.
        n_restarts: number of first effects from which the search is repeated if the first search leaves structure.
        max_tried: number of effects that are tried, best score first, until one is confirmed.
        max_ordered: number of effects up to which every order of their steps is tried.
    """

    max_effects: int = 6
    n_restarts: int = 3
    max_tried: int = 8
    max_ordered: int = 3


@dataclass(frozen=True, repr=False)
class WhiteNoiseLimits(Limits):
    """Limits of the tests of white torque noise.

    Attributes:
        p_value: p-value of the tests, all together, from which a residual is no torque noise.
        longest_lag: longest lag of the tests [s].
        most_hidden: share of the residual's power that the tests must exclude for an effect of two windows or longer.
    """

    p_value: float = 0.05
    longest_lag: float = 1.0
    most_hidden: float = 1 / 3


@dataclass(frozen=True, repr=False)
class TimingLimits(Limits):
    """Limits of the time between torque and motion, and of the feedback from motion to torque.

    Attributes:
        z_score: standard errors from which a delay, a lag or the reaction of a controller is significant.
        negligible: delay that counts as zero [samples]: the accuracy of clocks and of the steps of simulators.
        least_sampled: apparent delay of sampled torque [samples]: that of a controller that sets it twice a sample.
        correlation: least correlation of the innovations of torque and position; a smaller one biases no parameter.
        same_ratio: ratio of two frequencies below which they count as equal.
    """

    z_score: float = 4.0
    negligible: float = 0.1
    least_sampled: float = 0.25
    correlation: float = 0.1
    same_ratio: float = 1.2


@dataclass(frozen=True, repr=False)
class AgreementLimits(Limits):
    """Limits of the agreement of recordings, and of schemes.

    Attributes:
        false_alarm: probability of a false alarm in all comparisons of recordings of one diagnosis.
        difference: least relative difference of a parameter of two recordings that matters in practice.
        scheme_difference: the same of two schemes; sampling at 50 Hz reached 0.034.
        explained: largest ratio of the residual of a complete model to its noise floor.
        unexplained: ratio above which a model lacks an effect.
        least_windows: least number of windows of a compared recording.
        least_freedom: least number of clusters beyond the number of parameters of a compared recording.
    """

    false_alarm: float = 1e-3
    difference: float = 0.03
    scheme_difference: float = 0.05
    explained: float = 1.3
    unexplained: float = 2.0
    least_windows: int = 40
    least_freedom: int = 6


@dataclass(frozen=True, repr=False)
class ColumnLimits(Limits):
    """Limits of the tests for wrong columns of a log, and of the torque constant.

    Attributes:
        turned_share: least share of the load torque beyond the other columns and noise, if its sign is to be tested.
        upright_share: least gravity of a joint whose zero may be the upright position, as a share of the RMS torque.
        driven_share: share of samples driven by the motor, or braked by the load, above which gear losses and the
            torque constant cannot be distinguished: only the other samples distinguish both.
    """

    turned_share: float = 0.2
    upright_share: float = 0.05
    driven_share: float = 0.9


@dataclass(frozen=True, repr=False)
class LoopLimits(Limits):
    """Limits for recordings with a controller.

    Attributes:
        needed: least share of the squared error that an effect explains; sticking alone changes the error.
        dominant: the same of a link if the residual is not noise: a link imitates another controller.
        counts_p_value: largest p-value of a gain by which counts overrule exact positions: most controllers read
            counts.
        same: gain between two conventions below which their motion is equal [nat]: the output does not reach its limit.
        faithful: ratio of a model's error to that of the encoder below which the reading of the references is kept.
        slow_rate: assumed rate of a controller of unknown rate [Hz].
        torque_scale: relative difference of logged and requested torque that is reported.
    """

    needed: float = 0.3
    dominant: float = 0.75
    counts_p_value: float = 0.16
    same: float = 1e-3
    faithful: float = 2.0
    slow_rate: float = 200.0
    torque_scale: float = 0.1


@dataclass(frozen=True, repr=False)
class Criterion(Limits):
    """Thresholds for an effect and for noise, and limits of the search.

    Attributes:
        p_value: largest p-value of a gain in prediction at which an effect is added.
        explained_share: least share of the residual structure, or of the motion error, that an added effect explains;
            between `coarse_share` and `needed_share`.
        coarse_share: least explained share, of training data alone, of the best of a coarse grid of nonlinear
            parameters that is refined.
        needed_share: least share that a needed effect explains of the residual of all other effects.
        kept_inertia: least share of the inertia that a larger model keeps, see `gates.compare_base`; and of the inertia
            or torque that a law of the time of the torque keeps.
        noise_ratio: ratio of correlated residual to noise floor below which a correlation does not matter.
        z_score: standard errors from which a correlation of neighbouring windows, the sign of a load torque, a torque
            constant or a difference of two schemes is significant.
        tie_probability: probability above which a model ties with another.
        misfit_ratio: ratio of an error to its noise floor above which it is more than noise.
        max_score: upper limit of any reported score, the hit rate of the best verdicts.
        least_excitation: least ratio of the recorded torque to the smallest significant torque of an effect.
        block: length of a block of time [s], by which densities are summed and data are folded: residuals of a real
            machine are correlated for less.
        drift_piece: length of the pieces by which folds predict a drifting torque [s].
        shorter_window: factor on the window lengths in a second search.
        equal_error_share: relative difference of errors or noise floors that is chance: of torque errors with an effect
            that only free motion shows, and of a negligible delay.
        accuracy: error of a simulation by initial states and integration, share of the motion's standard deviation.
        search, white, timing, agreement, columns, loop: limits of questions of their own.
    """

    p_value: float = 0.05
    explained_share: float = 0.2
    coarse_share: float = 0.05
    needed_share: float = 0.5
    kept_inertia: float = 0.5
    noise_ratio: float = 0.5
    z_score: float = 5.0
    tie_probability: float = 0.05
    misfit_ratio: float = 2.5
    max_score: float = 0.98
    least_excitation: float = 10.0
    block: float = BLOCK
    drift_piece: float = 0.2
    shorter_window: float = 0.5
    equal_error_share: float = 0.05
    accuracy: float = 0.001
    search: SearchLimits = SearchLimits()
    white: WhiteNoiseLimits = WhiteNoiseLimits()
    timing: TimingLimits = TimingLimits()
    agreement: AgreementLimits = AgreementLimits()
    columns: ColumnLimits = ColumnLimits()
    loop: LoopLimits = LoopLimits()

    def __post_init__(self) -> None:
        if not 0 < self.p_value < 1:
            raise UserError(f"p_value of a criterion cannot be {self.p_value}: give a number between 0 and 1")
        if not 0 < self.block < np.inf:
            raise UserError(f"block of a criterion cannot be {self.block}: give a positive length in seconds")


def has_structure(residual: ResidualStructure, floor: float, criterion: Criterion) -> bool:
    """Return whether a residual is correlated between windows, or above `misfit_ratio` times the noise floor."""
    return residual.z_score >= criterion.z_score or residual.rms > criterion.misfit_ratio * floor


def is_noise(residual: ResidualStructure, floor: float, criterion: Criterion) -> bool:
    """Return whether a residual is without structure, or small against the noise floor."""
    small = max(residual.correlated_rms / criterion.noise_ratio, residual.rms / criterion.misfit_ratio) < floor
    return small or not has_structure(residual, floor, criterion)
