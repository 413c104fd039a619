"""The six schemes online, for one pendulum or for many at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators.measurements import Smoothing
from estimators.online.bank import Bank
from estimators.online.confidence import CLUSTER, Clusters, Wandering
from estimators.online.recursion import SquareRootLeastSquares
from estimators.online.rows import RowMaker
from estimators.online.stream import Stream
from estimators.recursion import PRIOR
from estimators.schemes import SCHEMES, OnlineScheme
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, Term


@dataclass(frozen=True, eq=False)
class Estimates:
    """What is known of B pendulums by S schemes after a sample.

    Attributes:
        index: of the newest sample that is used, counted from 0; negative while too few have come in (B,).
        time: of that sample: the measurement must be smoothed, and stick be ruled out, on both sides of it (B,) [s].
        theta: (B, S, P) in the order of the terms' columns.
        error: a-priori prediction errors, 0 where the equation was not used (B, S) [the scheme's unit].
        usable: which equations were used (B, S).
        regressor: phi of the torque balance at the instant, 0 in stick (B, P).
        root: factor of P (B, S, P, P).
        judge: what turns P into a covariance.
    """

    index: Index
    time: Array
    theta: Array
    error: Array
    usable: Mask
    regressor: Array
    root: Array
    judge: Callable[[Array], Array]

    @cached_property
    def P(self) -> Array:
        """The recursion's covariance for unit noise (B, S, P, P)."""
        return self.root @ self.root.swapaxes(-1, -2)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of theta, honest under correlated errors (B, S, P, P); computed when it is asked for."""
        return self.judge(self.P)


class SchemeEstimate(Mapping[str, Any]):
    """What one scheme knows, by name; looked up when it is asked for, as few steps are looked at.

    theta (P,), covariance (P, P) and prediction_error of one pendulum, or with a first axis over all.
    """

    __slots__ = ("_now", "_pendulum", "_scheme", "units")

    _parts: ClassVar[dict[str, str]] = {"theta": "theta", "covariance": "covariance", "prediction_error": "error"}

    def __init__(self, now: Estimates, scheme: int, pendulum: int | slice, units: Mapping[str, str]) -> None:
        """Take all estimates, which of them are meant, and the units of the parameters by name, in order."""
        self._now, self._scheme, self._pendulum, self.units = now, scheme, pendulum, units

    def __getitem__(self, name: str) -> Any:
        return getattr(self._now, self._parts[name])[self._pendulum, self._scheme]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SchemeEstimate) and all(np.array_equal(self[name], other[name]) for name in self)

    __hash__ = None  # type: ignore[assignment]  # as of any mapping


class SchemeEstimates(dict[str, SchemeEstimate]):
    """What several schemes know, by id; a notebook shows it as a table."""

    def _repr_html_(self) -> str:
        from estimators.notebook import show_estimates  # only a notebook asks for it

        return show_estimates(self)


class OnlineEstimator:
    """Recursive least squares by any of the schemes, one sample per step.

    What comes out is what the schemes' `regression` and `history` give for the whole recording, a few samples later:
    `delay` is the smoothing's reach and the longest guard around stick. Terms with memory follow their own state
    equation, which differs from the offline trace by what happens within a sample.
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        schemes: Sequence[OnlineScheme] = SCHEMES,
        *,
        batch: int = 1,
        smoothing: Smoothing | None = None,
        prior: float = PRIOR,
        forgetting: float = 1.0,
        random_walk: float | Sequence[float] = 0.0,
        reset_every: float | None = None,
        settle: float = 0.0,
    ) -> None:
        """Make the estimator.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their shape parameters set.
            schemes: which to run.
            batch: number B of pendulums.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            prior: P(0) on the diagonal.
            forgetting: factor lambda, once for every equation; 1 remembers all.
            random_walk: by which the parameters may wander, as a share of their value [1/sqrt(s)], or for each in its
                own unit [unit/sqrt(s)]; 0 if they stand still.
            reset_every: time after which P starts anew from P(0), the estimates being kept [s].
            settle: time from the start whose equations are left out [s].

        Raises:
            ValueError: if a number is out of its range, a filter is too fast for the rate, or the terms have no
                parameter.
        """
        walk = np.asarray(random_walk, dtype=float)
        for what, values in (("random_walk", walk), ("settle", np.asarray(settle))):
            if not ((values >= 0) & (values < np.inf)).all():
                raise ValueError(f"{what} cannot be {values}: give zero or a positive number")
        if not 0 < rate < np.inf or (reset_every is not None and not reset_every > 0):
            raise ValueError(f"rate ({rate:g}) and reset_every ({reset_every}) have to be positive")
        columns = [column for term in terms for column in term.columns]
        self.names = tuple(column.name for column in columns)
        self.units = {column.name: column.unit for column in columns}
        if not self.names or not schemes:
            raise ValueError("nothing to estimate: name terms with linear parameters, and schemes")
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"a term is named twice: {', '.join(self.names)}")
        if walk.shape not in ((), (len(self.names),)):
            raise ValueError(f"random_walk has shape {walk.shape}, give one number or {len(self.names)}")
        self.terms, self.schemes, self.rate, self.batch = tuple(terms), tuple(schemes), rate, batch
        smoothing = smoothing or Smoothing.of_encoder(COUNTS, rate)
        shape, period, parameters = (batch, len(schemes)), 1.0 / rate, len(self.names)
        self._bank = Bank(schemes, parameters, period, batch)
        self._rows = RowMaker(terms, smoothing, self._bank.guards, period, batch)
        self._stream = Stream(smoothing, period, batch)
        self._squares = SquareRootLeastSquares(shape, parameters, prior, forgetting)
        self._clusters = Clusters(shape, parameters, period, forgetting)
        self._wandering = Wandering(shape, period) if walk.any() else None
        self._walk, self._settle = walk, settle
        self._reset_every = None if reset_every is None else max(1, round(reset_every * rate))
        self.delay = smoothing.reach + self._rows.behind  # [samples]

    def reset(self, which: Mask | None = None) -> None:
        """Those pendulums (B,) start anew with the next sample; all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        if not mask.any():
            return
        self._interrupt(mask)
        for part in (self._squares, self._clusters, self._wandering):
            if part is not None:
                part.reset(mask)

    def _interrupt(self, which: Mask) -> None:
        """Those pendulums go on with samples that do not follow the last: smoothing and filters start from rest."""
        for part in (self._stream, self._rows, self._bank):
            part.reset(which)

    def reset_covariance(self, which: Mask | None = None) -> None:
        """Let P of those pendulums (B,) start anew, the estimates being kept."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        self._squares.reset_covariance(mask)
        self._clusters.reset(mask)

    def take(self, time: Array, position: Array, torque: Array) -> Estimates:
        """Take in a sample of every pendulum.

        Args:
            time: (B,) [s].
            position: (B,) [rad], unwrapped.
            torque: applied over the period that ends with this sample (B,) [N m].

        A sample that is not a number is left out, and the estimates stand still until enough have come in again.
        """
        lost = ~np.isfinite(time + position + torque)
        if lost.any():
            self._interrupt(lost)
            time, position, torque = (np.where(lost, 0.0, series) for series in (time, position, torque))
        rows = self._rows.make(self._stream.take(time, position, torque))
        phi, y, usable = self._bank.take(rows)
        if self._settle:
            usable = usable & (rows.index >= self._settle * self.rate)[:, None]
        squares = self._squares
        if self._reset_every is not None:
            due = (rows.index > 0) & (rows.index % self._reset_every == 0)
            if due.any():
                self.reset_covariance(due)
        squares.take(phi, y, usable)
        if self._wandering is not None:
            if self._wandering.take(squares.error, usable):
                self._wander(self._wandering)
        elif self._clusters.take(phi, y, usable):
            self._clusters.close(squares.theta, squares.P)
        regressor = rows.views[0, :-1].T * (rows.clear[0] & (rows.index >= 0))[:, None]
        return self._estimates(rows.index, rows.time, usable, regressor)

    def standing(self) -> Estimates:
        """What is known now, without a further sample."""
        none = np.zeros(self.batch)
        usable = np.zeros((self.batch, len(self.schemes)), dtype=bool)
        return self._estimates(np.full(self.batch, -1), none, usable, np.zeros((self.batch, len(self.names))))

    def after_reset(self, then: Estimates, ended: Mask) -> Estimates:
        """What is known once those pendulums (B,) have been reset, `then` being the estimates before."""
        anew = self.standing()
        return Estimates(
            np.where(ended, anew.index, then.index),
            np.where(ended, anew.time, then.time),
            anew.theta,
            anew.error,
            then.usable & ~ended[:, None],
            np.where(ended[:, None], 0.0, then.regressor),
            anew.root,
            anew.judge,
        )

    def _estimates(self, index: Index, time: Array, usable: Mask, regressor: Array) -> Estimates:
        squares = self._squares
        if self._wandering is not None:
            judge = self._wandering.judge()
        else:
            judge = self._clusters.judge(squares.squares, squares.count, squares.prior)
        return Estimates(index, time, squares.theta, squares.error, usable, regressor, squares.root, judge)

    def _wander(self, wandering: Wandering) -> None:
        """End of a cluster of time: the parameters may have moved since the last."""
        wandering.close()
        step = self._walk if self._walk.ndim else self._walk * self._squares.theta
        self._squares.widen(step**2 * CLUSTER / np.maximum(wandering.noise, np.finfo(float).tiny)[..., None])
