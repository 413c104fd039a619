"""Progress of long computations."""

from collections.abc import Callable

Progress = Callable[[str, float], None]  # what is being done, share of the work that is done

ROUND = 0.5  # of what is left, that one round of a loop of unknown length covers


def no_progress(what: str, share: float) -> None:
    """Show nothing."""


def forward(progress: Progress) -> Progress:
    """Make progress monotonic for an unknown number of rounds, each reported from 0 to 1.

    Each round is given a part of what is left, so that the bar always moves on and ends only when the work does.
    """
    begun, within = 0.0, 0.0

    def onward(what: str, share: float) -> None:
        nonlocal begun, within
        if share < within:
            begun += ROUND * (1.0 - begun) * within
        within = share
        progress(what, 1.0 if share >= 1.0 else begun + ROUND * (1.0 - begun) * share)

    return onward
