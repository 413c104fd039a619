"""The six schemes online, for one pendulum, a batch of pendulums, or a linked mechanism."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from estimators.online.arm_stream import make_stream
from estimators.online.confidence import ClusterCovariance
from estimators.online.estimates import Estimates
from estimators.online.joint_state import JointFilters, JointState
from estimators.online.noise_bias import NoiseBias
from estimators.online.recursion import RECURSIONS, SQUARE_ROOT
from estimators.online.settings import ONLINE
from estimators.online.stream import check_rate
from estimators.regression.recursive import PRIOR
from estimators.schemes.six import SCHEMES, Scheme, scheme
from estimators.signals.differentiation import STILL, estimate_position_noise
from estimators.signals.measurements import Smoothing, compute_encoder_noise
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Term


class SampleBuffer:
    """Samples of N pendulums or joints, until their encoder noise can be estimated.

    Attributes:
        samples: time, position and torque of each sample.
    """

    def __init__(self) -> None:
        """Create an empty buffer."""
        self.samples: deque[tuple[Array, Array, Array]] = deque(maxlen=ONLINE.stream.longest)
        self._n_moving: Array = np.zeros(1)  # number of samples in motion (N,)

    def take(self, time: Array, position: Array, torque: Array) -> float | None:
        """Add a sample: time, position and torque of N pendulums, or of a linked mechanism.

        Returns:
            The largest standard deviation of the position noise [rad]; None before the motion suffices.
        """
        if self.samples:
            self._n_moving = self._n_moving + (np.abs(position - self.samples[-1][1]) > STILL).ravel()
        self.samples.append((time.copy(), position.copy(), torque.copy()))
        if np.max(self._n_moving) < ONLINE.stream.noise:
            return None
        series = np.array([np.ravel(positions) for _, positions, _ in self.samples]).T  # (N, K)
        moving = series[self._n_moving >= ONLINE.stream.moving_share * ONLINE.stream.noise]
        return max(estimate_position_noise(positions[np.isfinite(positions)]) for positions in moving)


class OnlineEstimator:
    """Recursive least squares by any of the schemes, one sample per step.

    The estimates equal those of `Scheme.regression` and `Scheme.history` for a whole recording, `delay` samples later:
    the reach of the smoothing plus the longest guard around stick. Terms with memory follow their own state equation,
    which differs from the offline trace within a sample. For a pendulum, the bias by encoder noise is subtracted, and
    its uncertainty is part of the covariance.

    The smoothing depends on the noise of the encoder. Without `counts`, `position_noise` and `smoothing`, the noise is
    estimated from the first 256 samples of motion. The estimates begin after them, and use them.
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        schemes: Sequence[Scheme | JointState] = SCHEMES,
        *,
        batch: int = 1,
        counts: int | None = None,
        smoothing: Smoothing | None = None,
        prior: float = PRIOR,
        forgetting: float = 1.0,
        recursion: str = SQUARE_ROOT,
        position_noise: float | None = None,
    ) -> None:
        """Make the estimator.

        Args:
            rate: samples per second [Hz].
            terms: terms of the model, with values of nonlinear parameters; links come first.
            schemes: schemes to run; a `JointState`, for pendulums only, is the last in the estimates.
            batch: number B of pendulums.
            counts: encoder counts per turn, which set smoothing and `position_noise`; 0 measures exactly.
            smoothing: smoothing of the measurement; replaces that by `counts`.
            prior: P(0) on the diagonal.
            forgetting: factor lambda per equation; 1 for no forgetting.
            recursion: "SquareRootLeastSquares", which updates all regressions together, or "KalmanFilter" of filterpy,
                which updates each separately and gives the same estimates.
            position_noise: standard deviation of the measured position [rad]; replaces `counts`.

        Raises:
            ValueError: if a number is out of its range, a filter is too fast for the rate, or the terms have no
                parameter.
        """
        check_rate(rate)
        self.units = _collect_units(terms, schemes)
        self.names = tuple(self.units)
        joint, regressions = _split_schemes(schemes)
        self.schemes: tuple[Scheme | JointState, ...] = regressions if joint is None else (*regressions, joint)
        self.terms, self.rate, self.batch = tuple(terms), rate, batch
        # the joint state starts from the last regression
        self._regression_schemes = regressions if joint is None else (*regressions, scheme("hamiltonian"))
        shape, parameters = (batch, len(self._regression_schemes)), len(self.names)
        noise = compute_encoder_noise(counts) if position_noise is None and counts is not None else position_noise
        self._buffer: SampleBuffer | None = None  # until the noise is known
        known_noise = noise or 0.0
        if noise is None:
            noise = compute_encoder_noise(COUNTS)
            self._buffer = SampleBuffer() if smoothing is None else None
        self._recursion = find("recursion", recursion, RECURSIONS)(shape, parameters, prior, forgetting)
        self._start_stream(smoothing or Smoothing.from_noise(noise, rate, is_precise=True), known_noise)
        has_known = any(column.is_known for term in terms for column in term.columns)
        direction = None if has_known or "coulomb" not in self.names else self.names.index("coulomb")
        period = 1.0 / rate / len(self._stream.joints)
        self._clusters = ClusterCovariance(shape, parameters, period, forgetting, direction)
        self._noise_bias = NoiseBias(shape, parameters, forgetting) if self._stream.joints == ("",) else None
        self._joint: JointFilters | None = None
        if joint is not None:
            if self._stream.joints != ("",):
                raise ValueError(f"{joint.id} is a scheme of one joint: use the six schemes for an arm")
            self._joint = JointFilters(terms, 1.0 / rate, batch, noise, forgetting)
        self._estimates = self._make_initial_estimates()

    @property
    def delay(self) -> int:
        """Return the delay of the estimates [samples]; it depends on the smoothing."""
        return self._stream.delay

    def reset(self, which: Mask | None = None) -> None:
        """Restart pendulums (B,) with their next sample; all by default."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        if not mask.any():
            return
        self._stream.reset(mask)
        self._buffer = self._buffer and SampleBuffer()
        for part in (self._recursion, self._clusters, self._noise_bias, self._joint):
            if part is not None:
                part.reset(mask)
        if mask.all():
            self._estimates = self._make_initial_estimates()

    def take(self, time: Array, position: Array, torque: Array) -> Estimates:
        """Add a sample of every pendulum, or of a linked mechanism, and return the estimates.

        The estimates are `delay` samples old; their index is -1 until the encoder noise is known. With links, they
        change every 50 ms. After a sample that is not finite, or a gap in time, the estimates are held until samples
        suffice. For rows of a recording, with torque that acts until the next row, use `stream_recording`.

        Args:
            time: (B,) [s].
            position: (B,) [rad], unwrapped; (1, n) for n joints with links.
            torque: applied over the period that ends with the sample, with the shape of `position` [N m].
        """
        if self._buffer is not None:
            return self._estimate_noise(self._buffer, time, position, torque)
        recursion, sample = self._recursion, None
        for sample in self._stream.take(time, position, torque):
            recursion.take(sample.equations[..., :-1], sample.equations[..., -1], sample.usable)
            if self._noise_bias is not None:
                self._noise_bias.take(sample.copies, sample.usable)
            if self._clusters.take(sample.equations, sample.usable):
                self._clusters.close_cluster(recursion.state)
        if sample is not None:
            self._estimates = self._make_estimates(sample.place, sample.time, sample.usable, sample.regressor)
            if self._joint is not None:
                self._joint.take(time, position, torque, sample.restarted, self._estimates)
                self._estimates = self._joint.insert_estimates(self._estimates)
        return self._estimates

    def restart_estimates(self, before: Estimates, is_reset: Mask, last_time: Array) -> Estimates:
        """Return current estimates for the sample of the estimates `before` a reset of pendulums (B,).

        For these pendulums, the index is -1, no equation is used, and the time is relative to `last_time` (B,) [s].
        """
        column = is_reset[:, None]
        index, time = np.where(is_reset, -1, before.index), np.where(is_reset, before.time - last_time, before.time)
        regressor = None if before.regressor is None else np.where(column, 0.0, before.regressor)
        after = self._make_estimates(index, time, before.usable & ~column, regressor)
        return after if self._joint is None else self._joint.insert_estimates(after)

    def _start_stream(self, smoothing: Smoothing, noise: float) -> None:
        """Start a stream of equations with a smoothing and a noise of the position [rad]."""
        schemes, period = self._regression_schemes, 1.0 / self.rate
        self._stream = make_stream(self.terms, schemes, smoothing, period, self.batch, noise)

    def _estimate_noise(self, buffer: SampleBuffer, time: Array, position: Array, torque: Array) -> Estimates:
        """Add a sample to the buffer; once the encoder noise is known, take all samples of the buffer.

        Until then, the estimates have index -1, and no equation is used.
        """
        for equations in self._stream.take(time, position, torque):  # the stream checks the sample
            regressor = None if equations.regressor is None else np.zeros_like(equations.regressor)
            self._estimates = self._make_estimates(
                np.full(self.batch, -1), equations.time, np.zeros_like(equations.usable), regressor
            )
        if (noise := buffer.take(time, position, torque)) is not None:
            self._buffer = None
            self._start_stream(Smoothing.from_noise(noise, self.rate, is_precise=True), noise)
            if self._joint is not None:
                self._joint.position_noise = noise
            for sample in buffer.samples:
                self.take(*sample)
        return self._estimates

    def _make_initial_estimates(self) -> Estimates:
        """Return the estimates before the first sample."""
        return self._make_estimates(np.full(self.batch, -1), np.zeros(self.batch), self._recursion.count > 0, None)

    def _make_estimates(self, index: Index, time: Array, usable: Mask, regressor: Array | None) -> Estimates:
        """Collect the current theta and errors of the recursions with the index, time and regressor of their sample."""
        state = self._recursion.state
        values = index, time, state, self._recursion.error, usable, regressor, self._clusters.make_covariance(state)
        return Estimates(*values, *([self._noise_bias.make_correction(state)] if self._noise_bias else []))


def _collect_units(terms: Sequence[Term], schemes: Sequence[object]) -> dict[str, str]:
    """Collect the units of the parameters by name."""
    columns = [column for term in terms for column in term.columns]
    if not columns or not schemes:
        raise ValueError("nothing to estimate: name terms with linear parameters, and schemes")
    units = {column.name: column.unit for column in columns}
    if len(units) < len(columns):
        raise ValueError(f"a term is named twice: {', '.join(column.name for column in columns)}")
    return units


def _split_schemes(schemes: Sequence[Scheme | JointState]) -> tuple[JointState | None, tuple[Scheme, ...]]:
    """Split schemes into the joint state, or None, and the others."""
    joint = next((entry for entry in schemes if isinstance(entry, JointState)), None)
    others = tuple(entry for entry in schemes if not isinstance(entry, JointState))
    for entry in others:
        if not isinstance(entry, Scheme):
            raise ValueError(f"{entry.id} needs a whole recording: use a `Scheme`")
    return joint, others
