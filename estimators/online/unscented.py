"""filterpy's unscented Kalman filter with all sigma points stepped, and compared, at once.

A module of its own, as it loads filterpy, and with it scipy.stats, for which those who do not ask for it need not wait.
"""

from collections.abc import Callable
from typing import Any

from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from pendulum_env._typing import Array


class Unscented(UnscentedKalmanFilter):  # type: ignore[misc]  # filterpy ships no types
    """State of `size` numbers of which the first is measured; `forward` moves sigma points (K, size) on by a period."""

    def __init__(self, size: int, period: float, forward: Callable[..., Array]) -> None:
        """Take the size, the time between samples [s], and what moves sigma points on."""
        points = MerweScaledSigmaPoints(size, alpha=1.0, beta=0.0, kappa=0.0)  # equal weights, none for the mean
        super().__init__(size, 1, period, _measured, forward, points)

    def compute_process_sigmas(self, dt: float, fx: Any = None, **arguments: Any) -> None:
        """Move all sigma points on."""
        self.sigmas_f = self.fx(self.points_fn.sigma_points(self.x, self.P), **arguments)

    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
        """Covariance of state and measurement (size, 1)."""
        return (self.Wc[:, None] * (sigmas_f - x)).T @ (sigmas_h - z)


def _measured(state: Array) -> Array:
    return state[:1]
