"""Numbers that set the resolution of the checks; limits of their decisions are fields of `Criterion`."""

from dataclasses import dataclass

from estimators.signals.channel import REACH


@dataclass(frozen=True)
class ChannelSettings:
    """Search for delays and lags of the torque channel."""

    zero: float = 1e-9  # delay that is fitted from zero [s]; a delay of exactly zero is not fitted
    starts: int = 1000  # delays per second, an even number in all: zero is not fitted; a search starts from the best
    min_equations: int = 3  # least number of equations for each column
    stribeck_shares: tuple[float, ...] = (0.02, 0.1, 0.5)  # Stribeck velocities of friction columns, of the highest
    torque_iterations: int = 3  # iterations of columns that depend on the fitted torque
    min_recordings: int = 4  # least number of recordings for a standard error from their scatter

    @property
    def candidates(self) -> float:
        """Number of delays of a first search; the best one gains the logarithm of this number by chance [nat]."""
        return 2 * REACH * self.starts


@dataclass(frozen=True)
class FeedbackSettings:
    """Test for feedback."""

    past: int = 6  # samples of torque and position that predict the next
    parts: int = 20  # number of parts of a recording; their scatter gives the error of a correlation
    outlier_limit: float = 4.0  # standard deviations beyond which an innovation is an event: a step, a stop, a glitch
    strides: tuple[int, ...] = (1, 2, 4, 8)  # samples in a step; a coarse encoder hides feedback within single samples


@dataclass(frozen=True)
class CheckSettings:
    """Numbers of all checks.

    Attributes:
        channel, feedback: settings of two checks.
        max_condition: largest condition number of the regressor of a compared recording.
        dependent: condition number of columns that are linearly dependent.
    """

    channel: ChannelSettings = ChannelSettings()
    feedback: FeedbackSettings = FeedbackSettings()
    max_condition: float = 1e4
    dependent: float = 1e5


CHECKS = CheckSettings()
