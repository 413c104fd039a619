"""What a model lacks, said while the pendulum runs: every effect of the library beside it, by the one score.

The running model is fitted to the first seconds of motion. From then on it, and the same with each effect, predict
every bin before they learn from it (`rivals`). What each gains in log predictive density, second of motion by second,
is judged as offline: by the Bayesian bootstrap over these stretches (`estimators.selection.score`). That something is
missing at all is said when the bets on it have won enough (`evidence`): as often by mistake as is accepted per hour.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.online.binning import Bin, Binner
from estimators.online.evidence import Bets, threshold_of
from estimators.online.grids import refined, thinned
from estimators.online.rivals import Bins, Family, Rivals
from estimators.online.watch import BLOCK
from estimators.selection.criterion import Criterion
from estimators.selection.score import STRETCH, Bootstrap
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Samples, Term, effects

CALIBRATE = 1.0  # [s] of motion, that all models are fitted to before they predict
REFINE = (2, 4, 8, 16)  # [s] of motion, after which grids of shape parameters are refined
KEPT = 16.0  # [s] of motion, that a model which begins later is fitted to
STRETCHES = 60  # the latest ones, that probabilities are told from
TOGETHER = 5  # bins, whose equations are made at once
FEWEST = 5  # stretches that probabilities are told from; while there are fewer, blocks take their place
WORTH = 0.01  # nat a bin, that a gain has to exceed to be one: errors a hundredth smaller


@dataclass(frozen=True)
class Standing:
    """How one effect does beside the running model.

    Attributes:
        effect: its id.
        probability: that it predicts best, of all effects and of none.
        gain: log predictive density over the running model [nat].
        error: its standard error, from the scatter between stretches [nat].
        chance: that nothing is gained.
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
    """What is said of a running model; it changes once per second of motion.

    Attributes:
        kind: "calibrating", "nothing" while no effect surely predicts better than none, or "missing".
        evidence: that some effect predicts better: log wealth of the bets on all [nat].
        threshold: from which on something is missing [nat].
        terms: of the running model.
        theta: its parameters by name.
        ranking: of effects, likeliest first.
        group: ids of the likeliest effect and those that may as well be in its place; empty unless one is missing.
        none: probability that no effect predicts better than the running model.
        motion: time of motion since the model began to run [s].
        error: root mean square a-priori error of the running model over the last seconds of motion [N m].
        added: ids of effects taken into it.
        not_run: effects that cannot be followed online, with the reason.
    """

    kind: str
    terms: tuple[Term, ...]
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


