"""Windows of several recordings that share one set of parameters, with lengths chosen by noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import NamedTuple

import numpy as np

from estimators.decisions.criterion import ResidualStructure
from estimators.regression.least_squares import (
    Equations,
    Fit,
    IdentificationError,
    solve,
    solve_least_squares,
    weigh_recordings,
)
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
from pendulum_env.units import is_of_torque

TILTED = 0.5  # residual with tilted gravity, share of that without, if the zero of the position is wrong
NEGLIGIBLE = 0.01  # encoder noise that hides no effect of practical use, as a share of the torque
NEGLIGIBLE_SWING = 0.002  # the same for a free swing, where friction is a small share of the torque


@dataclass(frozen=True)
class WeakFormSettings:
    """Numbers of windowed equations: their length, their errors and their clusters."""

    precision: float = 5e-4  # error of smoothing and integration, share of the standard deviation of torque
    fewest: int = 10  # least number of windows, to estimate errors
    enough: int = 100  # windows clear of stick that suffice for a window length
    clear: float = 0.3  # share of the recording in these windows that also suffices, half a window each
    clusters: int = 4  # least number of clusters per parameter of an arm's links
    shortest: int = 4  # least length of a cluster of an arm, above the correlation time of errors [half windows]
    significant: float = 5.0  # standard errors by which the residual of a contact exceeds friction
    unexplained: float = 2.0  # residual above which a model lacks an effect [noise floors]


WEAK_FORM = WeakFormSettings()


class TermColumns(NamedTuple):
    """Windowed columns of a term that depends on the motion of all joints.

    Attributes:
        linear: column of each parameter (R, P).
        rates: time derivatives of the columns (R, P).
        inertia: mean contribution of one unit of each parameter to the inertia at each of n joints (n, P).
    """

    linear: Array
    rates: Array
    inertia: Array


class PayloadColumns(NamedTuple):
    """Windowed torque of known payloads of an arm.

    Attributes:
        torque: sum of all payloads (R,) [N m].
        columns: derivatives of the torque by the parameters of all payloads (R, S).
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
        link_states: samples with the estimated states of a link, per recording, by id of the link. States of other
            terms are simulated along the measured motion.
        shared_columns: columns of terms at several joints, by id.
        payload: torque of known payloads of an arm, or None.
    """

    windows: tuple[Windows, ...]
    weights: Array
    clusters: Index
    link_states: Mapping[str, Sequence[Samples]] = field(default_factory=dict)
    shared_columns: Mapping[str, TermColumns] = field(default_factory=dict)
    payload: PayloadColumns | None = None

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of their rows; empty for the joint of a pendulum."""
        return tuple(dict.fromkeys(w.at for w in self.windows))

    @cached_property
    def _parts(self) -> dict[str, tuple[slice, TorqueWindows]]:
        """Rows and windows of each of several joints, by name; empty for one joint."""
        parts, start = {}, 0
        for joint in self.joints if len(self.joints) > 1 else ():
            of_joint = tuple(w for w in self.windows if w.at == joint)
            rows = slice(start, start := start + sum(len(w.centers) for w in of_joint))
            clusters = np.unique(self.clusters[rows], return_inverse=True)[1]
            payload = None if self.payload is None else PayloadColumns(*(series[rows] for series in self.payload))
            parts[joint] = rows, TorqueWindows(of_joint, self.weights[rows], clusters, payload=payload)
        return parts

    def locate_rows(self, at: str) -> slice:
        """Return the rows of a joint; all rows for terms at several joints."""
        return self._parts[at][0] if at in self._parts else slice(None)

    def part(self, at: str) -> TorqueWindows:
        """Return the windows of a joint; all windows for terms at several joints."""
        return self._parts[at][1] if at in self._parts else self

    @cached_property
    def samples(self) -> Samples:
        """Samples at the middle of each window, all recordings concatenated, (R,) each."""
        return concatenate_samples([w.select_center_samples() for w in self.windows])

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows, all recordings concatenated."""
        return WindowAverages.join([w.averages for w in self.windows])

    @cached_property
    def _rates(self) -> WindowAverages:
        """Averages of time derivatives over the windows, all recordings concatenated."""
        return WindowAverages.join([w.rates for w in self.windows])

    @cached_property
    def _unsmoothed(self) -> Samples:
        """Concatenated samples of all recordings that drive an effect with impacts."""
        return concatenate_samples([w.select_driving_samples(HardStop) for w in self.windows])

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Return the concatenated driving samples of all recordings with the states of each variant of one effect.

        Estimated states of a link are the same for all variants. States of other effects are simulated.
        """
        known = self.link_states.get(variants[0].id)
        if known:
            return [concatenate_samples(known)] * len(variants)
        first, kind = self.windows[0], type(variants[0])
        driving = self.averages.samples if first.select_driving_samples(kind) is first.samples else self._unsmoothed
        if not kind.has_state():
            return [driving] * len(variants)
        traced = zip(*trace_all(self.windows, variants), strict=True)
        return [replace(driving, memory=concatenate_memory(states)) for states in traced]

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        R is the number of rows of the effect's joint; the columns are zero in all other rows.
        """
        if variants[0].id in self.shared_columns:
            return [(self.shared_columns[variant.id].linear, np.zeros(len(self.weights))) for variant in variants]
        of_joint = self.part(variants[0].at)
        return of_joint.averages.columns(variants, of_joint.trace(variants))

    def find_largest_sizes(self, term: Term) -> Array:
        """Return the size of each linear parameter of a term (P,) that gives the largest applied torque.

        A parameter in N m is set to this torque: dry friction acts in full at low speeds, which windows leave out.
        """
        linear, is_torque = self.columns([term])[0][0], [is_of_torque(column.unit) for column in term.columns]
        most = float(np.abs(self.part(term.at).applied_torque()).max())
        return most / np.where(is_torque, 1.0, np.maximum(np.abs(linear).max(axis=0), 1e-300))

    def rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        if term.id in self.shared_columns:
            return self.shared_columns[term.id].rates
        of_joint = self.part(term.at)
        (x,) = of_joint.trace([term])
        columns = [of_joint._rates.column(column, x) for column in term.columns]
        return np.column_stack(columns) if columns else np.empty((len(of_joint.weights), 0))

    @cached_property
    def load_rates(self) -> Array:
        """Time derivative of the torque of known loads (R,) [N m/s]."""
        return np.concatenate([w.rates.column(LOAD, w.samples) for w in self.windows])

    @property
    def recording_of_window(self) -> Index:
        """Index of the entry of `windows` of each equation (R,)."""
        return np.repeat(np.arange(len(self.windows)), [len(w.centers) for w in self.windows])

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Return block and entry of each equation (R,), and the recording of each block (S,).

        A block lasts about `length` seconds; the joints of an arm share their blocks. An entry is an index of
        `windows`.
        """
        block, entry = _number_blocks(self.windows, length), self.recording_of_window
        recording_of_block = np.zeros(int(block.max()) + 1, dtype=np.intp)
        recording_of_block[block] = np.array(_list_recordings(self.windows))[entry]
        return block, entry, recording_of_block

    def measure_structure(self, residual: Array, inertia: float) -> ResidualStructure:
        """Measure the size of a residual (R,) [N m], and its correlation between windows half a window apart.

        The covariance due to white sensor noise, of a joint with an inertia [kg m^2], is subtracted; this noise is at
        most the residual. The correlation is normalised in blocks of one second, so blocks with large residuals do not
        dominate. A correlated part below `precision` counts as zero.
        """
        block, start = _number_blocks(self.windows, 1.0), 0
        products, squares, owners = [], [], []
        for w in self.windows:
            count, m = len(w.centers), len(w.kernel) // 2
            of_recording = residual[start : start + count]
            adjacent = np.flatnonzero(np.diff(w.centers) == m)
            share = min(1.0, float(np.sum(of_recording**2)) / max(count * w.noise(inertia) ** 2, 1e-300))
            products.append(of_recording[adjacent] * of_recording[adjacent + 1] - share * w.shared_noise(inertia))
            squares.append(0.5 * (of_recording[adjacent] ** 2 + of_recording[adjacent + 1] ** 2))
            owners.append(block[start + adjacent])
            start += count
        product, square, owner = np.concatenate(products), np.concatenate(squares), np.concatenate(owners)
        rms = float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0
        if len(product) == 0:
            return ResidualStructure(0.0, 0.0, rms)
        counts = np.bincount(owner)
        is_filled = counts > 0
        correlation = np.bincount(owner, product)[is_filled] / np.maximum(np.bincount(owner, square)[is_filled], 1e-300)
        z_score = float(counts[is_filled] @ correlation) / float(np.sqrt(len(product)))
        size = float(np.sqrt(max(product.mean(), 0.0)))
        return ResidualStructure(size if size > self.precision() else 0.0, z_score, rms)

    def precision(self) -> float:
        """Return the torque error of smoothing and integration [N m]."""
        return WEAK_FORM.precision * float(np.std(self.applied_torque()))

    def compute_numerical_error(self) -> float:
        """Return the largest numerical error of the joints' torque [N m], see `precision`."""
        return max(self.part(at).precision() for at in self.joints)

    def compute_negligible_residual(self, at: str) -> float:
        """Return the residual below which a joint of an arm has no structure [N m]; 0 for a pendulum."""
        return (
            max(NEGLIGIBLE * float(np.std(self.part(at).torque())), self.compute_numerical_error())
            if self.shared_columns
            else 0.0
        )

    def with_torque(self, factor: float = 1.0, offset: float = 0.0) -> TorqueWindows:
        """Return the windows with torque and its noise times a factor, and an offset added to the torque [N m]."""
        changed = (
            w.with_torque(factor * w.recording.torque + offset, factor * w.samples.torque + offset)
            for w in self.windows
        )
        return replace(self, windows=tuple(replace(w, torque_noise=factor * w.torque_noise) for w in changed))

    def with_contacts(
        self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float, free: tuple[float, float]
    ) -> TorqueWindows:
        """Add contacts with a stop: windows near stick with a residual above dry friction.

        At a reversal, the residual of a contact exceeds twice the dry friction plus noise. At rest, friction may be
        larger: a contact must also lie outside the range of free motion, with a residual that points outwards.

        Equations of contacts are scaled by the error of the force. At rest it is twice the root sum of squares of dry
        friction and scatter. At a reversal of n samples it is 1 / n^2 of the force.

        Args:
            terms: terms of a model without a link.
            theta, covariance: linear parameters of the terms (P,), and their covariance (P, P).
            inertia: inertia of the joint [kg m^2].
            free: range of free motion [rad], see `find_free_range`.
        """
        unclear = join_windows([replace(w, centers=w.unclear) for w in self.windows])
        residual, friction, noise = unclear._compute_residual(terms, theta, covariance, inertia)
        angle = unclear.samples.position
        is_outwards = ((residual > 0) & (angle > free[1])) | ((residual < 0) & (angle < free[0]))
        is_at_rest = np.concatenate([np.isin(w.unclear, w.resting) for w in self.windows])
        is_contact = (np.abs(residual) > 2 * friction + noise) & (is_outwards | ~is_at_rest)
        error = np.abs(residual) / np.concatenate([_compute_durations(w) for w in unclear.windows]) ** 2
        for side in (residual > 0, residual < 0):
            selected = is_contact & is_at_rest & side
            error[selected] = 2 * np.hypot(friction[selected], _compute_scatter(angle[selected], residual[selected]))
        ends = np.cumsum([len(w.unclear) for w in self.windows])[:-1]
        windows = []
        for w, selected, errors in zip(self.windows, np.split(is_contact, ends), np.split(error, ends), strict=True):
            centers, scale = w.unclear[selected], np.ones(len(w.moving)) if w.scale is None else w.scale.copy()
            scale[centers] = 1.0 / np.hypot(1.0, errors[selected] / max(w.noise(inertia), 1e-300))
            windows.append(replace(w, centers=np.sort(np.r_[w.centers, centers]), scale=scale))
        return join_windows(windows)

    def find_free_range(
        self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float
    ) -> tuple[float, float]:
        """Return the least and largest angle [rad] of windows clear of stick with a residual within friction and noise.

        The arguments are those of `with_contacts`. Without windows, the range is (inf, -inf).
        """
        residual, friction, noise = self._compute_residual(terms, theta, covariance, inertia)
        angle = self.samples.position[np.abs(residual) <= 2 * friction + noise]
        return float(angle.min(initial=np.inf)), float(angle.max(initial=-np.inf))

    def _compute_residual(
        self, terms: Sequence[Term], theta: Array, covariance: Array, inertia: float
    ) -> tuple[Array, Array, Array]:
        """Return the residual of each window, and bounds of its dry friction and its noise, (R,) [N m] each."""
        equations = self.equations(terms)
        noise = np.repeat([w.noise(inertia) for w in self.windows], [len(w.centers) for w in self.windows])
        deviation = np.hypot(noise, compute_deviations(equations.phi, covariance))
        friction = np.concatenate([bound_friction(w, terms, theta, covariance) for w in self.windows])
        return equations.y - equations.phi @ theta, friction, WEAK_FORM.significant * deviation

    @property
    def contacts(self) -> int:
        """Number of contacts with a stop; a lasting contact counts once a second."""
        return sum(len(instants) for instants in self.contact_instants)

    @property
    def contact_instants(self) -> list[Array]:
        """Instants of contacts of each entry, as shares of the recording; a lasting contact counts once a second."""
        shares = []
        for w in self.windows:
            period, instants = len(w.kernel) // 2 / w.recording.rate, list[float]()
            for run in np.split(w.unclear, np.flatnonzero(np.diff(w.unclear) > len(w.kernel) // 2) + 1):
                contact_run = run[np.isin(run, w.centers)]
                instants += contact_run[:: max(1, round(1.0 / period))].tolist()
            shares.append(np.array(instants) / len(w.recording))
        return shares

    @property
    def without_contacts(self) -> TorqueWindows:
        """Windows without contacts."""
        return join_windows([replace(w, centers=w.centers[~np.isin(w.centers, w.unclear)]) for w in self.windows])

    @cached_property
    def scale(self) -> Array:
        """Factor on each equation (R,), below one where its torque is less certain."""
        return np.concatenate([w.row_scale for w in self.windows])

    def torque(self) -> Array:
        """Return the windowed measured torque (R,) [N m]."""
        return np.concatenate([w.torque() for w in self.windows])

    def applied_torque(self) -> Array:
        """Return the applied torque (R,) [N m], in free swings -I q'' with the known inertia I."""
        return np.concatenate([w.applied_torque() for w in self.windows])

    def net_torque(self) -> Array:
        """Return the left-hand side: the measured torque minus that of known loads and payloads (R,) [N m]."""
        net = np.concatenate([w.net_torque() for w in self.windows])
        return net if self.payload is None else net - self.payload.torque

    def equations(self, terms: Sequence[Term]) -> Equations:
        """Return the regression of the torque, minus known loads and fixed columns, on the linear columns of terms."""
        parts = [self.columns([term])[0] for term in terms]
        phi = np.column_stack([linear for linear, _ in parts])
        return Equations(phi, self.net_torque() - sum(fixed for _, fixed in parts))

    @cached_property
    def base_fit(self) -> Fit:
        """Fit of the base model, with tilted gravity if the zero is wrong, to the windows without contacts.

        Recordings are weighted by their residual, so an unexplained recording does not bias the others.

        A wrong zero leaves a residual above the noise, which tilted gravity halves at least. A residual of noise may
        become smaller, too: for motion at one frequency, cos q takes the place of a noisy acceleration.
        """
        if self.contacts:
            return self.without_contacts.base_fit
        equations, weights = self.equations((*BASE, GravityTilt())), self.weights
        models = Equations(equations.phi[:, :-1], equations.y), equations
        fits = [solve(model, weights, self.clusters) for model in models]
        base, tilted = (float(np.linalg.norm(fit.residual * weights)) for fit in fits)
        floor = self.noise(abs(float(fits[0].theta[0]))) * float(np.linalg.norm(weights))
        is_wrong = base > WEAK_FORM.unexplained * floor and tilted < TILTED * base
        if len(self.windows) == 1:
            return fits[is_wrong]
        owner = self.recording_of_window
        squares, counts = np.bincount(owner, fits[is_wrong].residual ** 2).astype(float), np.bincount(owner)
        weights = weigh_recordings(squares, counts, self.compute_numerical_error())[owner]
        return solve(models[is_wrong], weights, self.clusters)

    @cached_property
    def base_inertia(self) -> float:
        """Inertia that scales encoder noise [kg m^2]: the largest known one, else that of `base_fit`."""
        known = [w.recording.known_inertia or w.inertia for w in self.windows]
        if all(known):
            return max(inertia for inertia in known if inertia)
        return abs(float(self.base_fit.theta[0]))  # below zero if the sign of torque is wrong

    def compute_absorbed_noise(self, term: Term) -> float:
        """Return the variance of torque noise that a term's fixed columns absorb, mean over all rows [(N m)^2]."""
        counts = [len(w.centers) for w in self.windows]
        parts = [count * w.compute_absorbed_noise(term) for count, w in zip(counts, self.windows, strict=True) if count]
        return sum(parts) / max(1, sum(counts))

    def noise(self, inertia: float) -> float:
        """Return the noise floor [N m]: RMS over the windows of the error by noise, at least `precision`."""
        counts = np.array([len(w.centers) for w in self.windows])
        levels = np.array([w.noise(inertia) for w in self.windows])
        return max(self.precision(), float(np.sqrt(np.sum(counts * levels**2) / max(1, counts.sum()))))


def bound_friction(w: Windows, terms: Sequence[Term], theta: Array, covariance: Array) -> Array:
    """Return an upper bound of dry friction in each window (R,) [N m], in either direction.

    The bound is the largest value in the window plus `WEAK_FORM.significant` standard errors, without terms with state.
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
    bound = np.abs(rows @ theta) + WEAK_FORM.significant * compute_deviations(rows, covariance)
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(bound, len(w.kernel))[w.centers - len(w.kernel) // 2].max(axis=1)
    )


def _compute_scatter(angle: Array, force: Array) -> float:
    """Return the standard deviation [N m] of torques (R,) about a line in the angle (R,) with a slope of at least 0.

    Without torques it is 0.
    """
    deviation = angle - angle.mean() if len(angle) else angle
    slope = max(float(deviation @ force) / max(float(deviation @ deviation), 1e-300), 0.0)
    return float(np.std(force - slope * deviation)) if len(force) else 0.0


def _compute_durations(w: Windows) -> Array:
    """Return the effective number of samples of the acceleration a in each window, (sum a)^2 / sum a^2 >= 1 (R,)."""
    a = np.lib.stride_tricks.sliding_window_view(w.acceleration, len(w.kernel))[w.centers - len(w.kernel) // 2]
    return np.asarray(np.maximum(a.sum(axis=1) ** 2 / np.maximum((a**2).sum(axis=1), 1e-300), 1.0))


def compute_deviations(rows: Array, covariance: Array) -> Array:
    """Return the standard error of each row (R, P) times the parameters, of covariance (P, P)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("rp,pq,rq->r", rows, covariance, rows), 0.0)))


