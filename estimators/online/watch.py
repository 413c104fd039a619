"""Whether a model still predicts, sample by sample: a value changed, or the structure is wrong, and where.

A recursion with a slow random walk of its parameters predicts each row before it uses it. Log mean squared errors of
blocks of time are standardised by their distribution during calibration; a CUSUM accumulates the log-likelihood ratio
of larger errors (`evidence`).

Rows exclude a joint that sticks or reverses. There the model is simulated through each reversal (`turns`) and its
errors are judged in the same way: a change of friction may show nowhere else.

After an alarm, the model is refitted to the data since the change (`change`). If its errors return to their former
size, values changed, and the fit gives which, when and by how much; if they stay larger, the structure changed.

No model of a real machine is complete. The residual during calibration is the reference: the watch detects changes,
`diagnose` finds effects that a model lacks from the start.

Source: Basseville and Nikiforov, Detection of Abrupt Changes, 1993, chapters 2 and 5.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from estimators.online.binning import BLOCK, Bin, Binner, Monitors
from estimators.online.change import WATCH, Known, Rows
from estimators.online.clock import checked_rate
from estimators.online.evidence import Evidence, Usual, threshold_of
from estimators.online.recursion import SquareRootLeastSquares
from estimators.online.rows import TIME
from estimators.online.turns import TURN, Mover, Turns, mover_of
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, Term


@dataclass(frozen=True)
class Verdict:
    """Verdict of a watch on one plant.

    Attributes:
        kind: "calibrating", "predicts", "changed" (kind still open), "value" or "structure".
        since: time of the change [s]; None while there is none.
        score: evidence that the model no longer predicts [nat].
        threshold: of an alarm [nat].
        changes: change and standard error of each changed parameter in its unit, most significant first.
        where: of "structure", the range of position, velocity or torque in which errors are largest, in SI units; of an
            arm, `velocity@elbow`.
        error: root mean square error now, of the refitted model once there is a change [N m]; None while calibrating.
        alarms: so far.
    """

    kind: str
    since: float | None = None
    score: float = 0.0
    threshold: float = 0.0
    changes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    where: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    error: float | None = None
    alarms: int = 0

    @property
    def parameter(self) -> str:
        """Name of the parameter with the most significant change; empty if none."""
        return next(iter(self.changes), "")


class Watch(Monitors["ChangeMonitor"]):
    """Watches B pendulums, or an arm, one sample of each per step.

    Attributes:
        each: monitors, one a plant.
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
            terms: of the model, with their shape parameters set, of an arm its links first; an arm is watched by rows
                alone.
            batch: number B of pendulums.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            theta: parameters of the model, in the order of the columns; None learns them while it calibrates.
            alarms_per_hour: false ones, on average at most, of motion.
            calibrate: time of motion that the parameters, or with `theta` only the size of errors, are learnt from [s].

        Raises:
            ValueError: if a number is out of its range, or theta has another length.
        """
        checked_rate(rate)
        if not 1 <= calibrate < np.inf:
            raise ValueError(f"calibrate ({calibrate:g}) cannot be: give a second at least")
        names = tuple(column.name for term in terms for column in term.columns)
        if theta is not None and len(theta) != len(names):
            raise ValueError(f"theta has {len(theta)} values, the model {len(names)}: {', '.join(names)}")
        smoothing, period = smoothing or Smoothing.of_encoder(COUNTS, rate), 1.0 / rate
        mover, late = mover_of(terms, period), int(np.ceil(sum(term.delay for term in terms) / period)) + 1
        binner = Binner(rate, terms, smoothing, batch, None if mover is None else late)
        length = binner.every * period  # of a bin [s]
        self.threshold = threshold_of(alarms_per_hour, min(BLOCK * length, 2 * TURN.half))
        given = None if theta is None else np.asarray(theta, dtype=float)
        options = names, binner.joints, length, mover, self.threshold, calibrate, given
        super().__init__(rate, binner, [ChangeMonitor(*options) for _ in range(batch)])

    def accept(self) -> None:
        """All pendulums are now as they shall be: calibrate anew."""
        for one in self.each:
            one.accept()


class _Standing(NamedTuple):
    """The model after so many bins: theta (P,) and the factor of P (P, P)."""

    bins: int
    theta: Array
    root: Array


class ChangeMonitor:
    """Watches one plant: bins of its J joints and turns in, a verdict out.

    The challengers are the rows of each joint and, in the last place, the turns.

    Attributes:
        said: the verdict.
    """

    _changed: int | None  # after how many bins
    _evidence: Evidence
    _none: list[_Standing]  # the model as each challenger last had no evidence

    def __init__(
        self,
        names: Sequence[str],
        joints: Sequence[str],
        length: float,
        mover: Mover | None,
        threshold: float,
        calibrate: float,
        theta: Array | None,
    ) -> None:
        """Take parameters and joints by name, the length of a bin [s], what moves the model, the rest as `Watch`."""
        self._names, self._joints, self._mover = tuple(names), tuple(joints), mover
        self._length = length / len(joints)  # of motion that a bin tells of, as each joint has its own
        self._threshold, self._calibrate, self._given = threshold, calibrate, theta
        self._model = SquareRootLeastSquares((1, 1), len(names))
        self.reset()

    def reset(self) -> None:
        """Nothing is known yet."""
        self._model.reset(np.ones(1, dtype=bool))
        self._kept: deque[Bin] = deque(maxlen=max(2, round(WATCH.kept / self._length)))
        self._turns: deque[Turns] = deque(maxlen=WATCH.kept_turns)
        self._moments = np.zeros((len(self._joints), len(self._names) + 1))  # sums of phi^2 and y^2
        self._of = np.zeros(len(self._joints), dtype=int)  # bins of each joint
        self._bins, self._moved, self._begun = 0, 0.0, np.nan
        self._square, self._filled = np.zeros(len(self._joints)), [0] * len(self._joints)  # of the blocks to come
        self._usual = [*(Usual() for _ in self._joints), Usual(2)]  # of rows, and of turns
        self._alarms, self._settled = 0, False  # that it is the structure
        self._compared = False  # with the model that was given
        self._trust()
        self.said = Verdict("calibrating", threshold=self._threshold)

    def accept(self) -> None:
        """The pendulum is now as it shall be: calibrate anew."""
        self._given = None
        self.reset()

    # ------------------------------------------------------------------------------------------------- what comes in

    def take(self, one: Bin | Turns) -> None:
        """Predict a bin's row, or the motion through a turn, and score the prediction; then learn from it."""
        if isinstance(one, Turns):
            self._take_turn(one)
            return
        self._kept.append(one)
        self._bins += 1
        self._begun = one.moved if np.isnan(self._begun) else self._begun
        self._moved = one.moved - self._begun
        self._moments[one.joint] += np.append(one.phi, one.y) ** 2
        self._of[one.joint] += 1
        j, model, holds = one.joint, self._model, self._changed is None
        if holds:
            model.take(one.phi[None, None], np.full((1, 1), one.y), np.ones((1, 1), dtype=bool))
            # e is predicted to scatter by scale^2 (1 + phi' P phi)
            self._square[j] += model.error[0, 0] ** 2 / model.variance[0, 0]
        self._filled[j] += 1
        if self._filled[j] < BLOCK:
            return
        square = float(self._square[j] / BLOCK)
        self._square[j], self._filled[j] = 0.0, 0
        if holds:
            self._count(j, self._sizes_of([square], j))
            self._wander()
        if self._changed is not None:
            self._judge()
        elif self._calibrated:
            self._predicts(float(np.sqrt(square)))

    def _take_turn(self, turn: Turns) -> None:
        """Compare a turn with where the model goes, if it is known a little."""
        self._turns.append(turn)
        if self._changed is None and self._knows:
            assert self._mover is not None
            missed = self._mover.missed(turn, self._model.theta[0, 0])
            if self._count(-1, missed.sizes(self._least(0))):
                self._judge()

    # -------------------------------------------------------------------------------------------------------- evidence

    @property
    def _knows(self) -> bool:
        """Whether errors begin to be those of the model."""
        return self._moved > WATCH.learn * self._calibrate

    @property
    def _calibrated(self) -> bool:
        """Whether it has been in motion for long enough, whether rows are made of it or not."""
        return self._moved > self._calibrate

    def _least(self, joint: int) -> float:
        """Torque of a joint that does not matter [N m]."""
        return WATCH.least * float(np.sqrt(self._moments[joint, -1] / max(self._of[joint], 1))) + 1e-9

    def _sizes_of(self, squares: Sequence[float], joint: int) -> Array:
        """Logs of N mean squares of rows of a joint [(N m)^2], (N, 1)."""
        return np.log(np.array(squares)[:, None] + self._least(joint) ** 2)

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
        challengers = len(self._joints) + (self._mover is not None)
        self._evidence = Evidence(challengers)
        self._none = [self._standing] * challengers

    def _put(self, theta: Array, root: Array) -> None:
        """The model's parameters (P,), and the factor of their P (P, P)."""
        self._model.theta, self._model.root = theta[None, None], root[None, None]

    def _wander(self) -> None:
        """Parameters may have moved since the last block."""
        known = self._known
        share = WATCH.walk**2 * BLOCK * self._length / known.square
        self._model.widen((share * known.sizes**2)[None, None])

    # ------------------------------------------------------------------------------------------------ what has changed

    @property
    def _known(self) -> Known:
        theta = self._model.theta[0, 0]
        seen = self._of > 0
        squares = self._moments[seen, -1:] / np.maximum(self._moments[seen, :-1], 1e-12)
        usual = 0.1 * np.sqrt(squares.min(axis=0, initial=np.inf))  # gives a tenth of the torque
        sizes = np.maximum(np.abs(theta), np.minimum(usual, 1e6))
        square = float(np.exp(max(usual.mean[0] for usual in self._usual[:-1])))
        return Known(theta, self._model.P[0, 0] * square, sizes, square)

    def _predicts(self, error: float) -> None:
        """The model holds; one that was given is compared with the plant once that is known."""
        if self._given is not None and not self._compared:
            self._compared = True
            rows, known = self._since(0), self._known
            std = known.std(rows, rows.error(known.theta))
            changes = replace(known, theta=self._given).changes(self._names, known.theta, std)
            if changes and self._surprise_of_rows(rows, self._given)[0] > WATCH.kind:
                self._alarms += 1
                self._say("value", since=float(rows.series[TIME, 0]), changes=changes, error=error)
                return
        last = self.said  # a change stays said
        told = {"since": last.since, "changes": last.changes} if last.kind == "value" else {}
        self._say("value" if told else "predicts", error=error, **told)

    def _since(self, first: int) -> Rows:
        """What came since so many bins, as far as kept."""
        bins = list(self._kept)[max(0, first - self._bins + len(self._kept)) :]
        scale = np.exp([0.5 * usual.mean[0] for usual in self._usual])
        return Rows.of(bins, scale)

    def _judge(self) -> None:
        """Fit the model to what came since the change: does that explain it?"""
        if self._settled or self._changed is None or self._bins == self._changed:
            return
        rows = self._since(self._changed)
        least = round(WATCH.fewest / self._length)
        if len(rows.y) < least:
            self._say("changed", since=float(rows.series[TIME, 0]))
            return
        known = self._known
        k, theta = known.moment(rows, max(0, min(len(rows.y) - least, self._alarmed - self._bins + len(rows.y))))
        rows = rows[k:]
        error, since = rows.error(theta), float(rows.series[TIME, 0])
        std = known.std(rows, error)
        at_rows, _ = self._surprise_of_rows(rows, theta)
        at_turns, speed = self._surprise_of_turns(theta, std, since)
        told = known.changes(self._names, theta, std)
        found = {"since": since, "changes": told, "error": float(np.sqrt(np.mean((error * rows.scale) ** 2)))}
        whole = self._bins - self._changed >= (self._kept.maxlen or 0)
        if np.hypot(max(at_rows, 0.0), max(at_turns, 0.0)) > WATCH.kind and len(rows.y) >= 2 * least:
            _, joint = self._surprise_of_rows(rows, known.theta)  # a new fit spreads an effect over other joints
            at = "@" * bool(self._joints[joint]) + self._joints[joint]
            slow = {"velocity": (-speed, speed)}
            where = slow if at_turns > at_rows else rows[rows.joint == joint].place_of_errors(theta)
            self._say("structure", where={quantity + at: span for quantity, span in where.items()}, **found)
            self._settled = whole
        elif len(rows.y) * self._length < WATCH.sure or not (told or whole):
            if self.said.kind != "structure":  # what is not clear does not take back what was
                self._say("changed", **found)
        else:
            self._say("value", **found)
            if whole:  # the changed values are the model's from now on
                self._put(theta, known.root(rows))
                self._trust()

    def _surprise_of_rows(self, rows: Rows, theta: Array) -> tuple[float, int]:
        """Standard errors by which errors of rows are larger than usual, at the joint where that is most."""
        found = [0.0] * len(self._joints)
        for j in np.unique(rows.joint).tolist():
            own = rows[rows.joint == j]
            error = own.error(theta) * own.scale
            blocks = [float(np.mean(part**2)) for part in np.array_split(error, max(1, len(error) // BLOCK))]
            found[j] = self._usual[j].surprise(self._sizes_of(blocks, j))
        joint = int(np.argmax(found))
        return found[joint], joint

    def _surprise_of_turns(self, theta: Array, std: Array, time: float) -> tuple[float, float]:
        """Standard errors by which turns since a time [s] are missed by more than usual, with the best parameters.

        Also the speed up to which they reach [rad/s].
        """
        found = [turn for turn in self._turns if turn.time[0] > time]
        if not found or self._mover is None:
            return 0.0, 0.0
        turns, usual = Turns.joined(found), self._usual[-1]
        sizes = self._mover.missed(turns, theta).fitted(std, float(np.exp(usual.mean[0]))).sizes(self._least(0))
        return usual.surprise(sizes), float(np.median(np.abs(turns.velocity)))

    def _say(self, kind: str, **told: Any) -> None:
        self.said = Verdict(
            kind,
            score=max(0.0, self._evidence.joint),
            threshold=self._threshold,
            alarms=self._alarms,
            **told,
        )
