"""Online diagnosis: the running model against itself with each effect of the library, by the one score.

All models are fitted to the first seconds of motion. From then on the running model, alone and with each effect,
predicts every bin before its update (`rivals`). The gains in log predictive density per second of motion are judged as
offline, by a Bayesian bootstrap over these blocks (`estimators.selection.score`). An effect is reported as missing once
the e-process passes its threshold (`evidence`), which follows from the accepted false alarms per hour.

One more challenger is the running model with forgetting (`forgetting`). After an alarm to which it contributed, all
models are fitted again to what came since the likely time of a change (`change`). If they then predict better than any
model from before, they take over: either an effect is missing since that time, or parameters have changed.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from estimators.findings import Obstacle
from estimators.online.binning import BLOCK, Bin, Binner
from estimators.online.change import CHANGE, Fit, ParameterChange, find_change, fit
from estimators.online.clock import checked_rate
from estimators.online.contest import Contest, PlantBins
from estimators.online.evidence import UsualGain, threshold_of
from estimators.online.rivals import ONLINE, TIME
from estimators.selection.criterion import Criterion
from estimators.selection.score import Bootstrap
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.arms.joints import Links
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Term, effects
from pendulum_env.physics.term import loads


@dataclass(frozen=True)
class Standing:
    """Score of one effect beside the running model.

    Attributes:
        effect: its id.
        probability: that it predicts best, of all effects and of none.
        gain: log predictive density over the running model [nat].
        error: its standard error, from the scatter between stretches [nat].
        chance: p-value of the gain.
        evidence: that it predicts better: log wealth of the bets on it [nat].
        term: with the nonlinear parameters that predicted best.
        theta: parameters of the running model and, last, of the effect, by name.
    """

    effect: str
    probability: float
    gain: float
    error: float
    chance: float
    evidence: float
    term: Term
    theta: Mapping[str, float]


@dataclass(frozen=True)
class OnlineDiagnosis:
    """Verdict on a running model, updated once per second of motion.

    Attributes:
        kind: "calibrating"; "nothing" while neither an effect nor another set of parameters predicts significantly
            better; "missing"; or "changed".
        evidence: that an effect or forgetting predicts better: log of the mean wealth of the bets [nat].
        threshold: evidence of an alarm [nat].
        terms: of the running model.
        theta: its parameters by name.
        ranking: of effects, the most probable first.
        group: ids of the most probable effect and its competitors; empty unless one is missing.
        none: probability that no effect predicts better than the running model.
        motion: time of motion since the model began to run [s].
        error: root mean square a-priori error of the running model over the last seconds of motion [N m].
        added: ids of effects taken into it.
        not_run: effects that cannot be followed online, with the reason.
        changed: change and standard error of each changed parameter in its unit, the most significant first; empty
            while an effect is missing.
        since: time of the last change, also of one by which an effect set in [s]; None while there is none.
    """

    kind: str
    terms: tuple[Term, ...] = ()
    theta: Mapping[str, float] = field(default_factory=dict)
    ranking: tuple[Standing, ...] = ()
    group: tuple[str, ...] = ()
    none: float = 1.0
    evidence: float = -np.inf
    threshold: float = np.inf
    motion: float = 0.0
    error: float = float("nan")
    added: tuple[str, ...] = ()
    not_run: Mapping[str, Obstacle] = field(default_factory=dict)
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    since: float | None = None


class Diagnoser:
    """Diagnoses B pendulums, or an arm, one sample of each per step.

    Attributes:
        each: monitors, one a plant.
        rate: samples per second [Hz].
        batch: number B of plants.
        threshold: from which evidence on something is missing [nat].
        not_run: effects that cannot be followed online, with the reason.
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        *,
        batch: int = 1,
        library: Mapping[str, type[Term]] | None = None,
        smoothing: Smoothing | None = None,
        given: Fit | None = None,
        alarms_per_hour: float = 1.0,
    ) -> None:
        """Take a model and the effects that it may lack.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their nonlinear parameters set, of an arm its links first.
            batch: number B of pendulums.
            library: effects by id; None are all that are known.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            given: parameters of the model; those of the plant that differ significantly are reported as changed, until
                an effect is added or undone, or parameters change.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.

        Raises:
            ValueError: if a number is out of its range, there are not as many parameters as the model has, or a term of
                the model depends on the past.
        """
        checked_rate(rate)
        reasons = {term.id: reason for term in terms if (reason := hindrance(type(term)))}
        if reasons:
            raise ValueError(f"{next(iter(reasons))} cannot be in a model that is diagnosed online: take it out of it")
        names = [column.name for term in terms for column in term.columns]
        if given is not None and len(given.theta) != len(names):
            raise ValueError(f"{len(given.theta)} parameters are given, the model has {len(names)}: {', '.join(names)}")
        library = effects() if library is None else library
        self.not_run = {id: reason for id, effect in library.items() if (reason := hindrance(effect))}
        library = {id: effect for id, effect in library.items() if id not in self.not_run}
        links = [term for term in terms if isinstance(term, Links)]  # whose columns come with the bins
        self.rate, self.batch = rate, batch
        self._binner = binner = Binner(rate, links, smoothing or Smoothing.of_encoder(COUNTS, rate), batch)
        length, joints = binner.every / rate, binner.joints  # of a bin [s]
        self.threshold = threshold_of(alarms_per_hour, BLOCK * length / len(joints))
        blank = OnlineDiagnosis("calibrating", threshold=self.threshold, not_run=self.not_run)
        plant = PlantBins(tuple(joints), length / len(joints), 1 / rate)
        self.each = tuple(EffectMonitor(terms, library, plant, blank, given) for _ in range(batch))

    @property
    def said(self) -> tuple[OnlineDiagnosis, ...]:
        """Return the diagnosis of each plant."""
        return tuple(one.said for one in self.each)

    def reset(self, which: Mask | None = None) -> None:
        """Begin anew with the next sample of those plants (B,); of all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        self._binner.reset(mask)
        for b in np.flatnonzero(mask):
            self.each[b].reset()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[OnlineDiagnosis, ...]:
        """Take in a sample of every plant, as `OnlineEstimator.take`; return the diagnosis of each."""
        for plant, one in self._binner.take(time, position, torque):
            self.each[plant].take(one)
        return self.said


class EffectMonitor:
    """Diagnoses one plant: bins of its joints in, a diagnosis out.

    Attributes:
        said: the diagnosis.
    """

    _change: ParameterChange | None

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        plant: PlantBins,
        blank: OnlineDiagnosis,
        given: Fit | None = None,
    ) -> None:
        """Take model, effects, the plant, what is said at first, and parameters that the plant is compared with."""
        self._base, self._library, self._plant, self._blank = tuple(terms), library, plant, blank
        self._given = given
        self.reset()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Of the running model."""
        return self._past[-1]

    def reset(self) -> None:
        """Forget all that was measured, and all effects that were added; given parameters are compared again."""
        self._past = [self._base]
        self._recent: deque[Bin] = deque(maxlen=2 * self._plant.bins_in(ONLINE.kept))
        self._begin()
        if self._given is not None:
            self._change = self._change_from(self._given, CHANGE.compare)

    def _begin(self, kept: Sequence[Bin] = ()) -> None:
        """Begin to compare models, from kept bins; the comparison with given parameters ends."""
        self._contest, self._change = self._contest_of(kept), None
        self.said = replace(self._blank, terms=self.terms, added=self._added)

    def _contest_of(self, kept: Sequence[Bin] = (), usual: UsualGain | None = None) -> Contest:
        library = {id: effect for id, effect in self._library.items() if id not in self._added}
        return Contest(self.terms, library, self._plant, kept, usual)

    def _change_from(self, before: Fit, seconds: float, since: float | None = None) -> ParameterChange:
        """Change from former parameters, to be reported after a time of motion [s]."""
        names = [column.name for term in self.terms for column in term.columns]
        return ParameterChange(names, before, self._plant.bins_in(seconds), since)

    @property
    def _block(self) -> int:
        """Bins of all joints in a block."""
        return BLOCK * len(self._plant.joints)

    @property
    def _added(self) -> tuple[str, ...]:
        return tuple(term.id for term in self.terms[len(self._base) :])

    # ------------------------------------------------------------------------------------------------------ the model

    def add(self, effect: str) -> Term:
        """Take an effect into the running model, with the shape that predicted best.

        The comparison of models begins anew; that with given parameters ends.

        Raises:
            ValueError: if there is no effect of that id beside the model, or too little has been seen.
        """
        find("effect that is run", effect, self._library)
        if effect in self._added:
            raise ValueError(f"{effect} is in the model already: undo takes out what was added last")
        term = next((term for (term,), _ in self._contest.leaders[1:] if term.id == effect), None)
        if term is None:
            raise ValueError(f"{effect} has not been tried yet: wait until the diagnosis no longer calibrates")
        self._past.append((*self.terms, term))
        self._begin(self._contest.kept)
        return term

    def undo(self) -> None:
        """Take out the effect that was added last.

        The comparison of models begins anew; that with given parameters ends.

        Raises:
            ValueError: if none was added.
        """
        if len(self._past) == 1:
            raise ValueError("no effect was added that could be undone")
        self._past.pop()
        self._begin(self._contest.kept)

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, one: Bin) -> None:
        """Take in a bin of motion."""
        self._recent.append(one)
        ended = self._contest.take(one)
        if self._contest.has_begun_to_move(one.joint):
            change = self._change
            self._begin(self._contest.kept)
            self._change = change
        elif ended:
            self._judge()

    def _judge(self) -> None:
        """Look for the cause of an alarm, and renew the diagnosis if it is time."""
        contest, threshold = self._contest, self._blank.threshold
        change, evidence = float(contest.bets.each[-1]), contest.bets.joint
        is_known = self.said.kind == "missing"
        # what is missing already is evidence all the time: forgetting then has to suffice alone
        is_suspect = change >= threshold + np.log(len(contest.bets.each)) if is_known else change >= CHANGE.suspect
        if evidence >= threshold and is_suspect:
            if (row := self._row_of_change()) is None:
                return  # a change is judged when enough has been seen since
            if self._accept_change(row):
                self._tell()
                return
            contest.bets.restart(-1)
        if contest.is_stretch or (contest.bets.joint >= threshold and not is_known):
            self._tell()

    def _row_of_change(self) -> int | None:
        """Return the number of the recent bin from which on other parameters fit best; None if it is too early."""
        recent, plant, risen = list(self._recent), self._plant, self._contest.risen
        calibrate = ceil(ONLINE.calibrate / plant.length)
        needed = calibrate + plant.bins_in(CHANGE.judged)
        if risen < needed:
            return None
        last = len(recent) - needed
        first = min(max(calibrate, len(recent) - risen - calibrate), last)
        row = find_change(*self._contest.rows(recent), first, last + BLOCK)
        return min(row, last) if row <= last or risen >= 2 * needed else None

    def _accept_change(self, change: int) -> bool:
        """Go on with models fitted since a change, if they predict what came since better than those before it."""
        recent, plant = list(self._recent), self._plant
        contest = self._contest_of(usual=deepcopy(self._contest.usual))
        predicted = len(recent) - change - ceil(ONLINE.calibrate / plant.length)
        since = recent[change + predicted % BLOCK :]  # whole blocks
        for one in since:
            contest.take(one)
        blocks = len(contest.blocks)
        if contest.best_density(blocks) < self._contest.best_density(blocks) + self._blank.threshold:
            return False
        before = fit(*self._contest.rows(recent[:change]), self._block)
        self._change = self._change_from(before, CHANGE.sure, float(recent[change].series[TIME, 0]))
        self._contest = contest
        self._recent = deque(since, maxlen=self._recent.maxlen)
        return True

    # -------------------------------------------------------------------------------------------------------- the word

    def _tell(self) -> None:
        contest = self._contest
        leaders = contest.leaders
        verdict = replace(
            self._blank,
            terms=self.terms,
            theta=self._theta(*leaders[0]),
            motion=contest.seen * self._plant.length,
            error=contest.error,
            added=self._added,
            not_run={**self._blank.not_run, **contest.not_run},
        )
        self.said = verdict if len(contest.blocks) < 2 else self._rank(verdict, leaders[1:])

    def _rank(self, verdict: OnlineDiagnosis, leaders: Sequence[tuple[tuple[Term, ...], Array]]) -> OnlineDiagnosis:
        """Return a verdict with the ranking of effects, and with changes of parameters."""
        blocks, bets = self._contest.stretches[:, :-1], self._contest.bets
        bootstrap = Bootstrap(np.zeros(len(blocks), dtype=np.intp), np.random.default_rng(0))
        none, *odds = bootstrap.probabilities(list(blocks.T)).tolist()
        penalty = float(np.log(max(1, len(odds))))
        ranking = []
        each = zip(leaders, blocks.T[1:], odds, bets.each[:-1].tolist(), strict=True)
        for ((term,), theta), densities, probability, sure in each:
            gain = bootstrap.gain(densities, blocks[:, 0], penalty)
            numbers = probability, gain.total, gain.error, gain.p_value, sure
            ranking.append(Standing(term.id, *numbers, term, self._theta((term,), theta)))
        ranking.sort(key=lambda one: (-round(one.probability, 3), -one.gain))
        is_missing = bool(ranking) and ranking[0].gain > 0 and self._has_missing_effect
        group = [ranking[0].effect] if is_missing else []
        group += [one.effect for one in ranking if is_missing and one.probability > Criterion.tie_probability]
        self._compare()
        change = self._change
        changed: Mapping[str, tuple[float, float]] = {} if is_missing or change is None else change.changed
        return replace(
            verdict,
            kind="missing" if is_missing else "changed" if changed else "nothing",
            ranking=tuple(ranking),
            group=tuple(dict.fromkeys(group)),
            none=none,
            evidence=bets.joint,
            changed=changed,
            since=None if change is None else change.since,
        )

    @property
    def _has_missing_effect(self) -> bool:
        """Return whether the bets on effects reach the threshold; after a change, which was an alarm, half of it.

        If another change is suspected, the whole threshold has to be reached: effects imitate a change.
        """
        after_change = self._change is not None and self._change.since is not None and not self._is_changing_again
        after_change = after_change and len(self._contest.kept) < self._plant.bins_in(ONLINE.kept)
        return self._contest.effect_evidence >= self._blank.threshold * (CHANGE.share if after_change else 1.0)

    @property
    def _is_changing(self) -> bool:
        """Return whether the bet on forgetting suspects a change."""
        return bool(self._contest.bets.each[-1] >= CHANGE.suspect)

    @property
    def _is_changing_again(self) -> bool:
        """Return whether a change is suspected, and was not in the first second of predictions."""
        return self._is_changing and self._contest.seen - self._contest.risen >= self._plant.bins_in(CHANGE.judged)

    def _compare(self) -> None:
        """Compare parameters with former ones, unless they seem to change again."""
        contest = self._contest
        if self._change is not None and not self._is_changing:
            if self._change.is_due(len(contest.kept)):
                self._change.compare(*contest.rows(contest.kept), self._block)

    def _theta(self, more: tuple[Term, ...], theta: Array) -> dict[str, float]:
        names = [column.name for term in (*self.terms, *more) for column in term.columns]
        return dict(zip(names, theta.tolist(), strict=False))


def hindrance(effect: type[Term]) -> Obstacle | None:
    """Return why an effect cannot be followed online; None if it can."""
    if effect.start is not Term.start:
        return Obstacle.HAS_STATE
    if effect.delay is not Term.delay:
        return Obstacle.IS_DELAY
    if len(loads(effect.at)) > 1:
        return Obstacle.LOADS_TWO_JOINTS
    if any(parameter.instant for parameter in effect.nonlinear_parameters):
        return Obstacle.IS_SUDDEN
    return None
