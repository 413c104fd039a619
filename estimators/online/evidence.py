"""Evidence for effects and changes by an e-process, and the threshold of an alarm.

Each block of time gives a factor e = 1 + s g / c, with the stake s, the gain g of the block, and a bound c of losses.
While the model holds, the conditional mean of e is at most one, for any distribution of gains with losses below c. The
mean over several stakes has the same property. The factors multiply to wealth M, which restarts from one if it is
below. A later change is therefore detected as fast,

    M <- max(M, 1) e.

The mean time until M, or its mean over competitors, reaches A is at least A blocks. The threshold follows from the
accepted alarms per hour.

The bound c is unknown: 1.5 times the largest loss so far is used, and a larger loss is clipped to c in its block. The
threshold is therefore approximate.

No model of a real machine is complete, so a model with forgetting always predicts slightly better. Only its gain above
the usual gain counts (`ReferenceDistribution`).

Source: Lorden, Annals of Mathematical Statistics 42(6), 1971, for the restarts; Shafer and Vovk, Game-Theoretic
Foundations for Probability and Finance, 2019; Shin, Ramdas and Rinaldo, E-detectors, New England Journal of Statistics
in Data Science, 2023; Choe and Ramdas, Comparing sequential forecasters, Operations Research, 2023.
"""

import numpy as np

from pendulum_env._typing import Array

HOUR = 3600.0
STAKES = np.array([0.05, 0.2, 0.8])  # shares of the wealth
MAX_GAIN = 10.0  # [c], upper limit of the gain of a single block
MIN_LOSS_BOUND = 1.0  # [nat], least value of c
MARGIN = 1.5  # ratio of c and the largest loss so far
MEMORY = 300  # blocks, memory of the reference distribution
MIN_BLOCKS = 8  # blocks before a gain counts
OUTLIER_LIMIT = 2.0  # standard deviations above the mean, to which larger gains are clipped


def compute_threshold(alarms_per_hour: float, block: float) -> float:
    """Compute the log wealth of an alarm [nat] for a duration of blocks [s]."""
    if not 0 < alarms_per_hour < HOUR / block:
        raise ValueError(
            f"alarms_per_hour is {alarms_per_hour:g}: give a positive number below {HOUR / block:g}, one per block"
        )
    return float(np.log(HOUR / block / alarms_per_hour))


class EProcess:
    """Wealth of K competitors, each with several stakes."""

    def __init__(self, competitors: int) -> None:
        """Create an e-process for a number K of competitors."""
        self._wealth = np.zeros((competitors, len(STAKES)))  # log M
        self._bound = np.full(competitors, MIN_LOSS_BOUND)

    def take(self, gain: Array) -> None:
        """Multiply the wealth of each competitor by the factor of a block with gains (K,) [nat].

        Losses are clipped to the bound c, gains to MAX_GAIN c. A larger loss raises the bound for later blocks.
        """
        relative_gain = np.clip(gain / self._bound, -1.0, MAX_GAIN)
        self._wealth = np.maximum(self._wealth, 0.0) + np.log1p(STAKES * relative_gain[:, None])
        self._bound = np.maximum(self._bound, -MARGIN * gain)

    def restart(self, competitor: int) -> None:
        """Set the wealth of a competitor to one."""
        self._wealth[competitor] = 0.0

    @property
    def log_wealth(self) -> Array:
        """Return the log wealth of each competitor (K,) [nat]."""
        return np.asarray(np.logaddexp.reduce(self._wealth, axis=1) - np.log(self._wealth.shape[1]))

    @property
    def log_mean_wealth(self) -> float:
        """Return the log of the mean wealth over all competitors [nat]."""
        return float(np.logaddexp.reduce(self.log_wealth) - np.log(max(1, len(self._wealth))))


class ReferenceDistribution:
    """Mean and standard deviation of the past gains of a competitor; outliers are clipped."""

    def __init__(self) -> None:
        """Create a distribution without gains."""
        self._count, self._mean, self._variance = 0, 0.0, 0.0

    def take_gain(self, gain: float) -> float:
        """Return the excess of a gain over the usual gain [nat], then add the gain to the past ones.

        The usual gain is the mean plus one standard deviation, at least 0. The first MIN_BLOCKS gains return 0. Upward
        outliers are clipped before they are added.
        """
        std = float(np.sqrt(self._variance))
        usual_gain = max(0.0, self._mean + std)
        self._count = min(self._count + 1, MEMORY)
        step = min(gain, self._mean + OUTLIER_LIMIT * std + MIN_LOSS_BOUND) - self._mean
        self._mean += step / self._count
        self._variance += ((1.0 - 1.0 / self._count) * step**2 - self._variance) / self._count
        return gain - usual_gain if self._count > MIN_BLOCKS else 0.0
