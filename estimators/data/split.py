"""Split of recordings into fitted and held-out data, as windows and segments."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.regression.least_squares import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.simulation.free_running import choose_segments
from estimators.weak_form.torque_windows import choose_half_width, cut_all, prepare
from estimators.weak_form.windows import Part
from pendulum_env._typing import Array
from pendulum_env.physics import Term, has_link
from pendulum_env.recording import Recording

HELD_OUT = 0.3  # share of each recording, at its end, that is held out if no recording is
MOTION = 0.5  # least share of the motion that is fitted, if the end of each recording is held out
REPEATED = 2  # least number of contacts with a stop: a single one may be an accident
SHORTEST = 0.25  # least factor on the lengths of windows, if longer windows are too few

Parts = tuple[RegressionData, RegressionData]  # fitted and held out


def split_arm(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Return fitted and held-out recordings of an arm: by default the last 30 % of each recording is held out."""
    if holdout:
        return list(recordings), list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def split_recordings(recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0) -> Parts:
    """Prepare fitted and held-out data; without held-out recordings, the end of each recording is held out.

    `shorter` is a factor on the lengths of the windows; it is reduced further if they are too few.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.has_torque or recording.known_inertia for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, only ratios of parameters are known: take `FitData.from_recordings`"
        )
    try:
        return _split_segments(recordings, holdout, shorter)
    except IdentificationError:
        if shorter <= SHORTEST:
            raise
        # more windows, each with more noise
        return split_recordings(recordings, holdout, Criterion.shorter_window * shorter)


def _split_segments(recordings: Sequence[Recording], holdout: Sequence[Recording], shorter: float) -> Parts:
    widths, checks = ([shorter * choose_half_width(r) for r in part] for part in (recordings, holdout))
    if holdout:
        return RegressionData.from_recordings(recordings, widths), RegressionData.from_recordings(holdout, checks)

    def split(share: float) -> Parts:
        return RegressionData.from_recordings(recordings, widths, (0.0, share)), RegressionData.from_recordings(
            recordings, widths, (share, 1.0)
        )

    motion = np.concatenate([w.centers / len(w.recording) for w in prepare(recordings, widths).windows])
    if np.mean(motion < 1 - HELD_OUT) >= MOTION:
        with suppress(IdentificationError):  # the end may be at rest
            return split(1 - HELD_OUT)
    return split(float(np.quantile(motion, 1 - HELD_OUT)))  # of the motion, not of the time


def with_contacts(data: Parts, terms: Sequence[Term], repeated: int = REPEATED) -> Parts:
    """Return training and held-out data with contacts with a stop, see `TorqueWindows.with_contacts`.

    Data with fewer contacts than `repeated` stay as they are, since a single one may be an accident, and so do data for
    a model with a link, which has impacts of its own. Parts of the same recordings are split again where less than half
    of the contacts are fitted, or none is held out: a stop is found in fitted data, and confirmed in held-out data.
    """
    if has_link(terms):
        return data
    fit = fit_terms(data[0], terms)[1]
    count = len(fit.theta)
    known = terms, fit.theta, fit.covariance[:count, :count], data[0].torque.base_inertia
    lows, highs = zip(*(part.data.free_range(*known) for part in data), strict=True)
    free = min(lows), max(highs)

    def add(part: RegressionData) -> RegressionData:
        return replace(part, data=part.data.with_contacts(*known, free))

    found = add(data[0]), add(data[1])
    counts = [part.data.contacts for part in found]
    is_uneven = counts[0] < MOTION * sum(counts) or counts[1] == 0
    if is_uneven and sum(counts) >= repeated and data[0].recordings == data[1].recordings:
        contacts, motion = (
            np.concatenate([own for part in parts for own in instants(part)])
            for parts, instants in (
                (found, lambda part: part.data.contact_instants),
                (data, lambda part: [w.centers / len(w.recording) for w in part.data.windows]),
            )
        )
        split = split_at_contacts(motion, contacts)
        if split is not None:
            found = add(_cut_again(data[0], split[0])), add(_cut_again(data[1], split[1]))
            counts = [part.data.contacts for part in found]
    return found if counts[0] >= 1 and sum(counts) >= repeated else data


def split_at_contacts(motion: Array, contacts: Array) -> tuple[Part, Part] | None:
    """Return the parts of recordings to fit and to hold out that both have contacts with a stop; None without any.

    At least half of the motion is fitted, and as nearly as possible 70 % of the contacts, before or after some instant.

    Instants of motion (R,) and of contacts (C,) are shares of a recording.
    """
    instants, count = np.sort(contacts), len(contacts)
    options: list[tuple[float, tuple[Part, Part]]] = []
    for k, share in enumerate(0.5 * (instants[1:] + instants[:-1]), 1):
        before, after = (0.0, float(share)), (float(share), 1.0)
        for n_fitted, moved, parts in (
            (k, np.mean(motion < share), (before, after)),
            (count - k, np.mean(motion >= share), (after, before)),
        ):
            if moved >= MOTION:
                options.append((abs(n_fitted / count - (1 - HELD_OUT)), parts))
    return min(options)[1] if options else None


def _cut_again(data: RegressionData, part: Part) -> RegressionData:
    """Return another part of the recordings in windows of the same length."""
    widths = [len(w.kernel) // 2 / w.recording.rate for w in data.data.windows]
    again = cut_all(data.recordings, widths, part)
    return RegressionData(again, tuple(choose_segments(w) for w in again.windows))
