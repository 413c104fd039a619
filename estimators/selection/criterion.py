"""Every number that decides what is named, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.weak_form.dataset import Structure


@dataclass(frozen=True)
class Criterion:
    """What an effect has to achieve, and when what is left counts as noise.

    Attributes:
        chance: probability that an effect predicts no better than its absence, up to which it may be added.
        share: of the structure left so far, that an effect has to explain: less is of no use to anybody,
        glimpse: that the best variant of a coarse grid has to explain, for its shape to be searched any further,
        needed: and once all others are in: what explains less than is left unexplained may be a part of that.
        noise: times the noise floor: residuals that neighbouring windows share to that size are structure,
        sure: if they surely share them, by so many standard errors.
        rival: probability from which an effect counts as possible in the place of another.
        misfit: times what noise gives, from which a free-running simulation runs away, and a torque error is more.
        certain: hit rate of the surest verdicts: then what is wrong is no rival, but something else.
        most: effects in one model.
        beam: first effects from which a search starts where the most promising one leads to no end.
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

    def shows(self, left: Structure, floor: float) -> bool:
        """Whether what is left is more than white noise: neighbouring windows surely share it, or it is too much."""
        return left.sure >= self.sure or left.all > self.misfit * floor

    def is_noise(self, left: Structure, floor: float) -> bool:
        """Whether what is left may as well be noise: white, or of a size that matters to nobody."""
        return not self.shows(left, floor) or max(left.shared / self.noise, left.all / self.misfit) < floor
