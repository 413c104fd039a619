"""Numbers that decide which effect is selected."""

from dataclasses import dataclass
from typing import NamedTuple


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


@dataclass(frozen=True)
class Criterion:
    """Thresholds for an effect and for noise, and limits of the search.

    Attributes:
        p_value: largest p-value of a gain in prediction at which an effect is added.
        explained_share: least share of the residual structure, or of the motion error, that an added effect explains;
            between `coarse_share` and `needed_share`.
        coarse_share: explained share on a coarse grid of nonlinear parameters below which they are not refined.
        needed_share: least share that a needed effect explains of the residual of all other effects.
        kept_inertia: least share of the inertia that a larger model keeps; see `make_base_gates`.
        noise_ratio: ratio of correlated residual to noise floor below which a correlation does not matter.
        z_score: standard errors from which the correlation of neighbouring windows is significant.
        tie_probability: probability above which a model ties with another.
        misfit: ratio of an error to its noise floor above which it is more than noise.
        max_score: upper limit of any reported score, the hit rate of the best verdicts.
        max_effects: largest number of effects in one model.
        beam: number of first effects from which the search is repeated if the first search leaves structure.
        coarse_p_value: p-value on a coarse grid of nonlinear parameters above which they are not refined.
        max_tried: number of effects that are tried, best score first, until one is confirmed.
        max_ordered: number of effects up to which every order of their steps is tried.
        least_excitation: least ratio of the recorded torque to the smallest significant torque of an effect.
        drift_piece: length of the pieces by which folds predict a drifting torque [s].
        shorter_window: factor on the window lengths in a second search.
        error_margin: relative difference of held-out errors under two treatments that is chance.
        white_p_value: p-value of the tests of white noise, all together, from which a residual is no torque noise.
        longest_lag: longest lag of these tests [s].
        least_windows: least number of separate windows for these tests.
        accuracy: error of a simulation by initial states and integration, share of the motion's standard deviation.
    """

    p_value: float = 0.05
    explained_share: float = 0.2
    coarse_share: float = 0.05
    needed_share: float = 0.5
    kept_inertia: float = 0.5
    noise_ratio: float = 0.5
    z_score: float = 5.0
    tie_probability: float = 0.05
    misfit: float = 2.5
    max_score: float = 0.98
    max_effects: int = 6
    beam: int = 3
    coarse_p_value: float = 0.5
    max_tried: int = 8
    max_ordered: int = 3
    least_excitation: float = 10.0
    drift_piece: float = 0.2
    shorter_window: float = 0.5
    error_margin: float = 0.05
    white_p_value: float = 0.05
    longest_lag: float = 1.0
    least_windows: int = 100
    accuracy: float = 0.001

    def has_structure(self, residual: ResidualStructure, floor: float) -> bool:
        """Return whether a residual is correlated between windows, or above `misfit` times the noise floor."""
        return residual.z_score >= self.z_score or residual.rms > self.misfit * floor

    def is_noise(self, residual: ResidualStructure, floor: float) -> bool:
        """Return whether a residual is without structure, or small against the noise floor."""
        small = max(residual.correlated_rms / self.noise_ratio, residual.rms / self.misfit) < floor
        return small or not self.has_structure(residual, floor)
