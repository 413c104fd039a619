"""Find the sample time of a log, and the places of its lost rows, from time stamps that jitter."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pendulum_env._typing import Array, Index

FIRST_BLOCK = 64  # stamps in the shortest blocks whose power determines the period
FIRST_CYCLES = 1.5  # half range of the search in these blocks [cycles], 2 % of the period

Parts = Sequence[tuple[int, int]]  # first and end of the stamps of each part with its own clock


def find_period(stamps: Array, period: float, parts: Parts) -> float:
    """Find the period [s] with the largest power of exp(2 pi i t / period) over stamps (M,), whatever rows are lost.

    The power is the sum over blocks of stamps. Blocks grow, and the range of the search about `period` [s] shrinks.
    """
    seconds = np.concatenate([stamps[a:b] - stamps[a] for a, b in parts])  # from the start of each part
    starts = np.cumsum([0, *(b - a for a, b in parts)])
    step, rate, longest = float(np.median(np.diff(stamps))), 1.0 / period, max(b - a for a, b in parts)
    length, cycles = float(FIRST_BLOCK), FIRST_CYCLES
    while True:
        blocks = np.concatenate([a + np.arange(0, b - a, round(length)) for a, b in pairwise(starts.tolist())])
        rates = rate + np.arange(-cycles, cycles + 0.1, 0.25) / (min(length, longest) * step)
        sums = [np.add.reduceat(np.exp(2j * np.pi * frequency * seconds), blocks) for frequency in rates]
        rate = float(rates[np.argmax([np.sum(np.abs(each) ** 2) for each in sums])])
        if length >= longest:
            return 1.0 / rate
        length, cycles = 4.0 * length, 0.75


class MotionEvidence(NamedTuple):
    """Motion of J joints in steps between rows, relative to the mean size of its errors.

    Attributes:
        usual: median motion of the neighbouring steps (J, N).
        excess: motion beyond it (J, N).
    """

    usual: Array
    excess: Array

    def compute_cost(self, steps: slice, n_lost: int) -> Array:
        """Compute the change of the negative log-likelihood by lost periods in some of the steps."""
        usual, excess = self.usual[:, steps], self.excess[:, steps]
        return np.sum(np.log1p((excess - n_lost * usual) ** 2) - np.log1p(excess**2), axis=0)


class LevelPath(NamedTuple):
    """Best paths that end at a level, for consecutive rows.

    Attributes:
        level: number of lost periods.
        begin: first row.
        cost: negative log-likelihood up to each row (K,).
        start: index of the row at which the best path to each row reaches this level (K,).
        source: number of the earlier level of a path that reaches this level at each row (K,), -1 for none.
    """

    level: int
    begin: int
    cost: Array
    start: Index
    source: Index


def find_levels(deviation: Array, last: Index, unit: float, motion: MotionEvidence) -> Index:
    """Find the number of periods lost before each of N rows, of maximum likelihood, by dynamic programming.

    Args:
        deviation: deviation of the stamps (M,) from the clock without losses, in standard deviations.
        last: last row of each stamp (M,).
        unit: a period in standard deviations.
        motion: motion in the N - 1 steps between rows.
    """
    n_rows = int(last[-1]) + 1
    nearest = np.round(deviation / unit).astype(np.intp)
    levels, place = np.unique(nearest, return_inverse=True)
    if len(levels) == 1:
        return np.full(n_rows, levels[0])
    error, is_burst = np.full(n_rows, np.nan), np.zeros(n_rows, dtype=bool)
    error[last], is_burst[last] = deviation, np.median(np.diff(last)) > 1  # the last row of a burst may be lost
    first, final = np.full(len(levels), len(last)), np.zeros(len(levels), dtype=np.intp)
    np.minimum.at(first, place, np.arange(len(last)))
    np.maximum.at(final, place, np.arange(len(last)))
    begins = np.append(0, last)[np.minimum.accumulate(first[::-1])[::-1]]
    stops = last[np.minimum(np.maximum.accumulate(final) + 1, len(last) - 1)] + 1
    paths: list[LevelPath] = []
    for level, begin, stop in zip(levels.tolist(), begins.tolist(), stops.tolist(), strict=True):
        level_costs = 0.5 * np.nan_to_num(error[begin:stop] - level * unit) ** 2
        total = np.cumsum(level_costs)
        entry, source = np.full(stop - begin, np.inf), np.full(stop - begin, -1)
        entry[0] = level_costs[0] if begin == 0 else np.inf
        for number, path in enumerate(paths[-3:], max(0, len(paths) - 3)):
            a, b = max(begin, path.begin), min(stop - 1, path.begin + len(path.cost))
            if a >= b:
                continue
            previous_costs = 0.5 * np.nan_to_num(error[a:b] - path.level * unit) ** 2
            gain = np.where(is_burst[a:b], np.minimum(level_costs[a - begin : b - begin] - previous_costs, 0.0), 0.0)
            cost = path.cost[a - path.begin : b - path.begin] + gain
            cost += motion.compute_cost(slice(a, b), level - path.level) + np.log(len(last))
            cost += level_costs[a + 1 - begin : b + 1 - begin]
            window = slice(a + 1 - begin, b + 1 - begin)
            source[window] = np.where(cost < entry[window], number, source[window])
            entry[window] = np.minimum(cost, entry[window])
        relative = entry - total
        best = np.minimum.accumulate(relative)
        is_new = relative <= best
        start = np.maximum.accumulate(np.where(is_new, np.arange(stop - begin), 0))
        paths.append(LevelPath(level, begin, best + total, start, source))
    row_levels = np.empty(n_rows, dtype=np.intp)
    open_paths = [k for k, path in enumerate(paths) if path.begin + len(path.cost) == n_rows]
    number, row = min(open_paths, key=lambda k: paths[k].cost[-1]), n_rows - 1
    while True:
        path = paths[number]
        start = path.start[row - path.begin]
        row_levels[path.begin + start : row + 1] = path.level
        number, row = int(path.source[start]), path.begin + int(start) - 1
        if number < 0:
            return row_levels
