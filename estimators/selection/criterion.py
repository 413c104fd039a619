"""All numbers that decide which effect is selected."""

from dataclasses import dataclass

from estimators.data.rows import ResidualStructure


@dataclass(frozen=True)
class Criterion:
    """Thresholds for an effect and for noise, and limits of the search.

    Attributes:
        p_value: largest p-value of a gain in prediction at which an effect is added.
        explained_share: least share of the residual structure that an added effect explains.
        coarse_share: least share explained on a coarse grid of nonlinear parameters; below it, they are not refined.
        needed_share: least share explained beside all other effects, while structure is left.
        kept_inertia: least share of the inertia that a larger model keeps; see `make_base_gates`.
        noise_ratio: ratio of correlated residual to noise floor from which a significant correlation is structure.
        z_score: standard errors from which the correlation of neighbouring windows is significant.
        tie_probability: probability from which an effect counts as a competitor of another.
        misfit: ratio of an error to its noise floor above which it is more than noise.
        max_score: upper limit of any score: the hit rate of the best verdicts.
        max_effects: largest number of effects in one model.
        beam: number of first effects from which the search is repeated if the first search leaves structure.
        coarse_p_value: largest p-value on a coarse grid of nonlinear parameters; above it, they are not refined.
        max_tried: number of effects that are tried, best score first, until one is confirmed.
        max_ordered: number of effects up to which every order of their steps is tried.
        least_excitation: least ratio of the recorded torque to the smallest significant torque of an effect.
        drift_piece: length of the pieces in which a drifting torque is predicted from the others [s].
        shorter_window: share of the windows' length in a second search, where motion shows more than torque.
        error_margin: share by which held-out errors under two treatments of the data differ by chance.
        accuracy: share of the motion that initial states and integration of a simulation are accurate to.
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
    accuracy: float = 0.001

    def has_structure(self, residual: ResidualStructure, floor: float) -> bool:
        """Return whether a residual is more than white noise: correlated between windows, or too large."""
        return residual.z_score >= self.z_score or residual.rms > self.misfit * floor

    def is_noise(self, residual: ResidualStructure, floor: float) -> bool:
        """Return whether a residual counts as noise: white, or too small to matter."""
        small = max(residual.correlated_rms / self.noise_ratio, residual.rms / self.misfit) < floor
        return small or not self.has_structure(residual, floor)
