"""All numbers that decide which effect is named."""

from dataclasses import dataclass

from estimators.weak_form.dataset import Structure


@dataclass(frozen=True)
class Criterion:
    """Thresholds for adding an effect, and for a residual to count as noise, and how far the search goes.

    Attributes:
        chance: largest p-value of a gain in prediction at which an effect is added.
        share: least share of the residual structure that an added effect explains: less is of no practical use.
        glimpse: least share explained on a coarse grid of shapes; below it, the shape is not searched further.
        needed: least share beside all other effects: one that explains less than is left may be part of the rest.
        noise: times the noise floor: a part shared by neighbouring windows that is larger is structure, if significant.
        sure: standard errors from which the correlation of neighbouring windows is significant.
        rival: probability from which an effect counts as a competitor of another.
        misfit: times the error due to noise, above which a simulation diverges and a torque error is more than noise.
        certain: upper limit of any score: hit rate of the surest verdicts, whose errors have other causes than a rival.
        most: largest number of effects in one model.
        beam: first effects from which the search is repeated if the most promising one leaves structure.
        unlikely: p-value of an effect on a coarse grid of shapes, above which these are not searched further.
        tried: effects that are tried, the most promising first, until one is confirmed.
        ordered: effects up to which every order of their steps is tried: six orders at most.
        seen: share of an effect's torque that the others cannot imitate, below which the data do not show it.
        moment: pieces in which a drifting torque, which hardly changes within one, is predicted from the others [s].
        closer: share of the windows' length at a second look, where motion shows more than torque.
        finest: share of the motion, the accuracy of initial states and integration of a simulation.
    """

    chance: float = 0.05
    share: float = 0.2
    glimpse: float = 0.05
    needed: float = 0.5
    noise: float = 0.5
    sure: float = 5.0
    rival: float = 0.05
    misfit: float = 2.5
    certain: float = 0.98
    most: int = 6
    beam: int = 3
    unlikely: float = 0.5
    tried: int = 8
    ordered: int = 3
    seen: float = 0.001
    moment: float = 0.2
    closer: float = 0.5
    finest: float = 0.001

    def shows(self, left: Structure, floor: float) -> bool:
        """Whether a residual is more than white noise: significantly correlated between windows, or too large."""
        return left.sure >= self.sure or left.all > self.misfit * floor

    def is_noise(self, left: Structure, floor: float) -> bool:
        """Whether a residual counts as noise: white, or too small to matter."""
        return not self.shows(left, floor) or max(left.shared / self.noise, left.all / self.misfit) < floor
