"""Contacts with a stop: windows near stick whose torque exceeds dry friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array
from pendulum_env.physics import Term


@dataclass(frozen=True, eq=False)
class ContactTest:
    """Test of windows near stick for a contact with a stop, by a fitted model without a link.

    At a reversal, the residual of a contact exceeds twice the dry friction plus noise, and a step of the encoder within
    half a window, since slow motion does not average its steps. At rest, friction may be larger: a contact must also
    lie outside the range of free motion, with a residual that points outwards.

    Attributes:
        terms: terms of the model.
        theta, covariance: linear parameters of the terms (P,), and their covariance (P, P).
        inertia: inertia of the joint [kg m^2].
    """

    terms: Sequence[Term]
    theta: Array
    covariance: Array
    inertia: float

    def add_contacts(self, data: TorqueWindows, free: tuple[float, float]) -> TorqueWindows:
        """Add the windows in contact to the equations, outside the range of free motion [rad], see `find_free_range`.

        Equations of contacts are scaled by the error of the force. At rest it is twice the root sum of squares of dry
        friction and scatter. At a reversal of n samples it is 1 / n^2 of the force.
        """
        unclear = join_windows([replace(w, centers=w.stick.centers) for w in data.windows], block=data.block)
        residual, friction, noise = self._compute_residual(unclear)
        angle = unclear.samples.position
        is_outwards = ((residual > 0) & (angle > free[1])) | ((residual < 0) & (angle < free[0]))
        is_at_rest = np.concatenate([np.isin(w.stick.centers, w.stick.resting) for w in data.windows])
        steps = [np.full(len(w.centers), w.recording.position_step / w.half_width**2) for w in unclear.windows]
        noise = noise + self.inertia * np.concatenate(steps) * ~is_at_rest
        is_contact = (np.abs(residual) > 2 * friction + noise) & (is_outwards | ~is_at_rest)
        error = np.abs(residual) / np.concatenate([_compute_durations(w) for w in unclear.windows]) ** 2
        for side in (residual > 0, residual < 0):
            selected = is_contact & is_at_rest & side
            error[selected] = 2 * np.hypot(friction[selected], _compute_scatter(angle[selected], residual[selected]))
        ends = np.cumsum([len(w.stick.centers) for w in data.windows])[:-1]
        windows = []
        for w, selected, errors in zip(data.windows, np.split(is_contact, ends), np.split(error, ends), strict=True):
            centers, scale = w.stick.centers[selected], np.ones(len(w.moving)) if w.scale is None else w.scale.copy()
            scale[centers] = 1.0 / np.hypot(1.0, errors[selected] / max(w.noise.compute_std(self.inertia), 1e-300))
            windows.append(replace(w, centers=np.sort(np.r_[w.centers, centers]), scale=scale))
        return join_windows(windows, block=data.block)

    def find_free_range(self, data: TorqueWindows) -> tuple[float, float]:
        """Return the least and largest angle [rad] of windows clear of stick with a residual within friction and noise.

        Without windows, the range is (inf, -inf).
        """
        residual, friction, noise = self._compute_residual(data)
        angle = data.samples.position[np.abs(residual) <= 2 * friction + noise]
        return float(angle.min(initial=np.inf)), float(angle.max(initial=-np.inf))

    def _compute_residual(self, data: TorqueWindows) -> tuple[Array, Array, Array]:
        """Return the residual of each window, and bounds of its dry friction and its noise, (R,) [N m] each."""
        equations, windows, model = data.equations(self.terms), data.windows, (self.terms, self.theta, self.covariance)
        noise = np.repeat([w.noise.compute_std(self.inertia) for w in windows], [len(w.centers) for w in windows])
        deviation = np.hypot(noise, compute_deviations(equations.phi, self.covariance))
        friction = np.concatenate([bound_friction(w, *model) for w in windows])
        return equations.y - equations.phi @ self.theta, friction, RESOLUTION.significant * deviation


def count_contacts(data: TorqueWindows) -> int:
    """Return the number of contacts with a stop; a lasting contact counts once per `RESOLUTION.contact`."""
    return sum(len(instants) for instants in list_contact_instants(data))


def list_contact_instants(data: TorqueWindows) -> list[Array]:
    """Return instants of contacts of each entry, as shares of the recording; see `count_contacts` for lasting ones."""
    shares = []
    for w in data.windows:
        period, instants = w.half_width, list[float]()
        for run in np.split(w.stick.centers, np.flatnonzero(np.diff(w.stick.centers) > len(w.kernel) // 2) + 1):
            contact_run = run[np.isin(run, w.centers)]
            instants += contact_run[:: max(1, round(RESOLUTION.contact / period))].tolist()
        shares.append(np.array(instants) / len(w.recording))
    return shares


def bound_friction(w: Windows, terms: Sequence[Term], theta: Array, covariance: Array) -> Array:
    """Return an upper bound of dry friction in each window (R,) [N m], in either direction.

    The bound is the largest value in the window plus `significant` standard errors, without terms with state.
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
    bound = np.abs(rows @ theta) + RESOLUTION.significant * compute_deviations(rows, covariance)
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
