"""Rows of the torque channel: windows of recordings, and columns of a model or of nearly any law of the joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from estimators.checks.alignment import make_moved_torque
from estimators.checks.settings import CHECKS
from estimators.decisions.criterion import ColumnLimits, Criterion
from estimators.regression.balance import place_columns
from estimators.regression.least_squares import project_out
from estimators.signals.channel import REACH, Channel
from estimators.weak_form.columns import is_torque_dependent
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.preparation import prepare_windows, smooth_laws
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows
from estimators.weak_form.window_noise import scale_by_jumps
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Column, Term
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.joints import find_mechanism, list_base_terms
from pendulum_env.physics.potential import Cogging
from pendulum_env.recording import Recording

LawsOfRows = Sequence[tuple[slice, Column]]  # columns that depend on the torque, with their rows
CHANNEL = CHECKS.channel
# friction proportional to the weight of the joint, and to the known loads [per N m]
OWN_FRICTION = Column("own", "1", dry=lambda x: np.abs(np.sin(x.position)))
LOAD_FRICTION = Column("hung", "1", dry=lambda x: np.abs(x.load.gravity * np.sin(x.position) - x.load.torque))
# friction by the torque of the motor, |tau| sgn q', and errors of its gain, tau^2 and tau^3, on all rows
MOTOR_FRICTION = (slice(None), Column("motor", "1", dry=lambda x: np.abs(x.torque)))
FRICTION_SLOPE = Column("slope", "1", dry=lambda x: np.sign(x.torque))  # its derivative by that torque
NONLINEAR_GAIN: LawsOfRows = [
    MOTOR_FRICTION,
    (slice(None), Column("square", "1", force=lambda x: x.torque**2)),
    (slice(None), Column("cube", "1", force=lambda x: x.torque**3)),
]
ANGLE_LAWS = [Cogging(float(order)) for order in range(1, 49)]  # waves of the angle


def make_channel_rows(
    recordings: Sequence[Recording], terms: Sequence[Term], latest: float, criterion: Criterion, is_model: bool = False
) -> tuple[TorqueRows, Array, LawsOfRows]:
    """Make the rows of recordings, clear of the ends of segments under every delay up to `latest` [s].

    Args:
        recordings: with known torque.
        terms: effects of the joint; with links all terms of the model, the links first. Fixed columns are left out.
        latest: largest delay [s].
        criterion: length of a block, and limits of driven and braked motion.
        is_model: whether the base model and `terms` are the only columns, without those of other laws.

    Returns:
        Rows, columns of motion alone (R, P), and columns of `terms` that depend on the torque.

    Raises:
        IdentificationError: if too little of the motion is clear of stick.
    """
    mechanism, margin = find_mechanism(terms), latest + 2.0 / min(recording.rate for recording in recordings)
    if mechanism.can_simulate:
        data = prepare_windows(recordings, margin=margin, block=criterion.block)
    else:
        data = prepare_arm(recordings, terms[:1], margin)
        weights = TorqueRows(data).fits.weights(list_base_terms(mechanism))
        data = replace(data, weights=weights, block=criterion.block)
    joints = [(data.locate_rows(at), data.part(at)) for at in data.joints]
    base = BASE if mechanism.can_simulate else ()
    parts = [
        (rows, part.columns([law])[0][0])
        for rows, part in joints
        for law in (base if is_model else _make_smooth_laws(part))
    ]
    of_torque = list[tuple[slice, Column]]()
    for term in (term for term in terms if not term.fixed):
        rows = data.locate_rows(term.at)
        if is_torque_dependent(term):
            of_torque += [(rows, column) for column in term.columns]
        else:
            parts.append((rows, data.columns([term])[0][0]))
    has_loads = mechanism.can_simulate and not is_model
    for friction in (OWN_FRICTION, *list_load_friction(data, criterion.columns)) if has_loads else ():
        averages = data.window_columns.averages
        parts.append((slice(None), averages.column(friction, averages.samples)[:, None]))
    return TorqueRows(data), place_columns(len(data.weights), parts), of_torque


def list_load_friction(data: TorqueWindows, limits: ColumnLimits) -> list[Column]:
    """List friction under the known loads, if these differ; the torque of a brake resembles friction itself."""
    recordings = [w.recording for w in data.windows]
    has_several = len({recording.load for recording in recordings}) > 1
    has_several |= any(recording.has_varying_load for recording in recordings) and not is_brake(data, limits)
    return [LOAD_FRICTION] if has_several and any(w.samples.load for w in data.windows) else []


def is_brake(data: TorqueWindows, limits: ColumnLimits) -> bool:
    """Return whether the load torque opposes the motion in more than `driven_share` of the samples."""
    return compute_driven_share(data, -np.asarray(data.samples.load.torque)) > limits.driven_share


def compute_driven_share(data: TorqueWindows, torque: Array) -> float:
    """Compute the share of samples in which a torque (N,) or () has the direction of the motion."""
    return float(np.mean(torque * data.samples.velocity > 0))


def _make_smooth_laws(data: TorqueWindows) -> tuple[Term, ...]:
    """Make terms that approximate nearly any law of one joint."""
    fast = float(np.percentile(np.abs(data.samples.velocity), 95))
    return (*smooth_laws(data.windows[0]), *(Stribeck(share * fast) for share in CHANNEL.stribeck_shares))


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """Recorded torque under any law of the channel, and columns of the joint.

    Attributes:
        rows: R rows of the torque.
        phi: weighted columns (R, P).
        by_torque: derivatives of the columns by the torque (R, P), not weighted; None: none depends on it.
        is_sampled: whether torque is sampled instead of held.
        joint: joint to which the law applies; empty for all joints.
        latest: largest delay of the search [s].
        criterion: limits of the decisions.
        torques: cache of the weighted torque of all joints by law, shared by rows with the same weights.
    """

    rows: TorqueRows
    phi: Array
    by_torque: Array | None = None
    is_sampled: bool = False
    joint: str = ""
    latest: float = REACH
    criterion: Criterion = Criterion()
    torques: dict[Channel, Array] = field(default_factory=dict)

    @classmethod
    def from_recordings(
        cls,
        recordings: Sequence[Recording],
        terms: Sequence[Term] = (),
        latest: float = REACH,
        criterion: Criterion = Criterion(),
        is_model: bool = False,
    ) -> Self | None:
        """Prepare rows of recordings, see `make_channel_rows`; None if there are too few windows."""
        rows, phi, of_torque = make_channel_rows(recordings, terms, latest, criterion, is_model)
        if len(phi) < CHANNEL.min_equations * phi.shape[1]:
            return None
        fits = cls(rows, phi * rows.data.weights[:, None], latest=latest, criterion=criterion)
        return fits.with_columns_of_torque(of_torque)

    def with_columns(self, columns: Array, by_torque: Array | None = None) -> Self:
        """Return the rows with more columns (R, P), and their derivatives by the torque (R, P)."""
        phi = np.column_stack([self.phi, columns * self.rows.data.weights[:, None]])
        if by_torque is not None:
            before = np.zeros_like(self.phi) if self.by_torque is None else self.by_torque
            return replace(self, phi=phi, by_torque=np.column_stack([before, by_torque]))
        return replace(self, phi=phi)

    def with_motor_friction(self) -> Self:
        """Return the rows with friction by the recorded torque of the motor, and its derivative by that torque."""
        averages = self.rows.data.window_columns.averages
        laws = MOTOR_FRICTION[1], FRICTION_SLOPE
        return self.with_columns(*(averages.column(law, averages.samples)[:, None] for law in laws))

    def with_columns_of_torque(self, laws: LawsOfRows) -> Self:
        """Return the rows with columns that depend on the fitted torque, each on some rows.

        The torque is that with the delay `start`, at the middle of each window. Each of `CHANNEL.torque_iterations`
        replaces the columns by those of the last fit.
        """
        fitted_rows, data, torque = self, self.rows.data, self.compute_torque(self.start)
        for _ in range(CHANNEL.torque_iterations if laws else 0):
            fitted = (torque - fitted_rows.compute_residual(torque)) / data.weights
            fitted = fitted + data.torque.recorded - data.torque.net
            x = replace(data.samples, torque=fitted)
            series = ((rows, np.asarray(law.force(x) + law.dry(x) * np.sign(x.velocity))) for rows, law in laws)
            columns = [(rows, column[rows, None]) for rows, column in series]
            fitted_rows = self.with_columns(place_columns(len(fitted), columns))
        return fitted_rows

    def select_joint(self) -> Self:
        """Return the rows with a law of the joint whose delay explains most; unchanged if that of all explains more."""
        joints, most = self.rows.data.joints, (1 - self.criterion.equal_error_share) * self.compute_misfit(self.start)
        of_joints = [replace(self, joint=joint) for joint in joints if len(joints) > 1]
        misfits = [rows.compute_misfit(rows.start) for rows in of_joints]
        return of_joints[int(np.argmin(misfits))] if min(misfits, default=np.inf) <= most else self

    def with_jump_errors(self) -> Self:
        """Return the rows with weights for jumps of sampled torque: their time within a sample is unknown."""
        scales = []
        for w in self.rows.data.windows:
            moved = make_moved_torque(w.recording, np.array([0.0, 1.0, 0.0]), True, self.criterion)
            scale = scale_by_jumps(replace(w.recording, moved=moved), w.kernel, w.noise.torque)
            scale = scale if self.joint in ("", w.at) else None
            scales.append(np.ones(len(w.centers)) if scale is None else scale[w.centers])
        factor = np.concatenate(scales)
        data = replace(self.rows.data, weights=self.rows.data.weights * factor)
        return replace(self, rows=TorqueRows(data), phi=self.phi * factor[:, None], torques={})

    def with_drift(self) -> Self:
        """Return the rows with parameters of the base model that change linearly along each recording."""
        time_share = np.concatenate([2 * w.centers / len(w.recording) - 1 for w in self.rows.data.windows])
        return self.with_columns(self.rows.data.equations(BASE).phi * time_share[:, None])

    def with_angle_columns(self) -> Self:
        """Return the rows with columns of the angle, of all orders that the number of equations allows."""
        count = (len(self.phi) // CHANNEL.min_equations - self.phi.shape[1]) // 2
        return self if count < 1 else self.with_columns(self.rows.data.equations(ANGLE_LAWS[:count]).phi)

    @cached_property
    def span(self) -> Array:
        """Orthonormal basis of the columns (R, P)."""
        sizes = np.linalg.norm(self.phi, axis=0)
        sizes[sizes == 0] = np.inf  # squares of a column below 1e-160 are zero
        basis, singular, _ = np.linalg.svd(self.phi / sizes, False)
        return np.asarray(basis[:, singular > 1e-9 * singular[0]])

    @cached_property
    def start(self) -> Channel:
        """Best of delays from -`REACH` to `latest`, `CHANNEL.starts` per second, without a filter.

        The law is possible, see `is_possible`.
        """
        delays = np.linspace(-REACH, self.latest, round(CHANNEL.starts * (REACH + self.latest)))
        return min(filter(self.is_possible, map(self.make_law, delays)), key=self.compute_misfit)

    @cached_property
    def _inertia(self) -> tuple[Array, float]:
        """Weights (R,) whose product with the weighted torque is the inertia, and its least significant value.

        The inertia is that of the base model of a single joint.
        """
        columns, torque = (
            self.rows.data.equations(BASE).phi * self.rows.data.weights[:, None],
            self.compute_torque(Channel()),
        )
        inverse = np.linalg.pinv(columns)
        rms = float(np.sqrt(np.mean((torque - columns @ (inverse @ torque)) ** 2)))
        return np.asarray(inverse[0]), self.criterion.timing.z_score * rms * float(np.linalg.norm(inverse[0]))

    def is_possible(self, law: Channel) -> bool:
        """Return whether the torque stays in the windows, and the inertia of a joint whose torque acts late.

        A law that moves the torque out of the windows, as pulses between rests, leaves little torque and little
        residual. The torque that the columns explain stays above `kept_inertia` of that of the log.

        The speed of a joint with inertia J and viscous friction b follows torque with the lag J/b. A late action can
        imitate this inertia. Torque that switches at reversals is constant in windows clear of them if it acts late
        enough, and friction explains it. The inertia of the base model stays above `kept_inertia` of itself. An inertia
        that is not significant, and joints with links are not tested.
        """
        if self.rows.data.shared_columns:
            return True
        if law.is_late:
            return self._measure_explained(law) >= self.criterion.kept_inertia * self._explained_log
        weights, least = self._inertia
        logged, corrected = (float(weights @ self.compute_torque(each)) for each in (Channel(), law))
        return logged <= least or corrected >= self.criterion.kept_inertia * logged

    def _measure_explained(self, law: Channel) -> float:
        """Return the norm of the weighted torque under a law that the columns explain."""
        return float(np.linalg.norm(self.span.T @ self.compute_torque(law)))

    @cached_property
    def _explained_log(self) -> float:
        """Norm of the weighted torque of the log that the columns explain."""
        return self._measure_explained(Channel())

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return 1.0 / max(w.recording.rate for w in self.rows.data.windows)

    def make_law(self, delay: float, lag: float = 0.0) -> Channel:
        """Return the law of held or of sampled torque with a delay and a lag [s]; zero is not fitted."""
        return Channel(float(delay), float(lag), self.is_sampled)

    def compute_torque(self, law: Channel) -> Array:
        """Return the weighted acting torque (R,) of the windows without that of known loads, cached in `torques`."""
        if law not in self.torques:
            data, loads = self.rows.data, self.rows.data.torque.net - self.rows.data.torque.recorded
            moved = [w.averages.narrow @ _average_acting_torque(w.recording, law) for w in data.windows]
            self.torques[law] = (np.concatenate(moved) + loads) * data.weights
        if not self.joint or law == Channel():
            return self.torques[law]
        torque, rows = self.compute_torque(Channel()).copy(), self.rows.data.locate_rows(self.joint)
        torque[rows] = self.torques[law][rows]
        return torque

    def compute_residual(self, torque: Array) -> Array:
        """Return the residual of a weighted torque (R, ...) on the columns."""
        return project_out(self.span, torque)

    def compute_misfit(self, law: Channel) -> float:
        """Compute the norm of the weighted residual under a law."""
        return float(np.linalg.norm(self.compute_residual(self.compute_torque(law))))


def _average_acting_torque(recording: Recording, law: Channel) -> Array:
    """Return the acting torque of a recording (N,) under the triangle about each sample, see `Channel`."""
    segments = (recording.torque[rows] for rows in recording.segment_slices)
    return np.concatenate([law.average_torque(torque, 1.0 / recording.rate) for torque in segments])
