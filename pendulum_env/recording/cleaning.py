"""Rows that a logger spoilt: empty cells, repeated stamps, glitches of one sample and values that are out of date.

Values (N,) are in SI units, by quantity; rows hold the number of each in the file, from 1, header not counted.
"""

from collections.abc import Callable

import numpy as np

from pendulum_env._typing import Array, Index
from pendulum_env.recording.record import RecordingError
from pendulum_env.words import listing

Rows = range | Index  # number of each sample's row in the file
OPTIONAL = ("velocity", "reference", "supply", "enabled")  # quantities that a recording can do without
HELD = ("torque", "enabled")  # quantities that stay until they are told anew
NAMED = 5  # places, as many as a note names
BLOCK = 1 << 18  # samples looked at at a time
MARGIN = 64  # samples that blocks share
SAMPLE = 100_000  # deviations that tell what is usual
FAR = 10.0  # times what the neighbours and the rest of the recording show, from which a sample is a glitch
PAUSE = 1.0  # [s] between runs whose clocks all begin anew
MOVING = 3.0  # times the usual deviation from steady motion that a step has, if the joint is sure to move
SAME = 1e-6  # of the usual step of time, up to which it stands still
ALIKE = 0.25  # of a step, up to which others are the same motion


def aligned(values: dict[str, Array], fewest: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Take what stands in rows of its own at the rows of position, as programs merge topics; returns values and notes.

    Torque is taken as it was last, for it is held; other quantities by interpolation. Fewer rows than `fewest` with a
    position are none to take anything at: `finite` says so.
    """
    here = np.isfinite(values["position"])
    if np.count_nonzero(here) < fewest:
        return values, ()
    notes = []
    for quantity in values.keys() - {"time", "position", "segment"}:
        sound = np.isfinite(values[quantity]) & np.isfinite(values["time"])
        if here.all() or np.count_nonzero(sound & here) > 0.5 * min(np.count_nonzero(here), np.count_nonzero(sound)):
            continue
        if quantity in HELD:
            last = np.maximum.accumulate(np.where(sound, np.arange(len(sound)), -1))
            values[quantity] = np.where(last >= 0, values[quantity][last], np.nan)
        elif sound.any():
            values[quantity] = np.interp(values["time"], values["time"][sound], values[quantity][sound])
        how = "as it was last" if quantity in HELD else "by interpolation"
        notes.append(f"{quantity} stands in other rows than position: taken {how}")
    if not notes:
        return values, ()
    return {quantity: column[here] for quantity, column in values.items()}, tuple(sorted(notes))


def finite(values: dict[str, Array], fewest: int) -> tuple[dict[str, Array], Rows, tuple[str, ...]]:
    """Leave out rows with empty cells, NaN or infinity; returns values, rows and notes.

    An optional column that lacks more than half of its cells is left out instead.

    Raises:
        RecordingError: if fewer rows than `fewest` are left.
    """
    count = len(values["time"])
    good, notes, kept = np.ones(count, dtype=np.bool_), [], {}
    for quantity, column in values.items():
        sound = np.isfinite(column)
        if sound.all():
            kept[quantity] = column
            continue
        missing = count - int(np.count_nonzero(sound))
        first = int(np.argmin(sound))
        came = "empty or NaN" if np.isnan(column[first]) else "infinite"
        if quantity in OPTIONAL and missing > count / 2:
            notes.append(f"{quantity} is left out: it is {came} in {missing} of {count} rows")
            continue
        if count - missing < min(fewest, count / 2):
            raise RecordingError(
                f"data row {first + 1} (header not counted) has {quantity} that is {came}, as have "
                f"{missing} of {count} rows: check how that column was written"
            )
        kept[quantity] = column
        good &= sound
        notes.append(f"{quantity} is {came} in {rows_of(np.flatnonzero(~sound) + 1)}: left out")
    if good.all():
        return kept, range(1, count + 1), tuple(notes)
    if np.count_nonzero(good) < fewest:
        raise RecordingError(
            f"fewer than {fewest} rows have all of time, position and torque: write them in the same rows"
        )
    return {quantity: column[good] for quantity, column in kept.items()}, np.flatnonzero(good) + 1, tuple(notes)


def followed_on(values: dict[str, Array]) -> dict[str, Array]:
    """Let time go on where a column `segment` counts another run and the clock was set back; a second lies between."""
    if "segment" not in values:
        return values
    time = values["time"]
    steps = np.diff(time)
    back = (np.diff(values["segment"]) != 0) & (steps <= 0)
    return values | {"time": time + np.append(0.0, np.cumsum(np.where(back, PAUSE - steps, 0.0)))}


def runs(segment: Array | None) -> tuple[int, ...]:
    """Where another run begins, as a column `segment` (N,) counts them."""
    return (0,) if segment is None else (0, *(np.flatnonzero(np.diff(segment)) + 1).tolist())


def ordered(values: dict[str, Array], rows: Rows) -> tuple[dict[str, Array], Rows, tuple[str, ...]]:
    """Leave out rows whose time repeats that of the row before; returns values, rows and notes.

    Raises:
        RecordingError: if time runs backwards.
    """
    time = values["time"]
    steps = np.diff(time)
    if steps.min() < 0:
        first = int(np.argmax(steps < 0))
        raise RecordingError(
            f"time falls from {time[first]:.9g} to {time[first + 1]:.9g} s at data row {rows[first + 1]} "
            "(header not counted): sort the rows, or name a column segment that counts the runs"
        )
    new = np.append(True, steps > SAME * np.median(steps))
    if new.all():
        return values, rows, ()
    if np.count_nonzero(new) < 2:
        raise RecordingError(f"time is {time[0]:.9g} s in every row: write it with more decimals")
    note = f"time repeats that of the row before in {rows_of(np.asarray(rows)[~new])}: left out"
    return {quantity: column[new] for quantity, column in values.items()}, np.asarray(rows)[new], (note,)


def sound(values: dict[str, Array], rows: Rows, position: Array) -> tuple[dict[str, Array], Rows, tuple[str, ...]]:
    """Leave out rows whose position (N,) cannot be, unwrapped if need be; returns values, rows and notes.

    Glitches lie far off both neighbours: no joint is there and back within two samples. Stale values repeat the last
    one, and are followed by a jump to where steady motion would have gone meanwhile.
    """
    usual = usual_bend(position)
    spoilt = {
        "jumps for one sample": _places(position, lambda q: _glitches(q, usual)),
        "stays behind while the joint moves on": _places(position, lambda q: _stale(q, usual)),
    }
    notes = [f"position {what} in {rows_of(np.asarray(rows)[at])}: left out" for what, at in spoilt.items() if len(at)]
    if not notes:
        return values, rows, ()
    good = np.ones(len(position), dtype=np.bool_)
    good[np.concatenate(list(spoilt.values()))] = False
    return {quantity: column[good] for quantity, column in values.items()}, np.asarray(rows)[good], tuple(notes)


def rows_of(rows: Index) -> str:
    """`data row 12`, or `3 data rows (12, 14 and 20)`."""
    if len(rows) == 1:
        return f"data row {rows[0]}"
    named = [str(row) for row in rows[:NAMED]]
    return f"{len(rows)} data rows ({listing([*named, f'{len(rows) - NAMED} more'] if len(rows) > NAMED else named)})"


def smallest_step(position: Array) -> float:
    """Smallest change [rad] of position (N,) from one sample to the next that is no standstill; 0 if there is none."""
    smallest = np.inf
    for start in range(0, len(position) - 1, BLOCK):
        moves = np.abs(np.diff(position[start : start + BLOCK + 1]))
        smallest = min(smallest, float(moves.min(initial=np.inf, where=moves > 0)))
    return smallest if np.isfinite(smallest) else 0.0


def usual_bend(position: Array) -> float:
    """How far samples of position (N,) lie off the middle of their neighbours [rad]: all but one in a hundred.

    Of a joint that rests all but always, the smallest step that its encoder makes.
    """
    if len(position) < 3:
        return 0.0
    stride = max(1, (len(position) - 2) // SAMPLE)
    middle = np.arange(1, len(position) - 1, stride)
    off = np.abs(position[middle] - 0.5 * (position[middle - 1] + position[middle + 1]))
    return float(np.quantile(off, 0.99)) or smallest_step(position)


def _places(position: Array, find: Callable[[Array], Index]) -> Index:
    """Where `find` says so, block by block to bound memory."""
    found = [np.empty(0, dtype=np.intp)]
    for start in range(0, len(position), BLOCK):
        low = max(start - MARGIN, 0)
        places = low + find(position[low : start + BLOCK + MARGIN])
        found.append(places[(places >= start) & (places < start + BLOCK)])
    return np.concatenate(found)


def _glitches(q: Array, usual: float) -> Index:
    """Samples of q (N,) that are far off the middle of their neighbours, which agree with each other."""
    if len(q) < 5:
        return np.empty(0, dtype=np.intp)
    off = np.abs(q[2:-2] - 0.5 * (q[1:-3] + q[3:-1]))
    far = np.flatnonzero(off > FAR * usual)
    around = np.abs(np.diff(np.stack([q[far], q[far + 1], q[far + 3], q[far + 4]]), axis=0)).max(axis=0)  # without it
    return far[off[far] > FAR * around] + 2


def _stale(q: Array, usual: float) -> Index:
    """Samples of q (N,) that repeat the last one although the joint moves on, by steps far above the usual noise."""
    steps = np.diff(q)
    still = steps == 0
    turns = np.flatnonzero(np.diff(still, prepend=False, append=False))
    first, end = turns[::2], turns[1::2]  # steps of runs without motion
    inner = (first > 0) & (end < len(steps) - 1)
    first, end = first[inner], end[inner]
    before, jump, after = steps[first - 1], steps[end], steps[end + 1]
    steady = 0.5 * (before + after)
    stale = (np.abs(steady) >= MOVING * usual) & (np.abs(before - after) <= 2 * ALIKE * np.abs(steady))
    stale &= np.abs(jump / (end - first + 1) - steady) <= ALIKE * np.abs(steady)
    runs = [np.arange(a + 1, b + 1) for a, b in zip(first[stale], end[stale], strict=True)]
    return np.concatenate([np.empty(0, dtype=np.intp), *runs])