def _number_blocks(windows: Sequence[Windows], length: float) -> Index:
    """Return the block of about `length` seconds of each equation (R,), numbered from 0 over all recordings."""
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
    """Return the number of the recording of each entry: its `run`, or its index for a pendulum."""
    return [k if w.run is None else w.run for k, w in enumerate(windows)]


def _list_half_widths(recording: Recording) -> tuple[float, ...]:
    """Return the `HALF_WIDTHS` [s] of at least two samples that fit into the recording; else two samples.

    Raises:
        IdentificationError: if the recording is too short.
    """
    shortest, duration = 2.0 / recording.rate, len(recording) / recording.rate
    if duration < SAMPLING.shortest:
        raise IdentificationError(
            f"{recording.name}: lasts {duration:.3g} s, at least {SAMPLING.shortest:g} s are needed: record longer"
        )
    return tuple(h for h in HALF_WIDTHS if 0.99 * shortest <= h < 0.5 * duration) or (shortest,)


def smooth_laws(w: Windows) -> tuple[Term, ...]:
    """Return terms that together fit nearly any smooth torque; their residual is noise."""
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


def calibrate_noise(w: Windows) -> Windows:
    """Limit the noise estimate of windows to the residual of a fit of all smooth laws.

    Torque that changes at each sample, as under fast control, counts as noise in the first estimate. The acceleration
    follows this torque, so it leaves no residual.
    """
    phi = np.column_stack([w.columns([law])[0][0] for law in smooth_laws(w)])
    if known := w.recording.known_inertia:
        return limit_noise(w, phi[:, 1:], lambda theta: known, known * phi[:, 0])
    return limit_noise(w, phi, lambda theta: float(theta[0]))


