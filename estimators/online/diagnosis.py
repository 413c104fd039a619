"""Online diagnosis: the running model against itself with each effect of the library, by the one score.

All models are fitted to the first seconds of motion. From then on the running model, alone and with each effect,
predicts every bin before its update (`rivals`). The gains in log predictive density per second of motion are judged as
offline, by a Bayesian bootstrap over these blocks (`estimators.selection.score`). An effect is reported as missing once
the e-process passes its threshold (`evidence`), which follows from the accepted false alarms per hour.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.online.binning import BLOCK, Bin, Binner, Monitors
from estimators.online.clock import checked_rate
from estimators.online.evidence import Bets, threshold_of
from estimators.online.rivals import ONLINE, Bins, Rivals, thinned
from estimators.selection.criterion import Criterion
from estimators.selection.score import BLOCK as STRETCH
from estimators.selection.score import Bootstrap
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array
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
        term: with the shape parameters that predicted best.
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
        kind: "calibrating", "nothing" while no effect predicts significantly better than none, or "missing".
        evidence: that some effect predicts better: log wealth of the bets on all [nat].
        threshold: from which on something is missing [nat].
        terms: of the running model.
        theta: its parameters by name.
        ranking: of effects, the most probable first.
        group: ids of the most probable effect and its competitors; empty unless one is missing.
        none: probability that no effect predicts better than the running model.
        motion: time of motion since the model began to run [s].
        error: root mean square a-priori error of the running model over the last seconds of motion [N m].
        added: ids of effects taken into it.
        not_run: effects that cannot be followed online, with the reason.
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
    not_run: Mapping[str, str] = field(default_factory=dict)


class Diagnoser(Monitors["EffectMonitor"]):
    """Diagnoses B pendulums, or an arm, one sample of each per step.

    Attributes:
        each: monitors, one a plant.
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
        alarms_per_hour: float = 1.0,
    ) -> None:
        """Take a model and the effects that it may lack.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their shape parameters set, of an arm its links first.
            batch: number B of pendulums.
            library: effects by id; None are all that are known.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.

        Raises:
            ValueError: if a number is out of its range, or a term of the model depends on the past.
        """
        checked_rate(rate)
        reasons = {term.id: reason for term in terms if (reason := hindrance(type(term)))}
        if reasons:
            raise ValueError(f"{next(iter(reasons))} cannot be in a model that is diagnosed online: take it out of it")
        library = effects() if library is None else library
        self.not_run = {id: reason for id, effect in library.items() if (reason := hindrance(effect))}
        library = {id: effect for id, effect in library.items() if id not in self.not_run}
        links = [term for term in terms if isinstance(term, Links)]  # whose columns come with the bins
        binner = Binner(rate, links, smoothing or Smoothing.of_encoder(COUNTS, rate), batch)
        length, joints = binner.every / rate, binner.joints  # of a bin [s]
        self.threshold = threshold_of(alarms_per_hour, BLOCK * length / len(joints))
        blank = OnlineDiagnosis("calibrating", threshold=self.threshold, not_run=self.not_run)
        each = [EffectMonitor(terms, library, joints, blank, length, 1 / rate) for _ in range(batch)]
        super().__init__(rate, binner, each)


