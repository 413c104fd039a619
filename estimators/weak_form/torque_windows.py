"""Windows of several recordings that share one set of parameters, with lengths chosen by noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from estimators.decisions.score import BLOCK
from estimators.regression.least_squares import Equations, Fit, solve, weigh_recordings
from estimators.weak_form.averages import concatenate_samples
from estimators.weak_form.blocks import list_recordings, number_blocks
from estimators.weak_form.floors import compute_noise_floor, compute_numerical_error
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import Windows, mark_contacts
from pendulum_env._typing import Array, Index
from pendulum_env.physics import BASE, Samples, Term
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.units import is_of_torque


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
    """Windowed torque of known payloads on links.

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
        payload: torque of known payloads on links, or None.
        block: length of a block of folds and score [s].
    """

    windows: tuple[Windows, ...]
    weights: Array
    clusters: Index
    link_states: Mapping[str, Sequence[Samples]] = field(default_factory=dict)
    shared_columns: Mapping[str, TermColumns] = field(default_factory=dict)
    payload: PayloadColumns | None = None
    block: float = BLOCK

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
            part = TorqueWindows(of_joint, self.weights[rows], clusters, payload=payload, block=self.block)
            parts[joint] = rows, part
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
    def recorded_samples(self) -> Samples:
        """All samples with position and torque as recorded, without states, all recordings concatenated."""
        whole = {id(w.recording): w for w in self.windows}.values()  # parts share a recording
        return concatenate_samples([replace(w.unsmoothed, torque=w.recording.torque, memory={}) for w in whole])

    @cached_property
    def window_columns(self) -> WindowColumns:
        """Columns of terms that depend on the motion of their own joint."""
        return WindowColumns(self.windows, self.link_states)

    @cached_property
    def torque(self) -> WindowTorque:
        """Torque averaged over the windows."""
        return WindowTorque(self.windows, 0.0 if self.payload is None else self.payload.torque)

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        R is the number of rows of the effect's joint; the columns are zero in all other rows.
        """
        if variants[0].id in self.shared_columns:
            return [(self.shared_columns[variant.id].linear, np.zeros(len(self.weights))) for variant in variants]
        return self.part(variants[0].at).window_columns.columns(variants)

    def rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        if term.id in self.shared_columns:
            return self.shared_columns[term.id].rates
        return self.part(term.at).window_columns.rates(term)

    @property
    def recording_of_window(self) -> Index:
        """Index of the entry of `windows` of each equation (R,)."""
        return np.repeat(np.arange(len(self.windows)), [len(w.centers) for w in self.windows])

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Return block and entry of each equation (R,), and the recording of each block (S,).

        A block lasts about `length` seconds; joints with links share their blocks. An entry is an index of
        `windows`.
        """
        block, entry = number_blocks(self.windows, length), self.recording_of_window
        recording_of_block = np.zeros(int(block.max()) + 1, dtype=np.intp)
        recording_of_block[block] = np.array(list_recordings(self.windows))[entry]
        return block, entry, recording_of_block

    def with_torque(self, factor: float = 1.0, offset: float = 0.0) -> TorqueWindows:
        """Return the windows with torque and its noise times a factor, and an offset added to the torque [N m]."""
        changed = (
            w.with_torque(factor * w.recording.torque + offset, factor * w.samples.torque + offset)
            for w in self.windows
        )
        return replace(
            self, windows=tuple(replace(w, noise=w.noise.with_torque(factor * w.noise.torque)) for w in changed)
        )

    @cached_property
    def scale(self) -> Array:
        """Factor on each equation (R,), below one where its torque is less certain."""
        return np.concatenate([w.row_scale for w in self.windows])

    def equations(self, terms: Sequence[Term]) -> Equations:
        """Return the regression of the torque, minus known loads and fixed columns, on the linear columns of terms."""
        parts = [self.columns([term])[0] for term in terms]
        phi = np.column_stack([linear for linear, _ in parts])
        return Equations(phi, self.torque.net - sum(fixed for _, fixed in parts))

    @cached_property
    def free_windows(self) -> TorqueWindows:
        """Windows without those in contact with a stop; all if no other remains."""
        contacts = [mark_contacts(w) for w in self.windows]
        if not np.concatenate(contacts).any() or np.concatenate(contacts).all():
            return self
        parts = [replace(w, centers=w.centers[~touches]) for w, touches in zip(self.windows, contacts, strict=True)]
        return join_windows(parts)

    @cached_property
    def _base_fits(self) -> tuple[Fit, Fit]:
        """Fits of the base model and of tilted gravity."""
        equations = self.equations((*BASE, GravityTilt()))
        models = Equations(equations.phi[:, :-1], equations.y), equations
        base, tilted = (solve(model, self.weights, self.clusters) for model in models)
        return base, tilted

    @cached_property
    def has_wrong_zero(self) -> bool:
        """Return whether the zero of the position is wrong: tilted gravity halves a residual above the noise.

        A residual of noise may become smaller, too: for motion at one frequency, cos q takes the place of a noisy
        acceleration. Free swings without torque are not tested.
        """
        if self.free_windows is not self:
            return self.free_windows.has_wrong_zero
        base, tilted = (float(np.linalg.norm(fit.residual * self.weights)) for fit in self._base_fits)
        noise = compute_noise_floor(self.windows, abs(float(self._base_fits[0].theta[0])))
        floor = noise * float(np.linalg.norm(self.weights))
        return base > RESOLUTION.wrong_zero * floor and tilted < RESOLUTION.tilted * base

    @cached_property
    def base_fit(self) -> Fit:
        """Fit of the base model, with tilted gravity if the zero is wrong, to the windows without contacts.

        Recordings are weighted by their residual, so an unexplained recording does not bias the others.
        """
        if self.free_windows is not self:
            return self.free_windows.base_fit
        fit = self._base_fits[self.has_wrong_zero]
        if len(self.windows) == 1:
            return fit
        owner, equations = self.recording_of_window, self.equations((*BASE, GravityTilt()))
        squares, counts = np.bincount(owner, fit.residual**2).astype(float), np.bincount(owner)
        weights = weigh_recordings(squares, counts, compute_numerical_error(self.windows))[owner]
        return solve(Equations(equations.phi[:, : len(fit.theta)], equations.y), weights, self.clusters)

    @cached_property
    def base_inertia(self) -> float:
        """Inertia that scales encoder noise [kg m^2]: the largest known one, else that of `base_fit`."""
        known = [w.recording.known_inertia or w.inertia for w in self.windows]
        if all(known):
            return max(inertia for inertia in known if inertia)
        return abs(float(self.base_fit.theta[0]))  # below zero if the sign of torque is wrong


def join_windows(
    windows: Sequence[Windows], shared_columns: Mapping[str, TermColumns] | None = None, block: float = BLOCK
) -> TorqueWindows:
    """Join windows of several recordings, weighted from 0 to 1 by their noise, with columns of several joints."""
    joints, count = {w.at for w in windows}, sum(columns.linear.shape[1] for columns in (shared_columns or {}).values())
    total = sum(w.recording.duration for w in windows) / len(joints)
    half_width = max(w.half_width for w in windows)
    shortest = RESOLUTION.shortest * half_width if count else 0.0
    scales = [w.torque_scale for w in windows]
    typical = {
        at: float(np.median([scale for scale, w in zip(scales, windows, strict=True) if w.at == at])) for at in joints
    }
    least = RESOLUTION.precision * max(typical.values())  # also of a joint without a motor
    levels = [
        max(w.noise.compute_std(RESOLUTION.light), RESOLUTION.least_noise * typical[w.at], least, 1e-12)
        for w in windows
    ]
    weights = [np.full(len(w.centers), min(levels) / level) for w, level in zip(windows, levels, strict=True)]
    length = min(RESOLUTION.longest, max(total / max(RESOLUTION.pieces, RESOLUTION.clusters * count), shortest))
    clusters, shared = number_blocks(windows, length), shared_columns or {}
    return TorqueWindows(tuple(windows), np.concatenate(weights), clusters, shared_columns=shared, block=block)


def find_largest_sizes(data: TorqueWindows, term: Term) -> Array:
    """Return the size of each linear parameter of a term (P,) that gives the largest applied torque.

    A parameter in N m is set to this torque: dry friction acts in full at low speeds, which windows leave out.
    """
    linear, is_torque = data.columns([term])[0][0], [is_of_torque(column.unit) for column in term.columns]
    most = float(np.abs(data.part(term.at).torque.applied).max())
    return most / np.where(is_torque, 1.0, np.maximum(np.abs(linear).max(axis=0), 1e-300))


def compute_negligible_residual(data: TorqueWindows, at: str) -> float:
    """Return the residual below which a joint with links has no structure [N m]; 0 for a pendulum."""
    if not data.shared_columns:
        return 0.0
    share = RESOLUTION.width.negligible * float(np.std(data.part(at).torque.recorded))
    return max(share, compute_numerical_error(data.windows))
