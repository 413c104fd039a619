"""Progress of long computations."""

from collections.abc import Callable
from typing import Self

Progress = Callable[[str, float], None]  # text of the current work, share of the work that is done

ROUND = 0.5  # share of the remaining bar that a round covers


class Screened(str):
    """Text of the current work, with the result of the last effect that was screened.

    Attributes:
        effect: id of the effect.
        error: RMS error of the fit with it, in torque [N m] or in the loop [rad].
    """

    effect: str
    error: float

    def __new__(cls, text: str, effect: str, error: float) -> Self:
        """Make the text."""
        screened = super().__new__(cls, text)
        screened.effect, screened.error = effect, error
        return screened


def no_progress(text: str, share: float) -> None:
    """Ignore the progress."""


def report_forward(progress: Progress) -> Progress:
    """Make a progress that only increases, for an unknown number of rounds, each reported from 0 to 1.

    A share below the previous share begins a new round, which covers `ROUND` of the remaining bar. A share of 1 reports
    1.
    """
    done, last_share = 0.0, 0.0

    def report(text: str, share: float) -> None:
        nonlocal done, last_share
        if share < last_share:
            done += ROUND * (1.0 - done) * last_share
        last_share = share
        progress(text, 1.0 if share >= 1.0 else done + ROUND * (1.0 - done) * share)

    return report
