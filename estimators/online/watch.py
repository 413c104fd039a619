"""Whether a model still predicts, sample by sample: a value changed, or the structure is wrong, and where.

Two recursions predict the same rows before they see them. One is the model as calibrated, whose parameters may wander
slowly; the other follows within a second. Each error has a Student t density (the one score, prequentially). What the
quick one, with errors as large as calibrated or as they are now, gains over the calm one is summed over blocks of time.
While the model holds, the gains of blocks scatter about what they were; in standard deviations, less a half, they make
a CUSUM, which then stands for a ratio of densities of mean one: false alarms are on average exp(threshold) blocks apart
or more, and the threshold follows from alarms per hour.

Rows say nothing of a joint that sticks or turns. There, the model itself is moved on and compared (`turns`), and what
it misses by more than usual makes a CUSUM of its own: friction may change where nothing else does.

After an alarm, the model is fitted anew to what came since the change. If its errors are then as they were, values
changed, and the fit says which, when and by how much; if they stay larger, no value explains them.

No model of a real machine is complete. What one left unexplained when it was calibrated, and whatever a quick fit
gains from that, is how things are: the watch tells of changes, `diagnose` what a model lacks from the start.

Source: Dawid, JRSS A 147(2), 1984, for the score; Lorden, Annals of Mathematical Statistics 42(6), 1971, for false
alarms of a CUSUM; Basseville and Nikiforov, Detection of Abrupt Changes, 1993, chapters 2 and 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.online.cusum import Cusum
from estimators.online.evidence import HOUR, threshold_of
from estimators.online.recursion import SquareRootLeastSquares
from estimators.online.rows import POSITION, VELOCITY
from estimators.online.stream import Stream
from estimators.online.turns import HALF, Missed, Mover, Passage, Past, TurnFinder, Turns
from estimators.schemes.six import scheme
from estimators.selection.score import NU
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, Term

BIN = 0.01  # [s], over which rows are averaged: noise of the encoder averages out, effects do not
BLOCK = 20  # bins, over which gains and squared errors are summed
CALM, QUICK = 0.003, 0.1  # of each parameter, by which the two may wander [1/sqrt(s)]
LEAST = 0.004  # of the RMS torque, below which errors and changes do not matter
LEARN = 0.5  # of the time to calibrate, after which errors at turns are learnt, too
MEMORY = 300  # blocks, of how gains and errors are while the model holds
NOW = 0.5  # [s] of motion, of the scale of errors as they are now
MOST = 4.0  # standard deviations that a block counts for
KEPT = 10.0  # [s] of motion, that a change is judged from
FEWEST = 0.5  # [s] of motion since a change, before which its kind is not judged
SURE = 2.5  # [s] of motion, after which what a new fit explains is called a value
OUTLIER = 4.0  # standard deviations, beyond which an error counts no more for the kind
KIND = 5.0  # standard errors by which squared errors of a new fit exceed what they were, to be called structure
SIGNIFICANT = 4.0  # standard errors, from which on a change of a parameter is told
SPLITS = 24  # moments that are tried for the change
CELLS = 8  # of a quantity, in which errors are compared
NOISE = 2.0  # nat a block, that a quick fit gains from correlated noise over a given model that is right
SURELY = 1e-6  # of each parameter, the standard error of a given model for unit noise


@dataclass(frozen=True)
class Verdict:
    """What a watch says of one pendulum.

    Attributes:
        kind: "calibrating", "predicts", "changed" (it is not clear yet how), "value" or "structure".
        since: time of the change [s]; None while there is none.
        score: the larger CUSUM, of rows and of turns [nat].
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
    """Watches B pendulums, one sample of each per step."""

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
        columns = [column for term in terms for column in term.columns]
        self.names = tuple(column.name for column in columns)
        if theta is not None and len(theta) != len(self.names):
            raise ValueError(f"theta has {len(theta)} values, the model {len(self.names)}: {', '.join(self.names)}")
        smoothing, period, size = smoothing or Smoothing.of_encoder(COUNTS, rate), 1.0 / rate, len(columns)
        self.terms, self.rate, self.batch = tuple(terms), rate, batch
        self._stream = Stream(terms, [scheme("hamiltonian")], smoothing, period, batch)
        self._every = max(1, round(BIN * rate))
        self.bin = self._every * period  # [s]
        self._mover = Mover(terms, period)
        # rows may alarm, and turns, neither more often than this
        each, block = alarms_per_hour / (1 + self._mover.ready), min(BLOCK * self.bin, 2 * HALF)
        self.threshold = threshold_of(each, block)
        self._passages: list[tuple[dict[int, Past], Passage]] = []  # that the mover is at, and by pendulum whose
        late = int(np.ceil(sum(term.delay for term in terms) / period)) + 1
        self._slowest = smoothing.slowest  # [rad/s], that is motion
        self._turns = TurnFinder(batch, period, self._stream.delay, late, self._slowest)
        self._past = [Past() for _ in range(batch)]
        self._calibrate, self._given = calibrate, None if theta is None else np.asarray(theta, dtype=float)
        self._sum = np.zeros((batch, size + 3))  # phi, y, position, velocity over the bin to come
        self._count, self._step = np.zeros(batch, dtype=int), 0
        self._kept = np.zeros((max(2, round(KEPT / self.bin)), batch, size + 4))  # bins with motion, and their time
        self._squares = SquareRootLeastSquares((batch, 2), size)
        self._motion, self._moved, self._changed = np.zeros((3, batch), dtype=int)
        self._alarmed, self._alarms, self._blocks = np.zeros((3, batch), dtype=int)
        self._settled = np.zeros(batch, dtype=bool)  # that it is the structure
        self._scale, self._now = np.zeros((2, batch))  # squared scales of Student's t
        self._by_rows, self._by_turns = Cusum(batch, size), Cusum(batch, size)
        self._block = np.zeros((batch, 2))  # gain and squared error of the block to come
        self._usual = np.zeros((batch, 2, 2))  # of both, mean and variance while the model holds
        self._moments = np.zeros((batch, size + 1))
        self.verdicts = [Verdict("calibrating", threshold=self.threshold)] * batch
        self._start(np.ones(batch, dtype=bool))

    def _start(self, which: Mask) -> None:
        """Those of the B know nothing yet."""
        self._squares.reset(which)
        if self._given is not None:
            exact = np.diag(SURELY * (np.abs(self._given) + SURELY))  # the model is as it is
            theta, root = (np.broadcast_to(part, (self.batch, *part.shape)) for part in (self._given, exact))
            self._put(which, theta, root)
        for series in (self._motion, self._moved, self._block, self._moments, self._alarms, self._blocks):
            series[which] = 0
        self._trust(which)
        self._settled[which] = False
        self._usual[which], self._scale[which], self._now[which], self._changed[which] = 0.0, 1.0, 1.0, -1
        for b in np.flatnonzero(which).tolist():
            self.verdicts[b] = Verdict("calibrating", threshold=self.threshold)
            self._past[b] = Past()

    def reset(self, which: Mask | None = None) -> None:
        """Those pendulums (B,) start anew with the next sample; all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        if mask.any():
            self._stream.reset(mask)
            self._clear(mask)
            self._start(mask)

    def accept(self) -> None:
        """All pendulums are now as they shall be: calibrate anew."""
        self._given = None
        self._start(np.ones(self.batch, dtype=bool))

    def _clear(self, which: Mask) -> None:
        self._sum[which], self._count[which] = 0.0, 0

    def take(self, time: Array, position: Array, torque: Array) -> list[Verdict]:
        """Take in a sample of every pendulum, as `OnlineEstimator.take`; returns what is said of each."""
        taken = self._stream.take(time, position, torque)
        self._clear(taken.anew)
        usable = taken.usable
        self._sum += np.column_stack([taken.equations[:, 0], *self._stream.instant[[POSITION, VELOCITY]]]) * usable
        self._count += usable[:, 0]
        self._step += 1
        if self._step % self._every == 0:
            whole = self._count == self._every
            if whole.any():
                self._take_bin(self._sum / self._every, taken.time, whole)
            self._sum[:], self._count[:] = 0.0, 0
        velocity = self._stream.instant[VELOCITY]
        self._moved += np.abs(velocity) > self._slowest
        if self._mover.ready:
            self._take_turns(self._turns.take(time, position, torque, velocity, taken.place))
        return self.verdicts

    @property
    def _calibrated(self) -> Mask:
        """Which have been in motion for long enough (B,), whether rows are made of it or not."""
        return np.asarray(self._moved > self._calibrate * self.rate)

    def _take_turns(self, found: Mapping[int, Turns]) -> None:
        """Take turns, by pendulum, and go on with those that are compared: a sample has time for one simulation."""
        if found:
            self._begin_passage(found)
        going = self._passages
        self._passages = []
        for pasts, passage in going:
            missed = self._mover.go_on(passage)
            if missed is None:
                self._passages.append((pasts, passage))
            else:
                self._compare(pasts, missed)

    def _begin_passage(self, found: Mapping[int, Turns]) -> None:
        """Keep turns, by pendulum, and begin to compare those of models that are known a little."""
        for b, turn in found.items():
            self._past[b].keep(turn)
        known = self._moved > LEARN * self._calibrate * self.rate
        pasts = {b: self._past[b] for b in found if known[b] and self._changed[b] < 0}
        if not pasts:
            return
        # of a model that is given and may be wrong, the quick one says how large errors are
        says = np.where(self._calibrated | (self._given is None), 0, 1)
        theta = np.column_stack([self._squares.theta[b, says[b]] for b in pasts])
        self._passages.append((pasts, Passage(Turns.joined([found[b] for b in pasts]), theta)))

    def _compare(self, pasts: Mapping[int, Past], missed: Missed) -> None:
        """Errors of a turn of each of some pendulums, with what is usual of each."""
        due, gain = np.zeros(self.batch, dtype=bool), np.zeros(self.batch)
        for (b, past), size in zip(pasts.items(), missed.sizes(self._least[list(pasts)]), strict=True):
            due[b] = self._changed[b] < 0 and past is self._past[b]  # it may have begun anew meanwhile
            gain[b] = past.surprise(size)
            past.learn(size)
        self._add(self._by_turns, gain, due)
        for b in np.flatnonzero(due & (self._changed >= 0) & (self._motion > self._changed)).tolist():
            self._judge(b)

    @property
    def _least(self) -> Array:
        """Torque that does not matter (B,) [N m]."""
        return np.asarray(LEAST * np.sqrt(self._moments[:, -1] / np.maximum(1, self._motion)) + 1e-9)

    def _take_bin(self, mean: Array, time: Array, whole: Mask) -> None:
        """Predict a bin's row, score both predictions, then learn from it."""
        size, squares = len(self.names), self._squares
        phi, y = mean[:, :size], mean[:, size]
        for b in np.flatnonzero(whole).tolist():
            self._kept[self._motion[b] % len(self._kept), b] = (*mean[b], time[b])
        self._motion += whole
        self._moments += np.column_stack([phi**2, y**2]) * whole[:, None]
        holds = whole & (self._changed < 0)
        calm, quick = self._errors(phi, y)
        if self._given is not None:  # how large errors are is not for a model to say that may be wrong
            new = ~self._calibrated
            holds, calm = holds & ~new, np.where(new, quick, calm)
            self._score(calm, quick, whole & new & (self._motion > BLOCK))
        self._score(calm, quick, holds & (self._motion > BLOCK))
        squares.take(np.repeat(phi[:, None], 2, axis=1), np.column_stack([y, y]), np.column_stack([holds, whole]))
        due = whole & (self._motion % BLOCK == 0)
        if due.any():
            self._close(due & (self._changed < 0) & (self._motion > BLOCK))  # of the first nothing was predicted
            self._wander(due)
        for b in np.flatnonzero(due).tolist():
            if self._changed[b] >= 0:
                if not self._settled[b]:
                    self._judge(b)
            elif self._calibrated[b]:
                self._say(b, "predicts", error=float(np.sqrt(self._now[b])))

    def _errors(self, phi: Array, y: Array) -> tuple[Array, Array]:
        """A-priori errors of both (B,) in standard deviations for unit noise."""
        squares = self._squares
        f = np.einsum("bp,bspq->bsq", phi, squares.root)
        spread = np.sqrt(1.0 + np.einsum("bsq,bsq->bs", f, f))
        error = (y[:, None] - np.einsum("bp,bsp->bs", phi, squares.theta)) / spread
        return error[:, 0], error[:, 1]

    def _score(self, calm: Array, quick: Array, which: Mask) -> None:
        """What the quick recursion gains over the calm one; then the scales, calibrated and now, learn."""
        usual = self._floored
        now = np.maximum(self._now, usual)
        either = np.logaddexp(density(quick, usual), density(quick, now)) - np.log(2)
        self._block += np.column_stack([either - density(calm, usual), calm**2]) * which[:, None]
        count = np.maximum(self._motion - BLOCK, 1)
        for scale, error, memory in ((self._scale, calm, MEMORY * BLOCK), (self._now, quick, NOW / self.bin)):
            before = np.where(count == 1, np.maximum(error**2, 1e-12), scale)
            weighted = (NU + 1) / (NU + error**2 / before) * error**2  # the fixed point of largest likelihood
            scale[:] = np.where(which, before + (weighted - before) / np.minimum(count + 1, memory), scale)

    @property
    def _floored(self) -> Array:
        """Squared scale of errors while the model holds (B,), no less than what matters."""
        return np.maximum(self._scale, LEAST**2 * self._moments[:, -1] / np.maximum(self._motion, 1)) + 1e-12

    def _close(self, due: Mask) -> None:
        """Complete a block: add its gain to the CUSUM, and learn from it how blocks are."""
        mean, variance = self._usual[..., 0], self._usual[..., 1]
        told = self._block / [1.0, BLOCK]
        least = np.column_stack([np.ones(self.batch), 0.1 * self._floored])  # of a standard deviation
        spread = np.maximum(np.sqrt(variance), least)
        new = np.clip((told - mean) / spread, -MOST, MOST)
        usual = mean[:, 0] if self._given is None else NOISE
        gain = np.clip((told[:, 0] - usual) / spread[:, 0], -MOST, MOST)
        doubt = np.sqrt(self._blocks / (self._blocks + 10.0))  # few blocks do not know how they scatter
        self._add(self._by_rows, doubt * gain, due)
        self._blocks = self._blocks + due
        share = (due / np.minimum(np.maximum(self._blocks, 1), MEMORY))[:, None]
        step = np.where(self._blocks[:, None] > 5, new * spread, told - mean)
        self._usual[..., 0] = mean + share * step
        self._usual[..., 1] = variance + share * ((1 - share) * step**2 - variance)
        self._block[due] = 0.0

    def _add(self, cusum: Cusum, gain: Array, due: Mask) -> None:
        """Add what those of the B that are due (B,) gained [standard deviations], and alarm where it is enough."""
        known = due & self._calibrated
        now = self._motion, self._squares.theta[:, 0], self._squares.root[:, 0]
        cusum.add(np.where(known, gain - 0.5, 0.0), due, *now)
        alarm = known & (cusum.value > self.threshold)
        if alarm.any():  # the calm one has followed a little since the change, too
            self._put(alarm, cusum.theta, cusum.root)
        self._alarmed = np.where(alarm, self._motion, self._alarmed)
        self._changed = np.where(alarm, cusum.since, self._changed)
        self._alarms = self._alarms + alarm

    def _wander(self, due: Mask) -> None:
        """Parameters may have moved since the last time; those of a model that has changed wait."""
        walk = np.array([CALM, QUICK])[None, :, None] * self._sizes[:, None]
        noise = self._floored[:, None, None]
        still = ~self._calibrated if self._given is not None else False
        wander = np.column_stack([due & (self._changed < 0) & ~np.asarray(still), due])
        self._squares.widen(np.where(wander[..., None], walk**2 * BLOCK * self.bin / noise, 0.0))

    @property
    def _sizes(self) -> Array:
        """Of each parameter (B, P): its value, or what would give a tenth of the torque."""
        usual = 0.1 * np.sqrt(self._moments[:, -1:] / np.maximum(self._moments[:, :-1], 1e-12))
        return np.maximum(np.abs(self._squares.theta[:, 0]), usual)

    def _since_change(self, b: int) -> tuple[Array, Array, Array, Array]:
        """Rows (R, P), y (R,), position and velocity (R, 2), and time (R,) since the change, as far as kept."""
        length, size = len(self._kept), len(self.names)
        first = max(int(self._changed[b]), int(self._motion[b]) - length)
        rows = self._kept[np.arange(first, int(self._motion[b])) % length, b]
        return rows[:, :size], rows[:, size], rows[:, size + 1 : size + 3], rows[:, -1]

    def _judge(self, b: int) -> None:
        """Fit the model to what came since the change: does that explain it?"""
        phi, y, motion, time = self._since_change(b)
        least = round(FEWEST / self.bin)
        if len(y) < least:
            self._say(b, "changed", since=float(time[0]))
            return
        before, scale = self._squares.theta[b, 0], self._floored[b]
        k, theta = self._split(phi, y, b, least)
        phi, y, motion, time = phi[k:], y[k:], motion[k:], time[k:]
        error = y - phi @ theta
        # squared errors, a block each, against what they were; a few that are far off are no structure
        usual, variance = self._usual[b, 1]
        bounded = np.minimum(error**2, OUTLIER**2 * usual)
        squares = np.array([np.mean(part) for part in np.array_split(bounded, max(1, len(error) // BLOCK))])
        spread = max(np.sqrt(variance), 0.1 * scale)
        excess = np.mean(squares) - usual
        sure = excess * np.sqrt(len(squares)) / spread
        delta, std = theta - before, self._std(phi, error, b)
        at_turns, speed = self._excess_at_turns(b, theta, std, float(time[0]))
        told = {
            self.names[j]: (float(delta[j]), float(std[j]))
            for j in np.argsort(-np.abs(delta) / std)
            if abs(delta[j]) > SIGNIFICANT * std[j]
        }
        found = {"since": float(time[0]), "changes": told, "error": float(np.sqrt(np.mean(error**2)))}
        whole = bool(self._motion[b] - self._changed[b] >= len(self._kept))
        if np.hypot(max(sure, 0.0), max(at_turns, 0.0)) > KIND and len(y) >= 2 * least:
            where = {"velocity": (-speed, speed)} if at_turns > sure else _where(error, motion, y)
            self._say(b, "structure", where=where, **found)
            self._settled[b] = whole
        elif len(y) * self.bin < SURE or not (told or whole):
            if self.verdicts[b].kind != "structure":  # what is not clear does not take back what was
                self._say(b, "changed", **found)
        else:
            self._say(b, "value", **found)
            if whole:
                self._adopt(b, theta)

    def _excess_at_turns(self, b: int, theta: Array, std: Array, time: float) -> tuple[float, float]:
        """Standard errors by which turns since a time [s] are missed by more than usual, with the best parameters.

        Also the speed up to which they reach [rad/s].
        """
        past, turns = self._past[b], self._past[b].since(time)
        if turns is None:
            return 0.0, 0.0
        sizes = self._mover.missed(turns, theta).fitted(std, past.usual).sizes(self._least[b])
        return past.surprise(*sizes), float(np.median(np.abs(turns.velocity)))

    def _split(self, phi: Array, y: Array, b: int, least: int) -> tuple[int, Array]:
        """Row of the change, between the last zero of the CUSUM and the alarm, and the parameters (P,) after it."""
        calm = density(y - phi @ self._squares.theta[b, 0], self._floored[b])
        before = np.concatenate([[0.0], np.cumsum(calm)])
        last = max(0, min(len(y) - least, int(self._alarmed[b] - self._motion[b]) + len(y)))

        def best(splits: Index) -> tuple[int, Array]:
            fits = [self._refit(phi[k:], y[k:], b) for k in splits]
            gains = [
                before[k] + density(y[k:] - phi[k:] @ fit, self._floored[b]).sum()
                for k, fit in zip(splits, fits, strict=True)
            ]
            place = int(np.argmax(gains))
            return int(splits[place]), fits[place]

        coarse = np.unique(np.linspace(0, last, SPLITS).astype(np.intp))
        k, _ = best(coarse)
        step = -(-last // (SPLITS - 1))
        return best(np.arange(max(0, k - step), min(last, k + step) + 1))

    def _std(self, phi: Array, error: Array, b: int) -> Array:
        """Standard errors of changes (P,): of a fit whose errors are correlated over blocks, and of what was known."""
        scale, known = self._floored[b], self._squares.P[b, 0]
        bread = np.linalg.pinv(phi.T @ phi)
        scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), BLOCK))
        fit = np.maximum(np.diag(bread @ (scores.T @ scores) @ bread), np.diag(bread) * scale)
        return np.asarray(np.sqrt(fit + np.diag(known) * scale))

    def _refit(self, phi: Array, y: Array, b: int) -> Array:
        """Parameters (P,) that fit rows, each held weakly where it was."""
        before = self._squares.theta[b, 0]
        weak = np.diag(np.sqrt(self._floored[b]) / self._sizes[b])
        both = np.vstack([phi, weak]), np.concatenate([y, weak @ before])
        return np.asarray(np.linalg.lstsq(*both, rcond=None)[0])

    def _adopt(self, b: int, theta: Array) -> None:
        """The changed values are the model's from now on."""
        which = np.arange(self.batch) == b
        self._put(which, theta[None], self._squares.root[:, 1])
        self._trust(which)
        self._changed[b] = -1

    def _trust(self, which: Mask) -> None:
        """There is no evidence against the models of those of the B as they are."""
        for cusum in (self._by_rows, self._by_turns):
            cusum.begin(which, self._motion, self._squares.theta[:, 0], self._squares.root[:, 0])

    def _put(self, which: Mask, theta: Array, root: Array) -> None:
        """Parameters (B, P) and the factor of their P (B, P, P) of the calm recursion, for those of the B."""
        squares = self._squares
        calm = which[:, None] & (np.arange(2) == 0)  # (B, 2)
        squares.theta = np.where(calm[..., None], theta[:, None], squares.theta)
        squares.root = np.where(calm[..., None, None], root[:, None], squares.root)

    def _say(self, b: int, kind: str, **told: object) -> None:
        changes = told.get("changes") or {}
        if kind == "predicts" and self.verdicts[b].kind == "value":  # the last change stays said
            kind, last = "value", self.verdicts[b]
            told = {"since": last.since, "changes": last.changes, **told}
            changes = last.changes
        parameter = next(iter(changes), "")  # type: ignore[call-overload]
        self.verdicts[b] = Verdict(
            kind,
            score=float(max(self._by_rows.value[b], self._by_turns.value[b])),
            threshold=self.threshold,
            parameter=parameter,
            alarms=int(self._alarms[b]),
            **told,  # type: ignore[arg-type]
        )


def density(error: Array, square: Array | float) -> Array:
    """Log density of Student's t with a squared scale, but for its constant."""
    return np.asarray(-0.5 * np.log(square) - (NU + 1) / 2 * np.log1p(error**2 / (NU * square)))


def _where(error: Array, motion: Array, torque: Array) -> dict[str, tuple[float, float]]:
    """The quantity whose value tells most of the errors, and its range where they are largest."""
    best, found = 0.0, {}
    angle = (motion[:, 0] + np.pi) % (2 * np.pi) - np.pi
    for name, values in (("position", angle), ("velocity", motion[:, 1]), ("torque", torque)):
        edges = np.quantile(values, np.linspace(0, 1, CELLS + 1))
        cell = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, CELLS - 1)
        count = np.maximum(np.bincount(cell, minlength=CELLS), 1)
        told = np.bincount(cell, error, CELLS) ** 2 / count
        if told.sum() > best:
            best, worst = float(told.sum()), int(np.argmax(told))
            found = {name: (float(edges[worst]), float(edges[worst + 1]))}
    return found