class EffectMonitor:
    """Diagnoses one plant: bins of its joints in, a diagnosis out.

    Attributes:
        said: the diagnosis.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        joints: Sequence[str],
        blank: OnlineDiagnosis,
        length: float,
        period: float,
    ) -> None:
        """Take model, effects, joints, what is said at first, the length of a bin and the time between samples [s]."""
        self._base, self._library, self._blank = tuple(terms), library, blank
        self._joints, self._length = tuple(joints), length / len(joints)  # of motion that a bin tells of
        self._period = period
        self._often = max(1, round(STRETCH / (BLOCK * self._length)))  # blocks in a stretch
        self.reset()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Of the running model."""
        return self._past[-1]

    def reset(self) -> None:
        """Forget all that was measured, and all effects that were added."""
        self._past = [self._base]
        self._kept: list[Bin] = []
        self._moved = np.zeros(len(self._joints))  # time that each joint has been in motion [s]
        self._begin()

    def _begin(self) -> None:
        """Begin to compare models, from what is kept."""
        self._rivals: Rivals | None = None
        self._tried = np.zeros(len(self._joints), dtype=bool)  # joints that effects are tried at
        self._untried: dict[str, str] = {}  # effects that are not run for now, with the reason
        self._scale = np.ones(len(self._joints))  # of errors at each joint, relative to those of all
        self._waiting: list[Bin] = []  # to be taken together
        self._blocks: deque[Array] = deque(maxlen=ONLINE.stretches * self._often)  # log predictive densities (F,)
        self._errors: deque[float] = deque(maxlen=round(ONLINE.recent / self._length))
        self._block: Array | float = 0.0  # log predictive densities in the block to come (F,)
        self._seen = 0  # bins that the models have predicted
        self.said = replace(self._blank, terms=self.terms, added=self._added)
        if len(self._kept) * self._length >= ONLINE.calibrate:
            self._fit()

    @property
    def _added(self) -> tuple[str, ...]:
        return tuple(term.id for term in self.terms[len(self._base) :])

    # ------------------------------------------------------------------------------------------------------ the model

    def add(self, effect: str) -> Term:
        """Take an effect into the running model, with the shape that predicted best; the comparison begins anew.

        Raises:
            ValueError: if there is no effect of that id beside the model, or too little has been seen.
        """
        find("effect that is run", effect, self._library)
        if effect in self._added:
            raise ValueError(f"{effect} is in the model already: undo takes out what was added last")
        leaders = [] if self._rivals is None else self._rivals.leaders()[1:]
        term = next((term for (term,), _ in leaders if term.id == effect), None)
        if term is None:
            raise ValueError(f"{effect} has not been tried yet: wait until the diagnosis no longer calibrates")
        self._past.append((*self.terms, term))
        self._begin()
        return term

    def undo(self) -> None:
        """Take out the effect that was added last.

        Raises:
            ValueError: if none was added.
        """
        if len(self._past) == 1:
            raise ValueError("no effect was added that could be undone")
        self._past.pop()
        self._begin()

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, one: Bin) -> None:
        """Take in a bin of motion."""
        j = one.joint
        if self._moved[j] < ONLINE.kept:
            self._kept.append(one)
        self._moved[j] += self._length * len(self._joints)
        if self._rivals is None:
            if len(self._kept) * self._length >= ONLINE.calibrate:
                self._fit()
            return
        if not self._tried[j] and self._moved[j] >= ONLINE.calibrate:  # it had not moved until then
            self._begin()
            return
        self._waiting.append(one)
        if len(self._waiting) < ONLINE.together:
            return
        densities, errors = self._rivals.take(self._bins(self._waiting))
        self._waiting = []
        self._errors.extend(errors.tolist())
        self._block = block = self._block + densities.sum(axis=0)
        self._seen += ONLINE.together
        if self._seen % BLOCK:
            return
        self._block = 0.0
        self._blocks.append(block)
        self._bets.take(block[1:] - block[0] - ONLINE.worth * BLOCK)
        whole = self._seen % (BLOCK * self._often) == 0
        if whole or (self._bets.joint >= self._blank.threshold and self.said.kind != "missing"):
            self._tell()
        if whole and len(self._kept) == self._seen + self._fitted:  # no more than are kept have come
            if round(len(self._kept) * self._length) in ONLINE.refine:
                bins = self._bins(self._kept)
                self._rivals = self._rivals.narrowed(bins, dict(self._grids(Rivals(self.terms, bins), bins)))

    # ------------------------------------------------------------------------------------------------------ the rivals

    def _fit(self) -> None:
        """Fit all models to what is kept: they predict from now on."""
        self._tried = self._moved >= 0.5 * ONLINE.calibrate
        bins = self._bins(self._kept)
        base = Rivals(self.terms, bins)
        if len(self._joints) > 1:
            for joint in {one.joint for one in self._kept}:
                own = base.residual[bins.at == self._joints[joint]]
                self._scale[joint] = np.sqrt(max(float(np.mean(own**2)), 1e-12))
            self._scale /= self._scale.mean()
            bins = self._bins(self._kept)
            base = Rivals(self.terms, bins)
        variants = {id: own for id, own in self._grids(base, bins) if id not in self._added and own}
        self._untried = {
            id: "acts at a joint that has hardly moved yet" if self._is_idle(kind) else "has no form that shows here"
            for id, kind in self._library.items()
            if id not in variants and id not in self._added
        }
        self._fitted, self._bets = len(self._kept), Bets(len(variants))
        self._rivals = Rivals(self.terms, bins, [thinned(own) for own in variants.values()])

    def _is_idle(self, effect: type[Term]) -> bool:
        """Whether an effect's joint has hardly moved."""
        return not any(self._tried[[name == effect.at for name in self._joints]])

    def _bins(self, bins: Sequence[Bin]) -> Bins:
        return Bins.of(bins, self._period, self._joints, self._scale)

    def _grids(self, base: Rivals, bins: Bins) -> Iterator[tuple[str, list[Term]]]:
        """Variants that each effect may have, by what a model leaves of bins."""
        names = [column.name for term in self.terms for column in term.columns]
        known = dict(zip(names, base.theta_of()[0].tolist(), strict=False))
        for id, effect in self._library.items():
            if self._is_idle(effect):
                continue
            own = bins.at == effect.at
            x, residual = bins.of_joint(effect.at).middle, (base.residual * bins.scale)[own]
            possible = [term for term in effect.grid(x, residual) if term.possible(x)]
            fewest = min((len(term.columns) for term in possible), default=0)
            variants = [term for term in possible if len(term.columns) == fewest]  # a batch has as many in all of it
            follows = {s.name: known[s.follows] for s in effect.shapes if s.follows in known}
            yield id, [_with(term, follows) for term in variants]

    # -------------------------------------------------------------------------------------------------------- the word

    def _tell(self) -> None:
        assert self._rivals is not None
        leaders, blocks = self._rivals.leaders(), np.array(self._blocks)
        told = replace(
            self._blank,
            terms=self.terms,
            theta=self._theta(*leaders[0]),
            motion=self._seen * self._length,
            error=float(np.sqrt(np.mean(np.square(list(self._errors))))),
            added=self._added,
            not_run={**self._blank.not_run, **self._untried},
        )
        self.said = told if len(blocks) < 2 else self._ranked(told, leaders[1:], blocks)

    def _ranked(
        self, told: OnlineDiagnosis, leaders: Sequence[tuple[tuple[Term, ...], Array]], blocks: Array
    ) -> OnlineDiagnosis:
        """A diagnosis with the ranking of effects, by log predictive densities of blocks (N, F)."""
        if len(blocks) >= ONLINE.fewest * self._often:
            blocks = blocks[len(blocks) % self._often :].reshape(-1, self._often, blocks.shape[1]).sum(axis=1)
        bootstrap = Bootstrap(np.zeros(len(blocks), dtype=np.intp), np.random.default_rng(0))
        none, *odds = bootstrap.probabilities(list(blocks.T)).tolist()
        penalty = float(np.log(max(1, len(odds))))
        ranking = []
        each = zip(leaders, blocks.T[1:], odds, self._bets.each.tolist(), strict=True)
        for ((term,), theta), densities, probability, sure in each:
            gain = bootstrap.gain(densities, blocks[:, 0], penalty)
            numbers = probability, gain.total, gain.error, gain.chance, sure
            ranking.append(Standing(term.id, *numbers, term, self._theta((term,), theta)))
        ranking.sort(key=lambda one: (-round(one.probability, 3), -one.gain))
        evidence = self._bets.joint if ranking else -np.inf
        missing = evidence >= told.threshold and ranking[0].gain > 0
        group = [ranking[0].effect] if missing else []
        group += [one.effect for one in ranking if missing and one.probability > Criterion.rival]
        return replace(
            told,
            kind="missing" if missing else "nothing",
            ranking=tuple(ranking),
            group=tuple(dict.fromkeys(group)),
            none=none,
            evidence=evidence,
        )

    def _theta(self, more: tuple[Term, ...], theta: Array) -> dict[str, float]:
        names = [column.name for term in (*self.terms, *more) for column in term.columns]
        return dict(zip(names, theta.tolist(), strict=False))


def _with(term: Term, values: Mapping[str, float]) -> Term:
    return type(term)(**{**term.shape, **values}) if values else term


def hindrance(effect: type[Term]) -> str:
    """Why an effect cannot be followed online; empty if it can."""
    if effect.start is not Term.start:
        return "depends on the past beyond what a sample tells"
    if effect.delay is not Term.delay:
        return "is a delay, which is not linear in anything"
    if len(loads(effect.at)) > 1:
        return "loads two joints at once"
    if any(shape.instant for shape in effect.shapes):
        return "happens at one moment: WatchModel tells when a value changes"
    return ""
