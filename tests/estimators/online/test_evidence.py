"""Bets: what they win by chance is bounded whatever the gains look like, and what is there they find, also late."""

import numpy as np
import pytest

from estimators.online.evidence import MOST, SHARES, Bets, threshold_of

BLOCK = 0.2  # [s]


def first_alarms(gains: np.ndarray, threshold: float) -> np.ndarray:
    """Block of the first alarm (B,) on gains (T, B); T where there is none."""
    blocks, batch = gains.shape
    bets, first = Bets(batch, 1), np.full(batch, blocks)
    for k, gain in enumerate(gains):
        bets.take(gain[:, None], np.ones(batch, dtype=bool))
        first = np.where((bets.joint >= threshold) & (first == blocks), k, first)
    return first


@pytest.mark.parametrize("law", ["normal", "heavy", "skewed", "correlated scale"])
def test_a_fair_game_alarms_no_more_often_than_is_accepted(law):
    """Two hundred joints for 200 s each where an alarm in 100 s is accepted: at most as many first alarms, surely."""
    rng = np.random.default_rng(1)
    shape = 1000, 200
    if law == "normal":
        gains = rng.normal(size=shape)
    elif law == "heavy":
        gains = rng.standard_t(3, size=shape)
    elif law == "skewed":
        gains = 1.0 - rng.exponential(size=shape)
    else:
        gains = rng.normal(size=shape) * np.exp(np.cumsum(0.05 * rng.normal(size=shape), axis=0))
    first = first_alarms(gains, threshold_of(36.0, BLOCK))
    assert np.minimum(first, 500).mean() >= 0.8 * 250  # E[T] >= 500, of which half the length is seen at least


def test_what_gains_is_found_and_what_sets_in_later_as_soon():
    rng = np.random.default_rng(2)
    gains = rng.normal(size=(400, 50)) - 0.3
    gains[200:] += 4.0
    first = first_alarms(gains, threshold_of(1.0, BLOCK))
    assert (first >= 200).all() and (first < 225).all()


def test_no_single_block_decides():
    bets = Bets(1, 1)
    bets.take(np.full((1, 1), 1e9), np.ones(1, dtype=bool))
    assert bets.joint[0] <= np.log1p(MOST * SHARES.max()) < threshold_of(1.0, BLOCK)


def test_wealth_is_what_the_game_says():
    """M <- (M + 1) (1 + s g / c), with c = 1 as long as nothing was lost."""
    bets, wealth = Bets(1, 1), np.zeros(len(SHARES))
    for gain in (0.5, 2.0, 1.0):
        bets.take(np.full((1, 1), gain), np.ones(1, dtype=bool))
        wealth = (wealth + 1.0) * (1.0 + SHARES * gain)
    assert bets.evidence[0, 0] == pytest.approx(np.log(wealth.mean()))
    bets.take(np.full((1, 1), 5.0), np.zeros(1, dtype=bool))  # not due
    assert bets.joint[0] == pytest.approx(np.log(wealth.mean()))
    bets.reset(np.ones(1, dtype=bool))
    assert bets.joint[0] == -np.inf


def test_a_rate_that_cannot_be_is_refused():
    for rate in (0.0, 1e5):
        with pytest.raises(ValueError, match="alarms_per_hour"):
            threshold_of(rate, BLOCK)
