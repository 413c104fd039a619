"""One statistic for all alternatives to a model, effects and changes: its evidence, and the threshold of an alarm.

Each block of time gives a factor e with a conditional mean of at most one while the model holds: a bet, 1 + s g / c,
stakes a share s of the wealth on the gain g of a block, with losses of at most c. Gains may have any distribution
whose losses stay below c. The mean over several shares is again such a bet. Factors multiply to wealth M, which
restarts from one wherever it is below, so that a later change is detected as fast,

    M <- max(M, 1) e.

The mean time until M, or its mean over challengers, reaches A is at least A blocks: the threshold follows from the
accepted alarms per hour.

The bound c is not known: it is 1.5 times the largest loss so far, and a larger loss is clipped to c in its own block.
A clipped loss gives a conditional mean slightly above one, so the threshold holds approximately.

No model of a real machine is complete: a model with forgetting always predicts a little better. What counts as its gain
is what exceeds its usual gain (`UsualGain`).

Source: Lorden, Annals of Mathematical Statistics 42(6), 1971, for the restarts; Shafer and Vovk, Game-Theoretic
Foundations for Probability and Finance, 2019; Shin, Ramdas and Rinaldo, E-detectors, New England Journal of Statistics
in Data Science, 2023; Choe and Ramdas, Comparing sequential forecasters, Operations Research, 2023.
"""

import numpy as np

from pendulum_env._typing import Array

HOUR = 3600.0
SHARES = np.array([0.05, 0.2, 0.8])  # of the wealth at stake
MOST = 10.0  # units, the largest gain of a block: no single block decides
UNIT = 1.0  # nat, the least unit
MARGIN = 1.5  # times the largest loss so far, the unit
MEMORY = 300  # blocks, memory of the usual gain
FEWEST = 8  # blocks, before a gain is more than usual
OUTLIER = 2.0  # standard deviations above the usual gain, as which a larger gain is learnt


def threshold_of(alarms_per_hour: float, block: float) -> float:
    """Log wealth of an alarm [nat], where blocks last that long [s].

    Raises:
        ValueError: if alarms would be as frequent as blocks, or there are none.
    """
    if not 0 < alarms_per_hour < HOUR / block:
        raise ValueError(
            f"alarms_per_hour ({alarms_per_hour:g}) has to be positive, and less than one a block of {block:g} s"
        )
    return float(np.log(HOUR / block / alarms_per_hour))


class Bets:
    """Wealth of K challengers, each with several shares at stake."""

    def __init__(self, challengers: int) -> None:
        """Take K."""
        self._wealth = np.zeros((challengers, len(SHARES)))  # log M
        self._unit = np.full(challengers, UNIT)

    def take(self, gain: Array) -> None:
        """A block has ended: what each challenger gained in it (K,) [nat]."""
        won = np.clip(gain / self._unit, -1.0, MOST)
        self._wealth = np.maximum(self._wealth, 0.0) + np.log1p(SHARES * won[:, None])
        self._unit = np.maximum(self._unit, -MARGIN * gain)

    def restart(self, challenger: int) -> None:
        """Set the wealth of a challenger to one."""
        self._wealth[challenger] = 0.0

    @property
    def each(self) -> Array:
        """Log wealth of each challenger (K,) [nat]."""
        return np.asarray(np.logaddexp.reduce(self._wealth, axis=1) - np.log(self._wealth.shape[1]))

    @property
    def joint(self) -> float:
        """Log of the mean wealth over all challengers [nat]."""
        return float(np.logaddexp.reduce(self.each) - np.log(max(1, len(self._wealth))))


class UsualGain:
    """Mean and standard deviation of a challenger's gains so far; outliers count as smaller ones."""

    def __init__(self) -> None:
        """Begin without any gain."""
        self._count, self._mean, self._square = 0, 0.0, 0.0

    def excess(self, gain: float) -> float:
        """Gain of a block beyond the usual one by a standard deviation, which is then learnt [nat]."""
        std = float(np.sqrt(self._square))
        usual = max(0.0, self._mean + std)
        self._count = min(self._count + 1, MEMORY)
        step = min(gain, self._mean + OUTLIER * std + UNIT) - self._mean
        self._mean += step / self._count
        self._square += ((1.0 - 1.0 / self._count) * step**2 - self._square) / self._count
        return gain - usual if self._count > FEWEST else 0.0
