"""The six schemes online, for one pendulum, for many at once, or for an arm."""

from collections.abc import Sequence

import numpy as np

from estimators.online.arm_stream import stream_of
from estimators.online.clock import checked_rate
from estimators.online.confidence import Clusters, Recursion, Wandering
from estimators.online.encoder import EncoderNoise
from estimators.online.estimates import Estimates
from estimators.online.joint_state import JointFilters, JointState
from estimators.online.kalman import KalmanLeastSquares
from estimators.online.recursion import SquareRootLeastSquares
from estimators.online.stream import Taken
from estimators.regression.recursive import PRIOR
from estimators.schemes.six import SCHEMES, Scheme, scheme
from estimators.signals.measurements import Smoothing, of_steps
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Term

OURS = "SquareRootLeastSquares"
RECURSIONS: dict[str, type[Recursion]] = {
    OURS: SquareRootLeastSquares,
    "KalmanFilter": KalmanLeastSquares,
}


class OnlineEstimator:
    """Recursive least squares by any of the schemes, one sample per step.

    What comes out is what the schemes' `regression` and `history` give for the whole recording, a few samples later:
    `delay` is the smoothing's reach and the longest guard around stick. Terms with memory follow their own state
    equation, which differs from the offline trace by what happens within a sample.

    The smoothing follows from the noise of the encoder. Without `counts`, `position_noise` and `smoothing`, the first
    64 samples of motion teach it, and the estimates begin after them.
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
        random_walk: float | Sequence[float] = 0.0,
        recursion: str = OURS,
        position_noise: float | None = None,
    ) -> None:
        """Make the estimator.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their nonlinear parameters set; of an arm its links first (`arm_base(body)`).
            schemes: which to run; a `JointState` is told after the others, of a pendulum.
            batch: number B of pendulums.
            counts: of the encoder per turn, from which smoothing and `position_noise` follow; 0 measures exactly.
            smoothing: of the measurement, in the place of what follows from the noise.
            prior: P(0) on the diagonal.
            forgetting: factor lambda, once for every equation; 1 remembers all.
            random_walk: of the parameters, relative to their value [1/sqrt(s)], or for each in its own unit
                [unit/sqrt(s)]; 0 if they are constant.
            recursion: what solves the regressions: "SquareRootLeastSquares", all at once, or "KalmanFilter",
                filterpy's, one after the other; they find the same.
            position_noise: standard deviation of the measured position [rad], in the place of `counts`.

        Raises:
            ValueError: if a number is out of its range, a filter is too fast for the rate, or the terms have no
                parameter.
        """
        checked_rate(rate)
        self.units = _checked_units(terms, schemes)
        self.names = tuple(self.units)
        walk = _checked_walk(random_walk, self.names)
        joint, told = _checked_schemes(schemes)
        self.schemes: tuple[Scheme | JointState, ...] = told if joint is None else (*told, joint)
        self.terms, self.rate, self.batch = tuple(terms), rate, batch
        # from a regression the joint state starts
        self._run = told if joint is None else (*told, scheme("hamiltonian"))
        shape, period, parameters = (batch, len(self._run)), 1.0 / rate, len(self.names)
        noise = of_steps(counts) if position_noise is None and counts is not None else position_noise
        self._learner: EncoderNoise | None = None
        if noise is None:
            noise = of_steps(COUNTS)
            if smoothing is None:
                self._learner = EncoderNoise()
        self._has_learnt = False
        self._skipped = np.zeros(batch, dtype=np.intp)  # samples before the first that the stream has taken
        self._smooth(smoothing or Smoothing.of_noise(noise, rate))
        period /= len(self._stream.joints)  # between equations
        self._squares = find("recursion", recursion, RECURSIONS)(shape, parameters, prior, forgetting)
        self._clusters: Clusters | Wandering = Clusters(shape, parameters, period, forgetting)
        if walk.any():
            self._clusters = Wandering(shape, period, walk)
        self._joint: JointFilters | None = None
        if joint is not None:
            if self._stream.joints != ("",):
                raise ValueError(f"{joint.id} is a scheme of one joint: an arm takes the six")
            self._joint = JointFilters(joint.torque_noise, terms, period, batch, noise, forgetting, walk)
        self._now = self._nothing()

    @property
    def delay(self) -> int:
        """Samples by which the estimates are behind; it follows from the smoothing."""
        return self._stream.delay

    def reset(self, which: Mask | None = None) -> None:
        """Those pendulums (B,) start anew with the next sample; all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        if not mask.any():
            return
        self._stream.reset(mask)
        self._skipped[mask] = 0
        for part in (self._squares, self._clusters, self._joint):
            if part is not None:
                part.reset(mask)
        if mask.all():
            self._now = self._nothing()

    def take(self, time: Array, position: Array, torque: Array) -> Estimates:
        """Take in a sample of every pendulum, or of an arm, whose estimates are renewed every 50 ms.

        Args:
            time: (B,) [s].
            position: (B,) [rad], unwrapped; of an arm (1, n).
            torque: applied over the period that ends with this sample, alike [N m].

        After a sample that is not a number, or a gap in time, the estimates are held until enough samples have come in.
        """
        if self._learner is not None:
            return self._learn(self._learner, time, position, torque)
        squares, taken = self._squares, None
        for taken in self._stream.take(time, position, torque):
            squares.take(taken.phi, taken.y, taken.usable)
            if self._clusters.take(taken.equations, squares.error, taken.usable):
                self._clusters.close(squares)
        if taken is not None:
            place = self._place(taken) if self._has_learnt else taken.place
            self._now = self._regressions(place, taken.time, taken.usable, taken.regressor)
            if self._joint is not None:
                self._joint.take(time, position, torque, taken.anew, self._now)
                self._now = self._joint.beside(self._now)
        return self._now

    def after_reset(self, then: Estimates, ended: Mask, last: Array) -> Estimates:
        """Estimates after a reset of those pendulums (B,), given the estimates `then` of samples at times `last`."""
        none = ended[:, None]
        index, time = np.where(ended, -1, then.index), np.where(ended, then.time - last, then.time)
        regressor = None if then.regressor is None else np.where(none, 0.0, then.regressor)
        now = self._regressions(index, time, then.usable & ~none, regressor)
        return now if self._joint is None else self._joint.beside(now)

    def _smooth(self, smoothing: Smoothing) -> None:
        """Begin a stream of equations."""
        self._stream = stream_of(self.terms, self._run, smoothing, 1.0 / self.rate, self.batch)

    def _learn(self, learner: EncoderNoise, time: Array, position: Array, torque: Array) -> Estimates:
        """Take in samples that teach the noise of the encoder; nothing is estimated from them."""
        for taken in self._stream.take(time, position, torque):  # a sample that does not fit is refused
            self._skipped[taken.anew] = 0
            none, row = np.zeros_like(taken.usable), taken.regressor
            row = None if row is None else np.zeros_like(row)
            self._now = self._regressions(np.full(self.batch, -1), taken.time, none, row)
        if (noise := learner.take(position)) is None:
            self._skipped += 1
            return self._now
        self._learner, self._has_learnt = None, True
        self._smooth(Smoothing.of_noise(noise, self.rate))
        self._stream.take(time, position, torque)
        if self._joint is not None:
            self._joint.position_noise = noise
        return self._now

    def _place(self, taken: Taken) -> Index:
        """Index of a sample in the whole run of each pendulum, including samples before the stream began (B,)."""
        self._skipped[taken.anew] = 0
        return np.where(taken.place < 0, taken.place, taken.place + self._skipped)

    def _nothing(self) -> Estimates:
        """What is known before any sample is."""
        return self._regressions(np.full(self.batch, -1), np.zeros(self.batch), self._squares.count > 0, None)

    def _regressions(self, index: Index, time: Array, usable: Mask, regressor: Array | None) -> Estimates:
        squares, judge = self._squares, self._clusters.judge(self._squares)
        return Estimates(index, time, squares.theta, squares.error, usable, regressor, squares.spread(), judge)


