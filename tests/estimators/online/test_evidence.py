"""What e_process win by chance is bounded whatever the gains look like, and what is there is found, also late."""

import numpy as np
import pytest

from estimators.online.evidence import STAKES, EProcess, ReferenceDistribution, compute_threshold
from estimators.online.settings import ONLINE

CHUNK = ONLINE.bins.chunk_time  # [s]


def first_alarms(gains: np.ndarray, threshold: float) -> np.ndarray:
    """Block of the first alarm on each of K challengers, on gains (T, K); T where there is none."""
    chunks, count = gains.shape
    e_process, first = EProcess(count), np.full(count, chunks)
    for k, gain in enumerate(gains):
        e_process.take(gain)
        first = np.where((e_process.log_wealth >= threshold) & (first == chunks), k, first)
    return first


SHAPE = 1000, 200
FAIR = {
    "normal": lambda rng: rng.normal(size=SHAPE),
    "heavy": lambda rng: rng.standard_t(3, size=SHAPE),
    "skewed": lambda rng: 1.0 - rng.exponential(size=SHAPE),
    "correlated": lambda rng: rng.normal(size=SHAPE) * np.exp(np.cumsum(0.05 * rng.normal(size=SHAPE), axis=0)),
}


@pytest.mark.parametrize("law", FAIR)
def test_a_fair_game_alarms_no_more_often_than_is_accepted(law):
    """Two hundred joints for 200 s each where an alarm in 100 s is accepted: at most as many first alarms, surely."""
    first = first_alarms(FAIR[law](np.random.default_rng(1)), compute_threshold(36.0, CHUNK))
    assert np.minimum(first, 500).mean() >= 0.8 * 250  # E[T] >= 500, of which half the length is seen at least


def test_what_gains_is_found_and_what_sets_in_later_as_soon():
    rng = np.random.default_rng(2)
    gains = rng.normal(size=(400, 50)) - 0.3
    gains[200:] += 4.0
    first = first_alarms(gains, compute_threshold(1.0, CHUNK))
    assert (first >= 200).all() and (first < 230).all()


def test_no_single_chunk_decides():
    e_process = EProcess(1)
    e_process.take(np.full(1, 1e9))
    assert e_process.log_mean_wealth <= np.log1p(ONLINE.evidence.most * STAKES.max()) < compute_threshold(1.0, CHUNK)


def test_a_gain_that_an_incomplete_model_always_leaves_is_no_evidence_and_a_larger_one_is():
    """With forgetting a model gains in each chunk, a little at first and then much."""
    rng, e_process, usual = np.random.default_rng(3), EProcess(1), ReferenceDistribution()
    gains = 5.0 + 3.0 * rng.normal(size=600)
    gains[500:] += 40.0
    evidence = []
    for gain in gains:
        e_process.take(np.array([usual.take_gain(gain)]))
        evidence.append(e_process.log_mean_wealth)
    assert max(evidence[:500]) < compute_threshold(1.0, CHUNK) < max(evidence[500:530])
