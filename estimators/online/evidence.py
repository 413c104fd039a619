"""Evidence for effects and changes by an e-process, and the threshold of an alarm.

Each chunk of time gives a factor e = 1 + s g / c, with the stake s, the gain g of the chunk, and a bound c of losses.
While the model holds, the conditional mean of e is at most one, for any distribution of gains with losses below c. The
mean over several stakes has the same property. The factors multiply to wealth M, which restarts from one if it is
below. A later change is therefore detected as fast,

    M <- max(M, 1) e.

The mean time until M, or its mean over competitors, reaches A is at least A chunks. The threshold follows from the
accepted alarms per hour.

The bound c is unknown: 1.5 times the largest loss so far is used, and a larger loss is clipped to c in its chunk. The
threshold is therefore approximate.

No model of a real machine is complete, so a model with forgetting always predicts slightly better. Only its gain above
the usual gain counts (`ReferenceDistribution`).

Source: Lorden, Annals of Mathematical Statistics 42(6), 1971, for the restarts; Shafer and Vovk, Game-Theoretic
Foundations for Probability and Finance, 2019; Shin, Ramdas and Rinaldo, E-detectors, New England Journal of Statistics
in Data Science, 2023; Choe and Ramdas, Comparing sequential forecasters, Operations Research, 2023.
"""

import numpy as np

from estimators.online.settings import ONLINE
from pendulum_env._typing import Array

HOUR = 3600.0  # [s]
STAKES = np.array(ONLINE.evidence.stakes)


def compute_threshold(alarms_per_hour: float, chunk: float) -> float:
    """Compute the log wealth of an alarm [nat] for a duration of chunks [s]."""
    most = HOUR / chunk
    if not 0 < alarms_per_hour < most:
        raise ValueError(
            f"alarms_per_hour is {alarms_per_hour:g}: give a positive number below {most:g}, one per {chunk:g} s"
        )
    return float(np.log(most / alarms_per_hour))


class EProcess:
    """Wealth of K competitors, each with several stakes."""

    def __init__(self, competitors: int) -> None:
        """Create an e-process for a number K of competitors."""
        self._wealth = np.zeros((competitors, len(STAKES)))  # log M
        self._bound = np.full(competitors, ONLINE.evidence.least_bound)

    def take(self, gain: Array) -> None:
        """Multiply the wealth of each competitor by the factor of a chunk with gains (K,) [nat].

        Losses are clipped to the bound c, gains to a multiple of it. A larger loss raises the bound for later chunks.
        """
        relative_gain = np.clip(gain / self._bound, -1.0, ONLINE.evidence.most)
        self._wealth = np.maximum(self._wealth, 0.0) + np.log1p(STAKES * relative_gain[:, None])
        self._bound = np.maximum(self._bound, -ONLINE.evidence.margin * gain)

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

        The usual gain is the mean plus one standard deviation, at least 0. The first gains return 0. Upward outliers
        are clipped before they are added.
        """
        std = float(np.sqrt(self._variance))
        usual_gain = max(0.0, self._mean + std)
        self._count = min(self._count + 1, ONLINE.evidence.memory)
        step = min(gain, self._mean + ONLINE.evidence.outlier * std + ONLINE.evidence.least_bound) - self._mean
        self._mean += step / self._count
        self._variance += ((1.0 - 1.0 / self._count) * step**2 - self._variance) / self._count
        return gain - usual_gain if self._count > ONLINE.evidence.first else 0.0
