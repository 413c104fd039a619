"""One statistic for all alternatives to a model, effects and changes: its evidence, and the threshold of an alarm.

Each block of time gives a factor e with a conditional mean of at most one while the model holds. Factors multiply to
wealth M, which restarts from one wherever it is below, so that a later change is detected as fast,

    M <- max(M, 1) e.

The mean time until M, or its mean over challengers, reaches A is at least A blocks: the threshold follows from the
accepted alarms per hour. There are two kinds of factors:

- a bet, 1 + s g / c: a share s of the wealth is staked on the gain g of a block, with losses of at most c. It assumes
  nothing about the distribution of gains. The mean over several shares is again such a bet.
- a likelihood ratio, exp(z - 1/2), of a gain z standardised by its distribution while nothing changes (`Usual`): M is
  then the CUSUM for a shift by one standard deviation. It assumes tails no heavier than normal. Bets on the same z take
  four times as long for most effects, and find no payload in ten seconds (`benchmarks.watching`).

Source: Lorden, Annals of Mathematical Statistics 42(6), 1971, for the CUSUM; Shafer and Vovk, Game-Theoretic
Foundations for Probability and Finance, 2019; Shin, Ramdas and Rinaldo, E-detectors, New England Journal of Statistics
in Data Science, 2023; Choe and Ramdas, Comparing sequential forecasters, Operations Research, 2023.
"""

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array

HOUR = 3600.0
SHARES = np.array([0.05, 0.2, 0.8])  # of the wealth at stake
MOST = 10.0  # units, the largest gain of a block: no single block decides
UNIT = 1.0  # nat, the least unit
MARGIN = 1.5  # times the largest loss so far, the unit


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


class Evidence:
    """Wealth of K challengers, each in S games at once."""

    def __init__(self, challengers: int, games: int = 1) -> None:
        """Take K and S."""
        self._wealth = np.zeros((challengers, games))  # log M

    def add(self, factor: Array | float, which: int | slice = slice(None)) -> None:
        """Take in the log factors of a block, of some of the challengers (K, S) [nat]."""
        self._wealth[which] = np.maximum(self._wealth[which], 0.0) + factor

    @property
    def each(self) -> Array:
        """Log wealth of each challenger (K,) [nat]."""
        return np.asarray(np.logaddexp.reduce(self._wealth, axis=1) - np.log(self._wealth.shape[1]))

    @property
    def joint(self) -> float:
        """Log of the mean wealth, for some challenger [nat]."""
        return float(np.logaddexp.reduce(self.each) - np.log(max(1, len(self._wealth))))


class Bets(Evidence):
    """Evidence by bets on gains."""

    def __init__(self, challengers: int) -> None:
        """Take K."""
        super().__init__(challengers, len(SHARES))
        self._unit = np.full(challengers, UNIT)

    def take(self, gain: Array) -> None:
        """A block has ended: what each challenger gained in it (K,) [nat]."""
        won = np.clip(gain / self._unit, -1.0, MOST)
        self.add(np.log1p(SHARES * won[:, None]))
        self._unit = np.maximum(self._unit, -MARGIN * gain)


@dataclass(frozen=True)
class UsualSettings:
    """Numbers of what is usual; chosen on simulated plants by `benchmarks.watching`."""

    fewest: int = 3  # errors, before anything is usual
    prior: int = 4  # errors that what is known before any is worth
    scatter: float = 1.0  # standard deviation of the log of a mean square before any is known
    memory: int = 300  # errors, memory of the usual size
    most: float = 4.0  # standard deviations that an error counts for
    learnt: float = 2.0  # standard deviations that are learnt from one


USUAL = UsualSettings()


class Usual:
    """Distribution of log mean squared errors while a model holds: of blocks of rows or reversals, in Q units each.

    Attributes:
        mean: of the logs (Q,).
    """

    def __init__(self, units: int = 1) -> None:
        """Take Q; nothing is known yet."""
        self._learnt, self.mean, self._squares = 0, np.zeros(units), np.zeros(units)

    def learn(self, size: Array) -> None:
        """One more size (Q,) is usual."""
        bound = USUAL.learnt * self._scatter if self._learnt >= USUAL.fewest else np.inf
        step = np.clip(size - self.mean, -bound, bound)
        self._learnt = min(self._learnt + 1, USUAL.memory)
        share = 1.0 / self._learnt
        self.mean = self.mean + share * step
        kept = 1.0 if self._learnt < USUAL.memory else 1.0 - share
        self._squares = kept * (self._squares + (1.0 - share) * step**2)

    @property
    def _scatter(self) -> Array:
        return np.asarray(np.sqrt((USUAL.prior * USUAL.scatter**2 + self._squares) / (USUAL.prior + self._learnt - 1)))

    def surprise(self, sizes: Array) -> float:
        """By how many standard errors the mean of N sizes (N, Q) is larger than usual, in each of the units."""
        if self._learnt < USUAL.fewest:
            return 0.0
        new = np.clip((sizes - self.mean) / self._scatter, -USUAL.most, USUAL.most)
        return float(np.min(np.mean(new, axis=0)) / np.sqrt(1 / len(new) + 1 / self._learnt))