def limit_noise(w: Windows, phi: Array, inertia: Callable[[Array], float], known: Array | float = 0.0) -> Windows:
    """Scale the noise estimates of windows down so that their floor is at most the residual of a linear fit.

    The fit has columns `phi` (R, P) and a known torque (R,) [N m]. With fewer than 2 P rows the windows are unchanged.
    `inertia` maps parameters (P,) to the inertia [kg m^2].
    """
    freedom = len(phi) - phi.shape[1]
    if freedom < phi.shape[1]:
        return w
    y = w.net_torque() - known
    theta = solve_least_squares(phi, y)
    rms = float(np.linalg.norm(y - phi @ theta)) / np.sqrt(freedom)
    factor = min(1.0, rms / max(w.noise(abs(inertia(theta))), 1e-300))
    return replace(w, torque_noise=factor * w.torque_noise, acceleration_noise=factor * w.acceleration_noise)


def choose_half_width(recording: Recording, known_inertia: float | None = None) -> float:
    """Choose the shortest half width [s] with enough windows clear of stick and little encoder noise.

    Encoder noise, scaled by the known inertia of the joint without load or else by that of the base model [kg m^2],
    must be below torque noise or negligible. If no half width meets both, the longest with enough windows
    is chosen, else the half width with the longest clear time. Short windows include samples near reversals, which show
    friction. Encoder noise falls with length^2.5.

    In a free swing, the shortest windows in which encoder noise would be negligible may be much longer. Such windows
    include reversals, see `cut`. They are taken if noise in the longest of the others is above `NEGLIGIBLE`, and are at
    most half a period long.
    """
    widths, cut_at = _list_half_widths(recording), cache(partial(cut, recording))
    longest = cut_at(widths[-1])
    load_inertia = float(np.max(longest.samples.load.inertia))
    # [kg m^2], and factor on the torque noise by calibration
    inertia, noise_factor = load_inertia + recording.known_inertia, 1.0
    for w in map(cut_at, reversed(widths)):  # long windows have less noise
        data = join_windows((w,))
        if len(w.centers) >= 40:
            inertia = load_inertia + (known_inertia or data.base_inertia)
            noise_factor = calibrate_noise(w).torque_noise / max(w.torque_noise, 1e-300)
            break
    negligible = (NEGLIGIBLE_SWING if recording.known_inertia else NEGLIGIBLE) * longest.torque_scale

    def measure_clear_time(width: float) -> float:
        return len(cut_at(width).centers) * width  # [s], clear of stick

    def is_feasible(width: float) -> bool:
        count = len(cut_at(width).centers)
        return count >= WEAK_FORM.enough or measure_clear_time(width) >= WEAK_FORM.clear * recording.duration

    def is_quiet(width: float) -> bool:
        w = cut_at(width)
        return inertia * w.acceleration_noise <= max(0.7 * noise_factor * w.torque_noise, negligible)

    quiet = next((width for width in widths if is_feasible(width) and is_quiet(width)), None)  # others are not cut
    noise = inertia * longest.acceleration_noise
    if quiet is None and recording.known_inertia and noise > NEGLIGIBLE * longest.torque_scale:
        half_width = min(widths[-1] * (noise / negligible) ** 0.4, 0.25 * find_period(longest))
        if half_width > HALF_WIDTHS[-1]:
            return half_width
    return quiet or next(filter(is_feasible, reversed(widths)), None) or max(widths, key=measure_clear_time)


