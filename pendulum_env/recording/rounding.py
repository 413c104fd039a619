"""Rounding of a column: by a constant step, or to significant digits, as `%g` and MATLAB write it.

The step of significant digits grows with the value.
"""

import numpy as np

from pendulum_env._typing import Array

FEWEST_DIGITS, MOST_DIGITS = 4, 9  # of columns that count as rounded; more are those of single or double precision
OFF_GRID = 1e-3  # least difference of two changes that is no rounding error, share of the least change
LARGE = 20  # number of the largest values, which may end in zeros by chance


def list_changes(values: Array) -> Array:
    """List the sizes of the changes from value to value (N,) above 1e-12."""
    changes = np.abs(np.diff(values))
    return np.asarray(changes[changes > 1e-12])


def find_least_change(values: Array) -> float:
    """Return the least change from value to value (N,) above 1e-12, the step of a rounded column; 0 without one.

    A joint that never stands still may turn by many steps in a sample. If no value repeats the last one and the changes
    differ, the step is the least difference of two changes, if nine tenths of them are multiples of it; else 0.
    """
    changes = list_changes(values)
    if not len(changes):
        return 0.0
    least, most = float(changes.min()), float(changes.max())
    if len(changes) < len(values) - 1 or most - least <= OFF_GRID * least:
        return least
    differences = np.diff(np.unique(changes))
    step = float(differences.min(where=differences > OFF_GRID * least, initial=most - least))
    multiples = changes / step
    return step if np.mean(np.abs(multiples - np.rint(multiples)) < 0.1) > 0.9 else 0.0


def count_significant_digits(values: Array) -> int | None:
    """Return the number of significant digits to which values (N,) are rounded; None for a constant step, or none.

    The step is constant if large values have as many decimals as the others.
    """
    sizes = np.abs(values[np.isfinite(values) & (values != 0)])
    if not len(sizes):
        return None
    exponents = np.floor(np.log10(sizes)).astype(int)
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        if _is_whole(sizes * 10.0 ** (digits - 1 - exponents)):
            largest = np.sort(exponents)[-LARGE:][0]
            return None if _is_whole(sizes * 10.0 ** (digits - 1 - largest)) else digits
    return None


def compute_steps(values: Array, digits: int) -> Array:
    """Return the step of rounding to significant digits of each value (N,)."""
    sizes = np.maximum(np.abs(values), np.abs(values[values != 0]).min(initial=1.0))
    return np.asarray(10.0 ** (np.floor(np.log10(sizes)) + 1 - digits))


def _is_whole(multiples: Array) -> bool:
    return bool(np.all(np.abs(multiples - np.rint(multiples)) <= 1e-5))
