"""Progress of long computations."""

from collections.abc import Callable

Progress = Callable[[str, float], None]  # text of the current work, share of the work that is done

ROUND = 0.5  # share of the remaining bar that a round covers


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
