"""A parameter is reported as changed only if its standard error, as few chunks tell it, excludes chance."""

import numpy as np

from estimators.online.change import ParameterChange, ParameterFit

CHUNK, THETA = 20, np.array([1.0, -0.5, 0.3, 2.0])


def rows_of(rng: np.random.Generator, chunks: int, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw rows of slow columns and errors, both correlated by 0.9 from row to row."""
    series = rng.normal(size=(chunks * CHUNK, len(theta) + 1))
    for k in range(1, len(series)):
        series[k] = 0.9 * series[k - 1] + np.sqrt(1 - 0.9**2) * series[k]
    return series[:, :-1], series[:, :-1] @ theta + series[:, -1]


def changed(rng: np.random.Generator, chunks: int, theta: np.ndarray) -> set[str]:
    """Return the parameters that differ significantly from known ones."""
    change = ParameterChange("abcd", ParameterFit(THETA, np.zeros((4, 4))), 0, None)
    change.compare(*rows_of(rng, chunks, theta), CHUNK)
    return set(change.changed)


def test_a_few_correlated_chunks_report_no_change_where_there_is_none():
    rng = np.random.default_rng(1)
    assert not any(changed(rng, 10, THETA) for _ in range(400))


def test_a_change_is_reported_from_more_chunks_than_parameters():
    rng = np.random.default_rng(2)
    moved = THETA + np.array([0.0, 0.0, 10.0, 0.0])
    assert changed(rng, 20, moved) == {"c"}
    assert not changed(rng, 4, moved)