class Diagnoser:
    """Diagnoses one pendulum, sample by sample.

    Attributes:
        said: what is said now.
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        *,
        library: Mapping[str, type[Term]] | None = None,
        smoothing: Smoothing | None = None,
        alarms_per_hour: float = 1.0,
        criterion: Criterion | None = None,
        seed: int = 0,
    ) -> None:
        """Take a model and the effects that it may lack.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with their shape parameters set.
            library: effects by id; None are all that are known.
            smoothing: of the measurement; without one, that of the paper's encoder at this rate.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.
            criterion: its `rival` decides what may as well be in an effect's place.
            seed: of the bootstrap.

        Raises:
            ValueError: if a number is out of its range, or a term of the model depends on the past.
        """
        if not 0 < rate < np.inf:
            raise ValueError(f"rate ({rate:g}) has to be positive")
        reasons = {term.id: reason for term in terms if (reason := hindrance(type(term)))}
        if reasons:
            raise ValueError(f"{next(iter(reasons))} cannot be in a model that is diagnosed online: take it out of it")
        library = effects() if library is None else library
        self.not_run = {id: reason for id, effect in library.items() if (reason := hindrance(effect))}
        self.library = {id: effect for id, effect in library.items() if id not in self.not_run}
        self.rate, self.criterion, self._seed = rate, criterion or Criterion(), seed
        self._base, self._period = tuple(terms), 1.0 / rate
        self._binner = Binner(rate, smoothing or Smoothing.of_encoder(COUNTS, rate), 1)
        self._every = self._binner.every
        self.threshold = threshold_of(alarms_per_hour, BLOCK * self._every * self._period)
        self.reset()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Of the running model."""
        return self._past[-1]

    def reset(self) -> None:
        """Forget all that was measured, and all effects that were added."""
        self._past = [self._base]
        self._kept: list[tuple[Array, float]] = []  # bins with motion
        self._binner.reset(np.ones(1, dtype=bool))
        self._begin()

    def _begin(self) -> None:
        """Begin to compare models, from what is kept."""
        self._rivals: Rivals | None = None
        self._stretches: list[Array] = []
        self._stretch: list[Array] = []
        self._blocks: list[Array] = []  # of the first stretches
        self._errors: list[float] = []
        self._waiting: list[tuple[Array, float]] = []  # bins, to be taken together
        self._block: list[Array] = []  # gains in the block to come
        self._bins = 0  # of motion, that the models have seen
        self.said = OnlineDiagnosis(
            "calibrating", self.terms, threshold=self.threshold, added=self._added, not_run=self.not_run
        )
        if len(self._kept) * self._every >= CALIBRATE * self.rate:
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
        find("effect that is run", effect, self.library)
        if effect in self._added:
            raise ValueError(f"{effect} is in the model already: undo takes out what was added last")
        families = {} if self._rivals is None else {f.variants[0].id: f for f in self._rivals.families[1:]}
        if effect not in families:
            raise ValueError(f"{effect} has not been tried yet: wait until the diagnosis no longer calibrates")
        family = families[effect]
        term = family.variants[family.best]
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

    # ------------------------------------------------------------------------------------------------------- a sample

    def take(self, time: float, position: float, torque: float) -> OnlineDiagnosis:
        """Take in a sample: time [s], position [rad], and torque over the period that ends with it [N m]."""
        for one in self._binner.take(np.array([time]), np.array([position]), np.array([torque])):
            self.take_bin(one)
        return self.said

    def take_bin(self, one: Bin) -> None:
        """Take in a bin of motion, for whoever gathers the samples of many pendulums."""
        series, y = one.series, one.y
        if len(self._kept) * self._every < KEPT * self.rate:
            self._kept.append((series, y))
        if self._rivals is None:
            if len(self._kept) * self._every >= CALIBRATE * self.rate:
                self._fit()
            return
        self._waiting.append((series, y))
        if len(self._waiting) < TOGETHER:
            return
        told, errors = self._rivals.take(_bins(self._waiting, self._period))
        self._waiting = []
        self._stretch += list(told)
        self._errors += errors.tolist()
        self._bins += len(told)
        self._bet(told)
        if len(self._stretch) * self._every >= STRETCH * self.rate:
            self._stretches = [*self._stretches, np.sum(self._stretch, axis=0)][-STRETCHES:]
            self._errors = self._errors[-10 * len(self._stretch) :]
            self._stretch = []
            self._tell()
            seen = len(self._kept) * self._every / self.rate
            if len(self._kept) == self._bins + self._fitted and round(seen) in REFINE:
                self._refine()

    def _bet(self, densities: Array) -> None:
        """Add bins (R, F) to the block of all bets, and settle them at its end; an alarm is told at once."""
        self._block += list(densities)
        if len(self._block) < BLOCK:
            return
        block = np.sum(self._block, axis=0)
        self._bets.take((block[1:] - block[0] - WORTH * len(self._block))[None], np.ones(1, dtype=bool))
        self._block = []
        if len(self._stretches) < FEWEST:
            self._blocks.append(block)
            if self._bets.joint[0] >= self.threshold and self.said.kind != "missing":
                self._tell()

    # ------------------------------------------------------------------------------------------------------ the rivals

    @property
    def _all(self) -> Bins:
        """Bins that are kept."""
        return _bins(self._kept, self._period)

    def _fit(self) -> None:
        """Fit all models to what is kept: they predict from now on."""
        bins = self._all
        width = sum(len(term.columns) for term in self.terms)
        base = Family(self.terms, (), bins, width + 2)
        families = [base]
        for id, variants in self._grids(base, bins.middle):
            if id not in self._added and variants:
                families.append(Family(self.terms, thinned(variants), bins, width + 2))
        self._fitted = len(bins.y)
        self._rivals, self._bets = Rivals(families, self._fitted), Bets(1, len(families) - 1)

    def _grids(self, base: Family, x: Samples) -> Iterator[tuple[str, list[Term]]]:
        names = [column.name for term in self.terms for column in term.columns]
        known = dict(zip(names, base.theta[0].tolist(), strict=False))
        for id, effect in self.library.items():
            variants = [term for term in effect.grid(x, base.residual[:, 0]) if term.possible(x)]
            follows = {s.name: known[s.follows] for s in effect.shapes if s.follows in known}
            yield id, [_with(term, follows) for term in variants]

    def _refine(self) -> None:
        """Narrow the grids of continuous shape parameters round what predicts best."""
        assert self._rivals is not None
        bins = self._all
        base, *families = self._rivals.families
        width = base.width
        fresh = dict(self._grids(Family(self.terms, (), bins, width), bins.middle))
        renewed = [base]
        for family in families:
            first = family.variants[0]
            if all(shape.integer for shape in first.shapes):
                renewed.append(family)
                continue
            new = Family(self.terms, refined(family, fresh[first.id]), bins, width)
            old = dict(zip(family.variants, family.weight.tolist(), strict=True))
            share = -np.log(len(new.variants))  # the best one's weight, shared among those that are new
            new.weight = np.array([old.get(variant, share) for variant in new.variants])
            renewed.append(new)
        self._rivals = Rivals(renewed, len(bins.y))

    # -------------------------------------------------------------------------------------------------------- the word

    def _tell(self) -> None:
        assert self._rivals is not None
        base, *families = self._rivals.families
        said = {
            "terms": self.terms,
            "theta": self._theta(base, ()),
            "threshold": self.threshold,
            "motion": self._bins * self._every / self.rate,
            "error": float(np.sqrt(np.mean(np.square(self._errors)))),
            "added": self._added,
            "not_run": self.not_run,
        }
        told = np.array(self._stretches if len(self._stretches) >= FEWEST else self._blocks).T  # (families, stretches)
        if told.size == 0 or told.shape[1] < 2:
            self.said = OnlineDiagnosis("calibrating", **said)  # type: ignore[arg-type]
            return
        bootstrap = Bootstrap(np.zeros(told.shape[1], dtype=np.intp), np.random.default_rng(self._seed))
        odds = bootstrap.probabilities(list(told))
        penalty = float(np.log(max(1, len(families))))
        ranking = []
        evidence = self._bets.evidence[0].tolist()
        for family, densities, probability, sure in zip(families, told[1:], odds[1:], evidence, strict=True):
            gain, term = bootstrap.gain(densities, told[0], penalty), family.variants[family.best]
            numbers = float(probability), gain.total, gain.error, gain.chance, sure
            ranking.append(Standing(term.id, *numbers, term, self._theta(family, (term,))))
        ranking.sort(key=lambda one: (-round(one.probability, 3), -one.gain))
        joint = float(self._bets.joint[0]) if ranking else -np.inf
        missing = joint >= self.threshold and ranking[0].gain > 0
        alike = [one.effect for one in ranking if one.probability > self.criterion.rival]
        group = tuple(dict.fromkeys([ranking[0].effect, *alike])) if missing else ()
        kind = "missing" if missing else "nothing"
        self.said = OnlineDiagnosis(
            kind,
            ranking=tuple(ranking),
            group=group,
            none=float(odds[0]),
            evidence=joint,
            **said,  # type: ignore[arg-type]
        )

    def _theta(self, family: Family, more: tuple[Term, ...]) -> dict[str, float]:
        names = [column.name for term in (*self.terms, *more) for column in term.columns]
        return dict(zip(names, family.theta[family.best].tolist(), strict=False))


def _bins(kept: Sequence[tuple[Array, float]], period: float) -> Bins:
    series, y = zip(*kept, strict=True)
    return Bins(np.stack(series, axis=1), np.array(y), period)


def _with(term: Term, values: Mapping[str, float]) -> Term:
    return type(term)(**{**term.shape, **values}) if values else term


def hindrance(effect: type[Term]) -> str:
    """Why an effect cannot be followed online; empty if it can."""
    if effect.start is not Term.start:
        return "depends on the past beyond what a sample tells"
    if effect.delay is not Term.delay:
        return "is a delay, which is not linear in anything"
    if any(shape.instant for shape in effect.shapes):
        return "happens at one moment: WatchModel tells when a value changes"
    return ""
