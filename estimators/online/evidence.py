"""When a gain in prediction is no accident: bets on it, whose wealth is the evidence.

A bettor stakes a share of its wealth on a challenger's predicting better than the model in the next block of time. If
it does not on average, whatever came before, the wealth W is a fair or a losing game's, W <- W (1 + s g / c) with g the
gain of the block and c no less than what can be lost. By Ville's inequality such wealth exceeds A once in A games at
most, and nothing about the shape of the gains is assumed. To see what sets in later, one unit joins with every block,

    M <- (M + 1) (1 + s g / c),

and then M reaches A after A blocks on average, at least. So the threshold follows from the alarms per hour that are
accepted, and is the only one there is. Several shares s are played at once; the mean over them, and over challengers,
is again such a game.

Source: Ville 1939; Shafer and Vovk, Game-Theoretic Foundations for Probability and Finance, 2019; Shin, Ramdas and
Rinaldo, E-detectors, New England Journal of Statistics in Data Science, 2023; Choe and Ramdas, Comparing sequential
forecasters, Operations Research, 2023.
"""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import Array, Mask

HOUR = 3600.0
SHARES = np.array([0.05, 0.2, 0.8])  # of the wealth, that are staked
MOST = 10.0  # units that a block wins at most: no single one decides
UNIT = 1.0  # nat, the least unit
MARGIN = 1.5  # times the largest loss so far, the unit


def threshold_of(alarms_per_hour: float, block: float) -> float:
    """Log evidence of an alarm [nat], where blocks last that long [s].

    Raises:
        ValueError: if alarms would be as frequent as blocks, or there are none.
    """
    if not 0 < alarms_per_hour < HOUR / block:
        raise ValueError(
            f"alarms_per_hour ({alarms_per_hour:g}) has to be positive, and less than one a block of {block:g} s"
        )
    return float(np.log(HOUR / block / alarms_per_hour))


class Bets:
    """Bets on K challengers of each of B models.

    Attributes:
        evidence: log M of each challenger (B, K) [nat].
    """

    def __init__(self, batch: int, challengers: int) -> None:
        """Take B and K."""
        self._wealth = np.full((batch, challengers, len(SHARES)), -np.inf)  # log M
        self._unit = np.full((batch, challengers), UNIT)
        self.evidence = np.full((batch, challengers), -np.inf)

    def reset(self, which: Mask) -> None:
        """Those of the B begin anew."""
        self._wealth[which], self.evidence[which], self._unit[which] = -np.inf, -np.inf, UNIT

    def take(self, gain: Array, due: Mask) -> None:
        """A block has ended for those of the B that are due (B,): what each challenger gained in it (B, K) [nat]."""
        won = np.clip(gain / self._unit, -1.0, MOST)
        grown = np.logaddexp(self._wealth, 0.0) + np.log1p(SHARES * won[..., None])
        which = due[:, None]
        self._wealth = np.where(which[..., None], grown, self._wealth)
        self._unit = np.where(which, np.maximum(self._unit, -MARGIN * gain), self._unit)
        self.evidence = np.logaddexp.reduce(self._wealth, axis=2) - np.log(len(SHARES))

    @property
    def joint(self) -> Array:
        """Log evidence that some challenger predicts better (B,) [nat]."""
        return np.asarray(np.logaddexp.reduce(self.evidence, axis=1) - np.log(max(1, self.evidence.shape[1])))
