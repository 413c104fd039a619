"""Shares of a residual, or of the error of free motion, that a larger model explains."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from estimators.data.removed_noise import list_absorbed_noise
from estimators.decisions.criterion import has_structure
from estimators.decisions.errors import Terms
from estimators.memoize import memoized
from estimators.selection.free_motion import FreeMotion
from estimators.selection.residuals import Residuals, set_grid


class Power(NamedTuple):
    """Power of a model's residual at a joint [N^2 m^2].

    Attributes:
        total: mean square, plus the variance of torque noise that the model removes.
        correlated: mean square of the part that neighbouring windows share.
    """

    total: float
    correlated: float


@dataclass(eq=False, repr=False)
class ExplainedShares:
    """Shares that a larger model explains; powers of residuals are memoised.

    Attributes:
        residuals: residuals of fits.
        motion: errors of free motion.
    """

    residuals: Residuals
    motion: FreeMotion

    def compute(self, after: Terms, before: Terms, enough: float = np.inf) -> float:
        """Return the share of the residual torque, or of the error of free motion, that a larger model explains.

        It is the larger of both shares: an effect matters if it changes the torque or the motion. Windows of torque
        leave out stick and reversals, and noise of the torque may exceed the torque of an effect that moves the joint
        far. Motion is simulated only if the share of the torque is not above `enough`.
        """
        share = self.compute_of_torque(after, before)
        return share if share > enough else max(share, min(self.motion.compute_shares(after, before)))

    @memoized
    def _compute_powers(self, terms: Terms) -> list[dict[str, Power]]:
        """Return the power of a fit's residual at each joint, on training and on held-out data.

        Tables that do not cover the held-out data are refitted to each.
        """
        powers_by_part = []
        for part in self.residuals.parts:
            if self.residuals.are_refitted(terms):
                residual = part.residual(set_grid(part, terms))
            else:
                residual = part.equations(terms, by_noise=True).error(self.residuals.train.solve(terms))
            structures, powers = self.residuals.find_structures(part, residual), {}
            for at in self.residuals.joints:
                absorbed = list_absorbed_noise(part, [term for term in terms if term.at == at])
                total = structures[at].rms ** 2 + sum(variance for _, variance in absorbed)
                powers[at] = Power(total, structures[at].correlated_rms ** 2)
            powers_by_part.append(powers)
        return powers_by_part

    def compute_of_torque(
        self, after: Terms, before: Terms, above_floor: bool = False, has_holdout: bool = True
    ) -> float:
        """Return the share of one model's explainable residual power that a larger model explains, at its best joint.

        The share is the smaller of training and held-out data, or that of training data alone. Explainable power is

        - all power, if the residual of the smaller model has no structure;
        - removed power + correlated power of the rest + power of the rest / sqrt(number of rows), if its
          neighbouring windows are correlated;
        - all power above the noise floor otherwise, or with `above_floor`.

        Held-out data without structure do not count if the training data have structure. Removed power below the
        precision of the rows counts as zero. Joints other than the best may lose by a compensation of link parameters.
        """
        return max(min(self._explain_at(at, after, before, above_floor, has_holdout)) for at in self.residuals.joints)

    def _explain_at(self, at: str, after: Terms, before: Terms, above_floor: bool, has_holdout: bool) -> list[float]:
        """Return the shares at a joint, of training and of held-out data."""
        residuals, criterion = self.residuals, self.residuals.criterion
        powers = zip(residuals.parts, self._compute_powers(before), self._compute_powers(after), strict=True)
        structures, shares = [of_part[at] for of_part in residuals.structures(before)], list[float]()
        floors = [residuals.noise_floor(part, at) for part in residuals.parts]
        structured = [has_structure(*pair, criterion) for pair in zip(structures, floors, strict=True)]
        for k, (part, olds, news) in enumerate(islice(powers, 1 + has_holdout)):
            old, new = olds[at], news[at]
            removed = old.total - new.total
            if structured[0] and not structured[k]:
                continue
            if removed <= residuals.train.layout.precision[at] ** 2:
                shares.append(0.0)
            elif not structured[k]:
                shares.append(removed / old.total)
            elif structures[k].z_score >= criterion.z_score and not above_floor:
                resolution = new.total / len(part.layout.clusters[part.locate_rows(at)]) ** 0.5
                shares.append(removed / (removed + new.correlated + resolution))
            else:
                shares.append(removed / max(old.total - floors[k] ** 2, removed))
        return shares