def _checked_units(terms: Sequence[Term], schemes: Sequence[object]) -> dict[str, str]:
    """Units of the parameters, by name."""
    columns = [column for term in terms for column in term.columns]
    if not columns or not schemes:
        raise ValueError("nothing to estimate: name terms with linear parameters, and schemes")
    units = {column.name: column.unit for column in columns}
    if len(units) < len(columns):
        raise ValueError(f"a term is named twice: {', '.join(column.name for column in columns)}")
    return units


def _checked_schemes(schemes: Sequence[Scheme | JointState]) -> tuple[JointState | None, tuple[Scheme, ...]]:
    """The filter of the joint's state among the schemes, if there is one, and the others."""
    joint = next((one for one in schemes if isinstance(one, JointState)), None)
    others = tuple(one for one in schemes if not isinstance(one, JointState))
    for one in others:
        if not isinstance(one, Scheme):
            raise ValueError(f"{one.id} only works on whole recordings: to run online it has to be a `Scheme`")
    return joint, others


def _checked_walk(random_walk: float | Sequence[float], names: Sequence[str]) -> Array:
    """Random walk of the parameters as an array, () or (P,)."""
    walk = np.asarray(random_walk, dtype=float)
    if not ((walk >= 0) & (walk < np.inf)).all():
        raise ValueError(f"random_walk cannot be {random_walk}: give zero or a positive number")
    if walk.shape not in ((), (len(names),)):
        raise ValueError(f"random_walk has shape {walk.shape}: give one number, or one for each of {', '.join(names)}")
    return walk
