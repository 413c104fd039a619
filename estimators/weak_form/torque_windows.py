"""Windows of several recordings that share one set of parameters; noise sets the window length."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from estimators.data.rows import ResidualStructure
from estimators.regression.least_squares import Equations, IdentificationError
from estimators.signals.motion import HALF_WIDTHS
from estimators.weak_form.windows import (
    WHOLE,
    Part,
    WindowAverages,
    Windows,
    concatenate_memory,
    concatenate_samples,
    cut,
    trace_all,
)
from pendulum_env._typing import Array, Index
from pendulum_env.physics import BASE, LOAD, Samples, Term
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import PositionDependentFriction, QuadraticDrag, Stribeck, ViscousAsymmetry
from pendulum_env.physics.potential import Cogging, GravityTilt, HardStop
from pendulum_env.recording import Recording
from pendulum_env.recording.sampling import SAMPLING

NEGLIGIBLE = 0.01  # share of the torque; encoder noise below it hides no effect of practical use
NEGLIGIBLE_SWING = 0.002  # the same of a free swing, in which friction is a small share of the torque


@dataclass(frozen=True)
class WeakFormSettings:
    """Numbers of windowed equations: their length, their errors and their clusters."""

    precision: float = 5e-4  # of the RMS torque, error of smoothing and integration
    fewest: int = 10  # windows, below which no error can be estimated
    enough: int = 100  # windows clear of stick that a window length has to leave,
    clear: float = 0.3  # or share of the recording
    clusters: int = 4  # per parameter of an arm's links: with fewer, some combination would never vary,
    shortest: int = 4  # half windows, the least length of a cluster: errors are correlated over less
    significant: float = 5.0  # standard errors from which the residual of a reversal exceeds friction


WEAK_FORM = WeakFormSettings()


class TermColumns(NamedTuple):
    """Windowed columns of a term that depends on the motion of all joints.

    Attributes:
        linear: (R, P).
        rates: their time derivatives (R, P).
        inertia: mean contribution of each parameter to the inertia at each joint (n, P).
    """

    linear: Array
    rates: Array
    inertia: Array


class PayloadColumns(NamedTuple):
    """Windowed torque of known payloads of an arm.

    Attributes:
        torque: of all links (R,) [N m].
        columns: derivatives of the torque by the parameters of each payload (R, S).
    """

    torque: Array
    columns: Array


@dataclass(frozen=True)
class TorqueWindows:
    """Windows of one or several recordings that share one set of parameters, of one joint or of several.

    Attributes:
        windows: one entry per recording, or per recording and joint, grouped by joint.
        weights: relative weight of each equation (R,), smaller for recordings with more noise.
        clusters: block of time of each equation (R,), for standard errors under correlated residuals.
        link_states: samples with the estimated state variables of a term, by its id, one entry per recording; other
            states are propagated along the measured motion from the start.
        shared_columns: columns of terms that belong to no single joint, by id.
        payload: torque of what an arm is known to carry; None if nothing is.
    """

    windows: tuple[Windows, ...]
    weights: Array
    clusters: Index
    link_states: Mapping[str, Sequence[Samples]] = field(default_factory=dict)
    shared_columns: Mapping[str, TermColumns] = field(default_factory=dict)
    payload: PayloadColumns | None = None

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of their rows; the one joint of a pendulum has an empty name."""
        return tuple(dict.fromkeys(w.at for w in self.windows))

    @cached_property
    def _parts(self) -> dict[str, tuple[slice, TorqueWindows]]:
        found, first = {}, 0
        for joint in self.joints if len(self.joints) > 1 else ():
            own = tuple(w for w in self.windows if w.at == joint)
            here = slice(first, first := first + sum(len(w.centers) for w in own))
            clusters = np.unique(self.clusters[here], return_inverse=True)[1]
            payload = None if self.payload is None else PayloadColumns(*(series[here] for series in self.payload))
            found[joint] = here, TorqueWindows(own, self.weights[here], clusters, payload=payload)
        return found

    def locate_rows(self, at: str) -> slice:
        """Return the rows of a joint; all rows for terms at no single joint."""
        return self._parts[at][0] if at in self._parts else slice(None)

    def part(self, at: str) -> TorqueWindows:
        """Return the windows of a joint; all windows for terms at no single joint."""
        return self._parts[at][1] if at in self._parts else self

    @cached_property
    def samples(self) -> Samples:
        """Samples at the windows' centres, all recordings in a row, (R,) each."""
        return concatenate_samples([w.at_centers() for w in self.windows])

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows, all recordings in a row."""
        return WindowAverages.join([w.averages for w in self.windows])

    @cached_property
    def _rates(self) -> WindowAverages:
        return WindowAverages.join([w.rates for w in self.windows])

    @cached_property
    def _unsmoothed(self) -> Samples:
        """Samples of all recordings in a row as an effect with impacts needs them."""
        return concatenate_samples([w.select_driving_samples(HardStop) for w in self.windows])

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Trace the states of variants of one effect along all recordings in a row, one result for each variant."""
        known = self.link_states.get(variants[0].id)
        if known:
            return [concatenate_samples(known)] * len(variants)
        first, kind = self.windows[0], type(variants[0])
        driving = self.averages.samples if first.select_driving_samples(kind) is first.samples else self._unsmoothed
        if not kind.has_state():
            return [driving] * len(variants)
        traced = zip(*trace_all(self.windows, variants), strict=True)
        return [replace(driving, memory=concatenate_memory(own)) for own in traced]

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        Only the rows of its joint are returned: an effect is zero at all others.
        """
        if variants[0].id in self.shared_columns:
            return [(self.shared_columns[variant.id].linear, np.zeros(len(self.weights))) for variant in variants]
        own = self.part(variants[0].at)
        return own.averages.columns(variants, own.trace(variants))

    def rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        if term.id in self.shared_columns:
            return self.shared_columns[term.id].rates
        own = self.part(term.at)
        (x,) = own.trace([term])
        columns = [own._rates.column(column, x) for column in term.columns]
        return np.column_stack(columns) if columns else np.empty((len(own.weights), 0))

    @cached_property
    def load_rates(self) -> Array:
        """Time derivative of the torque of known loads (R,) [N m/s]."""
        return np.concatenate([w.rates.column(LOAD, w.samples) for w in self.windows])

    @property
    def recording_of_window(self) -> Index:
        """Recording of each equation (R,)."""
        return np.repeat(np.arange(len(self.windows)), [len(w.centers) for w in self.windows])

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Return block of about `length` seconds and entry of each equation (R,); recording of each block (S,).

        The joints of an arm share their blocks.
        """
        block, entry = _number_blocks(self.windows, length), self.recording_of_window
        recording_of_block = np.zeros(int(block.max()) + 1, dtype=np.intp)
        recording_of_block[block] = np.array(_list_recordings(self.windows))[entry]
        return block, entry, recording_of_block

    def structure(self, residual: Array, inertia: float) -> ResidualStructure:
        """Measure the size and the correlation of a residual (R,) [N m] between adjacent windows.

        Adjacent windows overlap, so the covariance due to white sensor noise is subtracted. The correlation is
        normalised in blocks of one second, so that blocks of large and of small residuals have equal weights.
        """
        block, first = _number_blocks(self.windows, 1.0), 0
        shared, powers, owners = [], [], []
        for w in self.windows:
            count, m = len(w.centers), len(w.kernel) // 2
            own = residual[first : first + count]
            adjacent = np.flatnonzero(np.diff(w.centers) == m)
            shared.append(own[adjacent] * own[adjacent + 1] - w.shared_noise(inertia))
            powers.append(0.5 * (own[adjacent] ** 2 + own[adjacent + 1] ** 2))
            owners.append(block[first + adjacent])
            first += count
        product, power, owner = np.concatenate(shared), np.concatenate(powers), np.concatenate(owners)
        rms = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
        if len(product) == 0:
            return ResidualStructure(0.0, 0.0, rms)
        number = np.bincount(owner)
        is_filled = number > 0
        correlation = np.bincount(owner, product)[is_filled] / np.maximum(np.bincount(owner, power)[is_filled], 1e-300)
        z_score = float(number[is_filled] @ correlation) / float(np.sqrt(len(product)))
        size = float(np.sqrt(max(product.mean(), 0.0)))
        return ResidualStructure(size if size > self.precision() else 0.0, z_score, rms)

    def precision(self) -> float:
        """Return the torque error of smoothing and integration [N m]."""
        return WEAK_FORM.precision * float(np.std(self.applied_torque()))

    def least(self) -> float:
        """Return the largest error of smoothing and integration of all joints [N m], also for one without a motor."""
        return max(self.part(at).precision() for at in self.joints)

    def negligible(self, at: str) -> float:
        """Return the residual below which a joint of an arm has no structure [N m]: errors of other joints enter it."""
        return max(NEGLIGIBLE * float(np.std(self.part(at).torque())), self.least()) if self.shared_columns else 0.0

    def with_torque(self, factor: float = 1.0, offset: float = 0.0) -> TorqueWindows:
        """Return the motion under a torque, with its noise, larger by a factor, and with an offset [N m]."""
        changed = (
            w.with_torque(factor * w.recording.torque + offset, factor * w.samples.torque + offset)
            for w in self.windows
        )
        return replace(self, windows=tuple(replace(w, torque_noise=factor * w.torque_noise) for w in changed))

    def with_contacts(
        self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float, free: tuple[float, float]
    ) -> TorqueWindows:
        """Return the windows with those, not clear of stick, whose residual exceeds dry friction: contacts.

        At a reversal and at rest friction is unknown, but it lies between its values in motion in either direction,
        unless it is far larger at rest. A residual significantly above their difference is the force of a stop: a joint
        meets a stop at a reversal, and stands on it at rest. At rest a stop is told from friction that is larger than
        in motion: the joint stands beyond all angles of free motion, and the torque presses it outwards.

        The force of a stop is known less well than other torque, and its equations are scaled by that: at rest to
        within dry friction and the part that varies at the same angle, where the stop yields less than the encoder
        resolves; at a reversal, where n samples show it, to a share of 1 / n^2.

        Args:
            terms: of a model without a link.
            theta: its linear parameters (P,).
            covariance: of these (P, P).
            inertia: of the joint [kg m^2].
            free: range of free motion [rad], see `free_range`.
        """
        unclear = join_windows([replace(w, centers=w.unclear) for w in self.windows])
        residual, friction, noise = unclear._residual(terms, theta, covariance, inertia)
        angle = unclear.samples.position
        presses = ((residual > 0) & (angle > free[1])) | ((residual < 0) & (angle < free[0]))
        rests = np.concatenate([np.isin(w.unclear, w.resting) for w in self.windows])
        is_contact = (np.abs(residual) > 2 * friction + noise) & (presses | ~rests)
        error = np.abs(residual) / np.concatenate([_durations(w) for w in unclear.windows]) ** 2
        for side in (residual > 0, residual < 0):
            own = is_contact & rests & side
            error[own] = 2 * np.hypot(friction[own], _spread(angle[own], residual[own]))
        ends = np.cumsum([len(w.unclear) for w in self.windows])[:-1]
        found = []
        for w, own, errors in zip(self.windows, np.split(is_contact, ends), np.split(error, ends), strict=True):
            centers, scale = w.unclear[own], np.ones(len(w.moving))
            scale[centers] = 1.0 / np.hypot(1.0, errors[own] / max(w.noise(inertia), 1e-300))
            found.append(replace(w, centers=np.sort(np.r_[w.centers, centers]), scale=scale))
        return join_windows(found)

    def free_range(self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float) -> tuple[float, float]:
        """Return the range of angles [rad] at which the joint moves clear of stick with no residual above friction."""
        residual, friction, noise = self._residual(terms, theta, covariance, inertia)
        angle = self.samples.position[np.abs(residual) <= 2 * friction + noise]
        return float(angle.min(initial=np.inf)), float(angle.max(initial=-np.inf))

    def _residual(
        self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float
    ) -> tuple[Array, Array, Array]:
        """Return the residual of each window, its dry friction, and its largest error by noise, (R,) [N m] each."""
        equations = self.equations(terms)
        noise = np.repeat([w.noise(inertia) for w in self.windows], [len(w.centers) for w in self.windows])
        deviation = np.hypot(noise, _compute_deviations(equations.phi, covariance))
        friction = np.concatenate([_bound_friction(w, terms, theta, covariance) for w in self.windows])
        return equations.y - equations.phi @ theta, friction, WEAK_FORM.significant * deviation

    @property
    def contacts(self) -> int:
        """Number of contacts with a stop, each second of a lasting contact counted."""
        return sum(len(instants) for instants in self.contact_instants)

    @property
    def contact_instants(self) -> list[Array]:
        """Instants of contacts with a stop, as shares of each recording, each second of a lasting contact counted."""
        found = []
        for w in self.windows:
            period, instants = len(w.kernel) // 2 / w.recording.rate, list[float]()
            for run in np.split(w.unclear, np.flatnonzero(np.diff(w.unclear) > len(w.kernel) // 2) + 1):
                own = run[np.isin(run, w.centers)]
                instants += own[:: max(1, round(1.0 / period))].tolist()
            found.append(np.array(instants) / len(w.recording))
        return found

    @property
    def without_contacts(self) -> TorqueWindows:
        """The data without contacts."""
        return join_windows([replace(w, centers=w.centers[~np.isin(w.centers, w.unclear)]) for w in self.windows])

    def torque(self) -> Array:
        """Return the windowed measured torque (R,) [N m]."""
        return np.concatenate([w.torque() for w in self.windows])

    def applied_torque(self) -> Array:
        """Return the applied torque, in free swings -I q'' (R,) [N m]."""
        return np.concatenate([w.applied_torque() for w in self.windows])

    def net_torque(self) -> Array:
        """Return the measured torque less that of known loads and payloads (R,) [N m]: the model's left-hand side."""
        net = np.concatenate([w.net_torque() for w in self.windows])
        return net if self.payload is None else net - self.payload.torque

    def equations(self, terms: Sequence[Term]) -> Equations:
        """Return the regression of the torque, less known loads and fixed columns, on the linear columns of terms."""
        parts = [self.columns([term])[0] for term in terms]
        phi = np.column_stack([linear for linear, _ in parts])
        return Equations(phi, self.net_torque() - sum(fixed for _, fixed in parts))

    def absorbed(self, term: Term) -> float:
        """Return the variance of torque noise that the term absorbs, mean over the equations [(N m)^2]."""
        counts = [len(w.centers) for w in self.windows]
        parts = [count * w.absorbed(term) for count, w in zip(counts, self.windows, strict=True) if count]
        return sum(parts) / max(1, sum(counts))

    def noise(self, inertia: float) -> float:
        """Return the noise floor: root mean square over the windows of the error due to measurement noise [N m]."""
        counts = np.array([len(w.centers) for w in self.windows])
        levels = np.array([w.noise(inertia) for w in self.windows])
        return max(self.precision(), float(np.sqrt(np.sum(counts * levels**2) / max(1, counts.sum()))))


def _bound_friction(w: Windows, terms: Sequence[Term], theta: Array, covariance: Array) -> Array:
    """Return an upper bound of dry friction in each window (R,) [N m], in either direction.

    Bristles replace dry friction, so that both together have the same bound.
    """
    if len(w.centers) == 0:
        return np.empty(0)
    rows = np.column_stack(
        [
            np.broadcast_to(column.dry(w.samples), w.moving.shape) if not term.has_state() else np.zeros(len(w.moving))
            for term in terms
            for column in term.columns
        ]
    )
    most = np.abs(rows @ theta) + WEAK_FORM.significant * _compute_deviations(rows, covariance)
    return np.asarray(sliding_window_view(most, len(w.kernel))[w.centers - len(w.kernel) // 2].max(axis=1))


def _spread(angle: Array, force: Array) -> float:
    """Return the part of forces (R,) of a stop [N m] that is no linear function of the angle (R,)."""
    about = angle - angle.mean() if len(angle) else angle
    slope = max(float(about @ force) / max(float(about @ about), 1e-300), 0.0)
    return float(np.std(force - slope * about)) if len(force) else 0.0


def _durations(w: Windows) -> Array:
    """Return the effective number of samples over which the joint is accelerated in each window, at least one (R,)."""
    around = sliding_window_view(w.acceleration, len(w.kernel))[w.centers - len(w.kernel) // 2]
    return np.asarray(np.maximum(around.sum(axis=1) ** 2 / np.maximum((around**2).sum(axis=1), 1e-300), 1.0))


def _compute_deviations(rows: Array, covariance: Array) -> Array:
    """Return standard errors (R,) of sums of parameters, each with its factors (R, P)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("rp,pq,rq->r", rows, covariance, rows), 0.0)))


def _number_blocks(windows: Sequence[Windows], length: float) -> Index:
    """Return the number of the block of about `length` seconds of each equation (R,), within its recording."""
    numbers, offset, first = [], 0, {}
    for w, run in zip(windows, _list_recordings(windows), strict=True):
        count = max(1, round(w.recording.duration / length))
        which = np.minimum((w.centers * count) // len(w.recording), count - 1)
        if run not in first:
            first[run] = offset
            offset += count
        numbers.append(which + first[run])
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _list_recordings(windows: Sequence[Windows]) -> list[int]:
    """Return the recording of each entry: its own, or one shared with other joints."""
    return [k if w.run is None else w.run for k, w in enumerate(windows)]


def _list_half_widths(recording: Recording) -> tuple[float, ...]:
    """Return the half widths of at least two samples whose windows are shorter than the recording."""
    shortest, duration = 2.0 / recording.rate, len(recording) / recording.rate
    if duration < SAMPLING.shortest:
        raise IdentificationError(
            f"{recording.name}: lasts {duration:.3g} s, at least {SAMPLING.shortest:g} s are needed: record longer"
        )
    return tuple(h for h in HALF_WIDTHS if 0.99 * shortest <= h < 0.5 * duration) or (shortest,)


def smooth_laws(w: Windows) -> tuple[Term, ...]:
    """Return terms that together follow nearly any smooth torque: their residual is noise."""
    fast = max(float(np.percentile(np.abs(w.samples.velocity), 95)), 0.1)
    return (
        *BASE,
        TorqueOffset(),
        GravityTilt(),
        ViscousAsymmetry(),
        *(Stribeck(share * fast) for share in (0.05, 0.2)),
        QuadraticDrag(),
        PositionDependentFriction(),
        *(Cogging(order) for order in (2.0, 3.0)),
    )


def calibrate(w: Windows) -> Windows:
    """Limit the noise estimate of windows to the residual of a fit of all smooth laws.

    Torque that changes from sample to sample, under fast control or a random binary signal, looks like noise; but the
    acceleration follows a real torque, so that it leaves no residual.
    """
    phi = np.column_stack([w.columns([law])[0][0] for law in smooth_laws(w)])
    if known := w.recording.known_inertia:
        return limit_noise(w, phi[:, 1:], lambda theta: known, known * phi[:, 0])
    return limit_noise(w, phi, lambda theta: float(theta[0]))


def limit_noise(w: Windows, phi: Array, inertia: Callable[[Array], float], known: Array | float = 0.0) -> Windows:
    """Limit the noise estimate of windows to the residual of columns (R, P) and a known torque (R,) [N m].

    `inertia` maps parameters (P,) to it.
    """
    freedom = len(phi) - phi.shape[1]
    if freedom < phi.shape[1]:
        return w
    scale = np.maximum(np.linalg.norm(phi, axis=0), 1e-300)
    y = w.net_torque() - known
    theta = np.linalg.lstsq(phi / scale, y, rcond=1e-10)[0] / scale
    rms = float(np.linalg.norm(y - phi @ theta)) / np.sqrt(freedom)
    factor = min(1.0, rms / max(w.noise(abs(inertia(theta))), 1e-300))
    return replace(w, torque_noise=factor * w.torque_noise, acceleration_noise=factor * w.acceleration_noise)


def choose_half_width(recording: Recording) -> float:
    """Choose the shortest half width [s] at which encoder noise no longer dominates torque noise.

    Short windows keep more samples near reversals, where friction shows; but the second difference of a coarse encoder
    is mainly noise, which falls with the window length to the power 2.5.
    """
    widths, cut_at = _list_half_widths(recording), cache(partial(cut, recording))
    longest = cut_at(widths[-1])
    carried = float(np.max(longest.samples.load.inertia))
    inertia, real = carried, 1.0  # and share of the torque noise that is real
    for w in map(cut_at, reversed(widths)):  # the longest with enough windows has the least noise
        equations = join_windows((w,)).equations(BASE)
        if len(equations.y) >= 40:
            fitted = recording.known_inertia or np.linalg.lstsq(equations.phi, equations.y, rcond=None)[0][0]
            inertia = carried + abs(float(fitted))
            real = calibrate(w).torque_noise / max(w.torque_noise, 1e-300)
            break
    negligible = (NEGLIGIBLE_SWING if recording.known_inertia else NEGLIGIBLE) * longest.torque_scale

    def measure_clear_time(width: float) -> float:
        return len(cut_at(width).centers) * width  # [s], clear of stick

    def is_feasible(width: float) -> bool:
        count = len(cut_at(width).centers)
        return count >= WEAK_FORM.enough or measure_clear_time(width) >= WEAK_FORM.clear * recording.duration

    def is_quiet(width: float) -> bool:
        w = cut_at(width)
        return inertia * w.acceleration_noise <= max(0.7 * real * w.torque_noise, negligible)

    quiet = next((width for width in widths if is_feasible(width) and is_quiet(width)), None)  # others are not cut
    return quiet or next(filter(is_feasible, reversed(widths)), None) or max(widths, key=measure_clear_time)


def join_windows(windows: Sequence[Windows], shared_columns: Mapping[str, TermColumns] | None = None) -> TorqueWindows:
    """Join windows of several recordings, weighted by their noise."""
    joints, count = {w.at for w in windows}, sum(own.linear.shape[1] for own in (shared_columns or {}).values())
    total = sum(w.recording.duration for w in windows) / len(joints)
    half = max(len(w.kernel) // 2 / w.recording.rate for w in windows)
    shortest = WEAK_FORM.shortest * half if count else 0.0
    sizes = [w.torque_scale for w in windows]
    typical = {
        at: float(np.median([size for size, w in zip(sizes, windows, strict=True) if w.at == at])) for at in joints
    }
    least = WEAK_FORM.precision * max(typical.values())  # a joint without a motor has no torque, but no smaller error
    levels = [max(w.noise(0.05), 0.003 * typical[w.at], least, 1e-12) for w in windows]
    weights = [np.full(len(w.centers), min(levels) / level) for w, level in zip(windows, levels, strict=True)]
    return TorqueWindows(
        tuple(windows),
        np.concatenate(weights),
        _number_blocks(windows, min(0.5, max(total / max(30, WEAK_FORM.clusters * count), shortest))),
        shared_columns=shared_columns or {},
    )


def cut_all(
    recordings: Sequence[Recording], half_widths: Sequence[float] | None = None, part: Part = WHOLE
) -> TorqueWindows:
    """Cut recordings, or a part of each, into windows, with lengths chosen by their noise unless given."""
    widths = half_widths or [choose_half_width(recording) for recording in recordings]
    return join_windows([calibrate(cut(own, width, part)) for own, width in zip(recordings, widths, strict=True)])


def prepare(
    recordings: Sequence[Recording], half_widths: Sequence[float] | None = None, part: Part = WHOLE
) -> TorqueWindows:
    """Cut recordings, or a part of each, into windows: see `cut_all`.

    Raises:
        IdentificationError: if too little of the motion is clear of stick to fit anything.
    """
    data = cut_all(recordings, half_widths, part)
    if (usable := len(data.weights)) < WEAK_FORM.fewest:
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: only {usable} stretches of motion are clear of stick and reversals, at least {WEAK_FORM.fewest} "
            "are needed: record longer, faster or wider motion"
        )
    return data