def find_period(w: Windows) -> float:
    """Return the period of a swing [s], twice the median time between reversals; 0 with fewer than two reversals."""
    instants = np.flatnonzero(w.moving)
    reversals = instants[1:][np.diff(np.sign(w.samples.velocity[instants])) != 0]
    return 2 * float(np.median(np.diff(reversals))) / w.recording.rate if len(reversals) > 1 else 0.0


def join_windows(windows: Sequence[Windows], shared_columns: Mapping[str, TermColumns] | None = None) -> TorqueWindows:
    """Join windows of several recordings, weighted from 0 to 1 by their noise, with columns of several joints."""
    joints, count = {w.at for w in windows}, sum(columns.linear.shape[1] for columns in (shared_columns or {}).values())
    total = sum(w.recording.duration for w in windows) / len(joints)
    half_width = max(len(w.kernel) // 2 / w.recording.rate for w in windows)
    shortest = WEAK_FORM.shortest * half_width if count else 0.0
    scales = [w.torque_scale for w in windows]
    typical = {
        at: float(np.median([scale for scale, w in zip(scales, windows, strict=True) if w.at == at])) for at in joints
    }
    least = WEAK_FORM.precision * max(typical.values())  # also of a joint without a motor
    levels = [max(w.noise(0.05), 0.003 * typical[w.at], least, 1e-12) for w in windows]
    weights = [np.full(len(w.centers), min(levels) / level) for w, level in zip(windows, levels, strict=True)]
    return TorqueWindows(
        tuple(windows),
        np.concatenate(weights),
        _number_blocks(windows, min(0.5, max(total / max(30, WEAK_FORM.clusters * count), shortest))),
        shared_columns=shared_columns or {},
    )


def prepare_windows(
    recordings: Sequence[Recording],
    half_widths: Sequence[float] | None = None,
    part: Part = WHOLE,
    margin: float = 0.0,
    fewest: int = WEAK_FORM.fewest,
    inertia: float | None = None,
) -> TorqueWindows:
    """Cut recordings into windows, with half widths [s] chosen by their noise unless given; see `cut`.

    A known inertia [kg m^2] scales encoder noise; without it, that of the base model does.

    Raises:
        IdentificationError: if fewer windows than `fewest` are clear of stick.
    """
    widths = half_widths or [choose_half_width(recording, inertia) for recording in recordings]
    windows = (cut(recording, width, part, margin) for recording, width in zip(recordings, widths, strict=True))
    data = join_windows([replace(calibrate_noise(w), inertia=inertia) for w in windows])
    if (usable := len(data.weights)) < fewest:
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: only {usable} stretches of motion are clear of stick, at least {fewest} are needed: record "
            "longer, faster or wider motion"
        )
    return data
