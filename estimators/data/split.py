"""Split of recordings into fitted and held-out data, as windows and segments."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.settings import DATA
from estimators.decisions.criterion import Criterion
from estimators.decisions.score import HELD_OUT
from estimators.regression.least_squares import IdentificationError
from estimators.simulation.free_running import choose_segments
from estimators.weak_form.contacts import ContactTest, count_contacts, list_contact_instants
from estimators.weak_form.preparation import choose_half_width, prepare_windows
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.windows import Part
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Term, has_link
from pendulum_env.recording import Recording

Parts = tuple[RegressionData, RegressionData]  # fitted and held out


@dataclass(frozen=True)
class CutSettings:
    """How recordings of a pendulum are cut into windows and segments.

    Attributes:
        window_share: factor on the window lengths chosen by noise.
        base: terms of the base model, with known values, whose inertia scales encoder noise.
        inertia: known inertia, which scales encoder noise [kg m^2]; None if the base model gives it.
        contact_terms: terms of the residual that showed contacts with a stop; None without contacts.
        horizon: length of the segments for simulation [s]; None for the default.
    """

    window_share: float = 1.0
    base: tuple[Term, ...] = BASE
    inertia: float | None = None
    contact_terms: tuple[Term, ...] | None = None
    horizon: float | None = None

    def make_parts(
        self, recordings: Sequence[Recording], holdout: Sequence[Recording], criterion: Criterion = Criterion()
    ) -> Parts:
        """Return fitted and held-out data; raises errors of `split_recordings`."""
        fitted, held_out = split_recordings(recordings, holdout, self.window_share, self.inertia, criterion)
        parts = replace(fitted, base=self.base), replace(held_out, base=self.base)
        parts = parts if self.contact_terms is None else add_contacts(parts, self.contact_terms)
        if self.horizon is None:
            return parts
        return parts[0].with_horizon(self.horizon), parts[1].with_horizon(self.horizon)


def split_arm(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Return fitted and held-out recordings with links; without `holdout`, the last 30 % of each is held out."""
    if holdout:
        return list(recordings), list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def split_recordings(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording] = (),
    shorter: float = 1.0,
    inertia: float | None = None,
    criterion: Criterion = Criterion(),
) -> Parts:
    """Return fitted and held-out data of a pendulum; without `holdout`, the end of each recording is held out.

    `shorter` is a factor on the window lengths chosen by noise. While windows are too few, it is multiplied by
    `criterion.shorter_window`, down to about `DATA.shortest`. A known `inertia` [kg m^2] scales encoder noise.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.has_torque or recording.known_inertia for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, only ratios of parameters are known: take `FitData.from_recordings`"
        )
    try:
        return _split_into_parts(recordings, holdout, shorter, inertia, criterion.block)
    except IdentificationError:
        if shorter <= DATA.shortest:
            raise
        return split_recordings(recordings, holdout, criterion.shorter_window * shorter, inertia, criterion)


def _split_into_parts(
    recordings: Sequence[Recording], holdout: Sequence[Recording], shorter: float, inertia: float | None, block: float
) -> Parts:
    """Return fitted and held-out data; `shorter` scales the chosen window lengths.

    Without `holdout`, the last 30 % of each recording is held out. The fitted part may hold less than half of the
    window centres, or few of one direction, or a part too little motion. The split is then at the share of time before
    which 70 % of all centres lie, earlier if the rest would be too few, later if the fitted part lacks a direction.
    """
    cut = partial(RegressionData.from_recordings, inertia=inertia, block=block)
    widths, holdout_widths = ([shorter * choose_half_width(r, inertia) for r in part] for part in (recordings, holdout))
    if holdout:
        return cut(recordings, widths), cut(holdout, holdout_widths)

    def split(share: float) -> Parts:
        return cut(recordings, widths, (0.0, share)), cut(recordings, widths, (share, 1.0))

    windows, fewest = prepare_windows(recordings, widths).windows, RESOLUTION.fewest
    shares = np.concatenate([w.centers / len(w.recording) for w in windows])
    is_forward = np.concatenate([w.samples.velocity[w.centers] > 0 for w in windows])
    sides = [np.sort(side) for side in (shares[is_forward], shares[~is_forward]) if len(side) >= 2 * fewest]
    least = max((float(side[fewest]) for side in sides), default=0.0)
    if least < 1 - HELD_OUT and np.mean(shares < 1 - HELD_OUT) >= DATA.motion:
        with suppress(IdentificationError):
            return split(1 - HELD_OUT)
    held_out = max(HELD_OUT, min(1 - DATA.motion, (fewest + 1) / len(shares)))
    return split(max(least, float(np.quantile(shares, 1 - held_out))))


def add_contacts(data: Parts, terms: Sequence[Term]) -> Parts:
    """Return fitted and held-out data with contacts with a stop, see `ContactTest`.

    The same `data` are returned with fewer than `DATA.repeated` contacts, which may be accidents, and for terms with a
    link, which has impacts. A stop is found in fitted data, and confirmed in held-out data. If less than half of the
    contacts are fitted or none is held out, the same recordings are therefore split again by `split_at_contacts`.
    """
    if has_link(terms):
        return data
    find_contacts = make_contact_finder(data, terms)
    with_windows = find_contacts(data[0]), find_contacts(data[1])
    counts = [count_contacts(part.data) for part in with_windows]
    is_uneven = counts[0] < DATA.motion * sum(counts) or counts[1] == 0
    if is_uneven and sum(counts) >= DATA.repeated and data[0].recordings == data[1].recordings:
        contacts = np.concatenate([instants for part in with_windows for instants in list_contact_instants(part.data)])
        motion = np.concatenate([w.centers / len(w.recording) for part in data for w in part.data.windows])
        split = split_at_contacts(motion, contacts)
        if split is not None:
            with_windows = find_contacts(_cut_again(data[0], split[0])), find_contacts(_cut_again(data[1], split[1]))
            counts = [count_contacts(part.data) for part in with_windows]
    return with_windows if counts[0] >= 1 and sum(counts) >= DATA.repeated else data


def make_contact_finder(data: Parts, terms: Sequence[Term]) -> Callable[[RegressionData], RegressionData]:
    """Return a function that adds windows in contact with a stop to data, by a fit of terms without a link."""
    fit = fit_terms(data[0], terms)[1]
    count = len(fit.theta)
    test = ContactTest(terms, fit.theta, fit.covariance[:count, :count], data[0].data.base_inertia)
    lows, highs = zip(*(test.find_free_range(part.data) for part in data), strict=True)
    free = min(lows), max(highs)
    return lambda part: replace(part, data=test.add_contacts(part.data, free))


def split_at_contacts(motion: Array, contacts: Array) -> tuple[Part, Part] | None:
    """Return the parts of recordings to fit and to hold out, before and after an instant or reverse, or None.

    Both have contacts. The fitted part has at least half of the motion, and a share of contacts closest to 70 %.
    `motion` (R,) and `contacts` (C,) are instants, as shares of a recording.
    """
    instants, count = np.sort(contacts), len(contacts)
    options: list[tuple[float, tuple[Part, Part]]] = []
    for k, share in enumerate(0.5 * (instants[1:] + instants[:-1]), 1):
        before, after = (0.0, float(share)), (float(share), 1.0)
        for n_fitted, motion_share, parts in (
            (k, np.mean(motion < share), (before, after)),
            (count - k, np.mean(motion >= share), (after, before)),
        ):
            if motion_share >= DATA.motion:
                options.append((abs(n_fitted / count - (1 - HELD_OUT)), parts))
    return min(options)[1] if options else None


def _cut_again(data: RegressionData, part: Part) -> RegressionData:
    """Return data of another part of the recordings, with windows of the same lengths."""
    widths = [w.half_width for w in data.data.windows]
    windows = prepare_windows(
        data.recordings, widths, part, fewest=0, inertia=data.data.windows[0].inertia, block=data.data.block
    )
    return replace(data, data=windows, segments=tuple(choose_segments(w) for w in windows.windows))
