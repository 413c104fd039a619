"""Whether a model still predicts, sample by sample: a value changed, or the structure is wrong, and where.

A recursion, whose parameters may wander slowly, predicts rows before it sees them. How large its errors are in a block
of time, as the log of their mean square, is learnt while the model holds; in standard deviations of that, errors that
are larger are evidence (`usual`, `evidence`).

Rows say nothing of a joint that sticks or turns. There, the model itself is moved on and compared (`turns`), and what
it misses is judged alike: friction may change where nothing else does.

After an alarm, the model is fitted anew to what came since the change (`change`). If its errors are then as they were,
values changed, and the fit says which, when and by how much; if they stay larger, no value explains them.

No model of a real machine is complete. What one left unexplained when it was calibrated is how things are: the watch
tells of changes, `diagnose` what a model lacks from the start.

Source: Basseville and Nikiforov, Detection of Abrupt Changes, 1993, chapters 2 and 5.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from estimators.online.binning import BLOCK, Bin, Binner
from estimators.online.change import Known, place_of
from estimators.online.evidence import HOUR, Evidence, threshold_of
from estimators.online.recursion import SquareRootLeastSquares
from estimators.online.rows import POSITION, TIME, VELOCITY
from estimators.online.turns import HALF, Mover, TurnFinder, Turns
from estimators.online.usual import Usual
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, Term

WALK = 0.003  # of each parameter, by which it may wander [1/sqrt(s)]
LEAST = 0.004  # of the RMS torque, below which errors do not matter
LEARN = 0.5  # of the time to calibrate, after which it is learnt how large errors are
KEPT = 10.0  # [s] of motion, that a change is judged from,
KEPT_TURNS = 24  # and turns
FEWEST = 0.5  # [s] of motion since a change, before which its kind is not judged
SURE = 2.5  # [s] of motion, after which what a new fit explains is called a value
KIND = 5.0  # standard errors by which errors of a new fit exceed what they were, to be called structure
ROWS, TURNS = 0, 1  # the challengers


@dataclass(frozen=True)
class Verdict:
    """What a watch says of one pendulum.

    Attributes:
        kind: "calibrating", "predicts", "changed" (it is not clear yet how), "value" or "structure".
        since: time of the change [s]; None while there is none.
        score: evidence that the model no longer predicts [nat].
        threshold: of an alarm [nat].
        parameter: name of the parameter that changed most surely; empty if none has.
        changes: change and standard error of each parameter that changed, surest first, in its unit.
        where: of "structure", the range of position, velocity or torque in which errors are largest, in SI units.
        error: root mean square error now, of the refitted model once there is a change [N m]; None while calibrating.
        alarms: so far.
    """

    kind: str
    since: float | None = None
    score: float = 0.0
    threshold: float = 0.0
    parameter: str = ""
    changes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    where: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    error: float | None = None
    alarms: int = 0


class Watch:
    """Watches B pendulums, one sample of each per step.

    Attributes:
        each: monitors, one a pendulum.
        threshold: of an alarm [nat].
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        *,
        batch: int = 1,
        smoothing: Smoothing | None = None,
        theta: Sequence[float] | Array | None = None,
        alarms_per_hour: float = 1.0,
        calibrate: float = 5.0,
    ) -> None:
        """Make the watch.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their shape parameters set.
            batch: number B of pendulums.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            theta: parameters of the model, in the order of the columns; None learns them while it calibrates.
            alarms_per_hour: false ones, on average at most, of motion.
            calibrate: time of motion that the parameters, or with `theta` only the size of errors, are learnt from [s].

        Raises:
            ValueError: if a number is out of its range, or theta has another length.
        """
        if not 0 < rate < np.inf:
            raise ValueError(f"the rate cannot be {rate:g} Hz: give a positive number")
        if not 0 < alarms_per_hour < HOUR or not 1 <= calibrate < np.inf:
            raise ValueError(
                f"alarms_per_hour ({alarms_per_hour:g}) has to be positive and below one a second, and calibrate "
                f"({calibrate:g}) a second at least"
            )
        names = tuple(column.name for term in terms for column in term.columns)
        if theta is not None and len(theta) != len(names):
            raise ValueError(f"theta has {len(theta)} values, the model {len(names)}: {', '.join(names)}")
        smoothing, period = smoothing or Smoothing.of_encoder(COUNTS, rate), 1.0 / rate
        self.rate, self.batch = rate, batch
        self._binner = Binner(rate, smoothing, batch, terms)
        length = self._binner.every * period  # of a bin [s]
        self.threshold = threshold_of(alarms_per_hour, min(BLOCK * length, 2 * HALF))
        self._mover = Mover(terms, period)
        late = int(np.ceil(sum(term.delay for term in terms) / period)) + 1
        self._turns = TurnFinder(batch, period, self._binner.delay, late, smoothing.slowest)
        given = None if theta is None else np.asarray(theta, dtype=float)
        self.each = tuple(
            ChangeMonitor(names, length, self._mover, self.threshold, calibrate, given) for _ in range(batch)
        )

    @property
    def said(self) -> tuple[Verdict, ...]:
        """What is said of each."""
        return tuple(one.said for one in self.each)

    def reset(self, which: Mask | None = None) -> None:
        """Those pendulums (B,) start anew with the next sample; all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        self._binner.reset(mask)
        for b in np.flatnonzero(mask):
            self.each[b].reset()

    def accept(self) -> None:
        """All pendulums are now as they shall be: calibrate anew."""
        for one in self.each:
            one.accept()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[Verdict, ...]:
        """Take in a sample of every pendulum, as `OnlineEstimator.take`; returns what is said of each."""
        binner = self._binner
        for one in binner.take(time, position, torque):
            self.each[one.of].take(one)
        if self._mover.ready:
            for b, turn in self._turns.take(time, position, torque, binner.velocity, binner.taken.place).items():
                self.each[b].take_turn(turn)
        return self.said


class _Standing(NamedTuple):
    """The model after so many bins: theta (P,) and the factor of P (P, P)."""

    bins: int
    theta: Array
    root: Array


class ChangeMonitor:
    """Watches one pendulum: bins and turns in, a verdict out.

    Attributes:
        said: the verdict.
    """

    _changed: int | None  # after how many bins
    _evidence: Evidence
    _none: list[_Standing]  # the model as each challenger last had no evidence

    def __init__(
        self, names: Sequence[str], length: float, mover: Mover, threshold: float, calibrate: float, theta: Array | None
    ) -> None:
        """Take the parameters' names, the length of a bin [s], what moves the model, and the rest as `Watch` does."""
        self._names, self._length, self._mover = tuple(names), length, mover
        self._threshold, self._calibrate, self._given = threshold, calibrate, theta
        self._model = SquareRootLeastSquares((1, 1), len(names))
        self.reset()

    def reset(self) -> None:
        """Nothing is known yet."""
        self._model.reset(np.ones(1, dtype=bool))
        self._kept: deque[Bin] = deque(maxlen=max(2, round(KEPT / self._length)))
        self._turns: deque[Turns] = deque(maxlen=KEPT_TURNS)
        self._moments = np.zeros(len(self._names) + 1)  # sums of phi^2 and y^2
        self._bins, self._moved, self._begun = 0, 0.0, np.nan
        self._block = 0.0  # squared errors in the block to come
        self._usual = Usual(), Usual(2)  # of rows, and of turns
        self._alarms, self._settled = 0, False  # that it is the structure
        self._compared = False  # with the model that was given
        self._trust()
        self.said = Verdict("calibrating", threshold=self._threshold)

    def accept(self) -> None:
        """The pendulum is now as it shall be: calibrate anew."""
        self._given = None
        self.reset()

    # ------------------------------------------------------------------------------------------------- what comes in

    def take(self, one: Bin) -> None:
        """Predict a bin's row, score the prediction, then learn from it."""
        self._kept.append(one)
        self._bins += 1
        self._begun = one.moved if np.isnan(self._begun) else self._begun
        self._moved = one.moved - self._begun
        self._moments += np.append(one.phi, one.y) ** 2
        # e is predicted to scatter by scale^2 (1 + phi' P phi)
        f = one.phi @ self._model.root[0, 0]
        self._block += float((one.y - one.phi @ self._model.theta[0, 0]) ** 2 / (1.0 + f @ f))
        holds = self._changed is None
        self._model.take(one.phi[None, None], np.full((1, 1), one.y), np.full((1, 1), holds))
        if self._bins % BLOCK:
            return
        square, self._block = self._block / BLOCK, 0.0
        if holds:
            self._count(ROWS, self._sizes_of(square))
            self._wander()
        if self._changed is not None:
            self._judge()
        elif self._calibrated:
            self._predicts(float(np.sqrt(square)))

    def take_turn(self, turn: Turns) -> None:
        """Compare a turn with where the model goes, if it is known a little."""
        self._turns.append(turn)
        if self._changed is None and self._knows:
            missed = self._mover.missed(turn, self._model.theta[0, 0])
            if self._count(TURNS, missed.sizes(self._least)):
                self._judge()

    # -------------------------------------------------------------------------------------------------------- evidence

    @property
    def _knows(self) -> bool:
        """Whether errors begin to be those of the model."""
        return self._moved > LEARN * self._calibrate

    @property
    def _calibrated(self) -> bool:
        """Whether it has been in motion for long enough, whether rows are made of it or not."""
        return self._moved > self._calibrate

    @property
    def _least(self) -> float:
        """Torque that does not matter [N m]."""
        return LEAST * float(np.sqrt(self._moments[-1] / max(self._bins, 1))) + 1e-9

    def _sizes_of(self, square: Array | float) -> Array:
        """Logs of mean squares () or (N,) [(N m)^2], as of rows (N, 1)."""
        return np.log(np.reshape(square, (-1, 1)) + self._least**2)

    def _count(self, challenger: int, sizes: Array) -> bool:
        """How large errors are (1, Q) counts against what is usual, and is learnt; returns whether that is an alarm."""
        if not self._knows:
            return False
        usual = self._usual[challenger]
        gain = usual.surprise(sizes)
        usual.learn(sizes[0])
        self._evidence.add(gain - 0.5 if self._calibrated else 0.0, challenger)
        if self._evidence.each[challenger] <= 0:
            self._none[challenger] = self._standing
        alarm = self._evidence.joint > self._threshold
        if alarm:
            none = self._none[int(np.argmax(self._evidence.each))]
            self._put(none.theta, none.root)  # the model has followed a little since the change
            self._changed, self._alarmed = none.bins, self._bins
            self._alarms += 1
        return alarm

    @property
    def _standing(self) -> _Standing:
        return _Standing(self._bins, self._model.theta[0, 0], self._model.root[0, 0])

    def _trust(self) -> None:
        """There is no evidence against the model as it is."""
        self._changed = None
        challengers = 1 + self._mover.ready
        self._evidence = Evidence(challengers)
        self._none = [self._standing] * challengers

    def _put(self, theta: Array, root: Array) -> None:
        """The model's parameters (P,), and the factor of their P (P, P)."""
        self._model.theta, self._model.root = theta[None, None], root[None, None]

    def _wander(self) -> None:
        """Parameters may have moved since the last block."""
        known = self._known
        self._model.widen(((WALK * known.sizes) ** 2 * BLOCK * self._length / known.square)[None, None])

    # ------------------------------------------------------------------------------------------------ what has changed

    @property
    def _known(self) -> Known:
        theta = self._model.theta[0, 0]
        usual = 0.1 * np.sqrt(self._moments[-1] / np.maximum(self._moments[:-1], 1e-12))  # gives a tenth of the torque
        square = float(np.exp(self._usual[ROWS].mean[0]))
        return Known(theta, self._model.P[0, 0], np.maximum(np.abs(theta), usual), square)

    def _predicts(self, error: float) -> None:
        """The model holds; one that was given is compared with the plant once that is known."""
        if self._given is not None and not self._compared:
            self._compared = True
            phi, y, series = self._since(0)
            known = self._known
            changes = replace(known, theta=self._given).changes(
                self._names, known.theta, known.std(phi, y - phi @ known.theta)
            )
            if changes and self._surprise_of_rows(y - phi @ self._given) > KIND:
                self._alarms += 1
                self._say("value", since=float(series[TIME, 0]), changes=changes, error=error)
                return
        if self.said.kind == "value":  # the last change stays said
            self._say("value", since=self.said.since, changes=self.said.changes, error=error)
        else:
            self._say("predicts", error=error)

    def _since(self, first: int) -> tuple[Array, Array, Array]:
        """Rows (R, P), y (R,), and time, position and velocity (3, R) since so many bins, as far as kept."""
        bins = list(self._kept)[max(0, first - self._bins + len(self._kept)) :]
        series = np.array([one.series[:3, -2] for one in bins]).T
        return np.array([one.phi for one in bins]), np.array([one.y for one in bins]), series

    def _judge(self) -> None:
        """Fit the model to what came since the change: does that explain it?"""
        if self._settled or self._changed is None or self._bins == self._changed:
            return
        phi, y, series = self._since(self._changed)
        least = round(FEWEST / self._length)
        if len(y) < least:
            self._say("changed", since=float(series[TIME, 0]))
            return
        known = self._known
        k, theta = known.moment(phi, y, max(0, min(len(y) - least, self._alarmed - self._bins + len(y))))
        phi, y, series = phi[k:], y[k:], series[:, k:]
        error, since = y - phi @ theta, float(series[TIME, 0])
        std = known.std(phi, error)
        at_rows = self._surprise_of_rows(error)
        at_turns, speed = self._surprise_of_turns(theta, std, since)
        told = known.changes(self._names, theta, std)
        found = {"since": since, "changes": told, "error": float(np.sqrt(np.mean(error**2)))}
        whole = self._bins - self._changed >= (self._kept.maxlen or 0)
        if np.hypot(max(at_rows, 0.0), max(at_turns, 0.0)) > KIND and len(y) >= 2 * least:
            slow = {"velocity": (-speed, speed)}
            where = slow if at_turns > at_rows else place_of(error, series[POSITION], series[VELOCITY], y)
            self._say("structure", where=where, **found)
            self._settled = whole
        elif len(y) * self._length < SURE or not (told or whole):
            if self.said.kind != "structure":  # what is not clear does not take back what was
                self._say("changed", **found)
        else:
            self._say("value", **found)
            if whole:  # the changed values are the model's from now on
                self._put(theta, known.root(phi))
                self._trust()

    def _surprise_of_rows(self, error: Array) -> float:
        """Standard errors by which errors of rows (R,) are larger than usual."""
        blocks = [np.mean(part**2) for part in np.array_split(error, max(1, len(error) // BLOCK))]
        return self._usual[ROWS].surprise(self._sizes_of(np.array(blocks)))

    def _surprise_of_turns(self, theta: Array, std: Array, time: float) -> tuple[float, float]:
        """Standard errors by which turns since a time [s] are missed by more than usual, with the best parameters.

        Also the speed up to which they reach [rad/s].
        """
        found = [turn for turn in self._turns if turn.time[0] > time]
        if not found:
            return 0.0, 0.0
        turns, usual = Turns.joined(found), self._usual[TURNS]
        sizes = self._mover.missed(turns, theta).fitted(std, float(np.exp(usual.mean[0]))).sizes(self._least)
        return usual.surprise(sizes), float(np.median(np.abs(turns.velocity)))

    def _say(self, kind: str, **told: Any) -> None:
        self.said = Verdict(
            kind,
            score=max(0.0, self._evidence.joint),
            threshold=self._threshold,
            parameter=next(iter(told.get("changes", ())), ""),
            alarms=self._alarms,
            **told,
        )
