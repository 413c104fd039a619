"""Online diagnosis: comparison of the running model with the same model plus each effect of the library.

All models are fitted to the first seconds of motion. From then on the running model, alone and with each effect,
predicts every bin before its update (`competitors`). The gains in log predictive density per second of motion are
scored as offline, by a Bayesian bootstrap over these blocks (`estimators.decisions.score`). An effect is reported as
missing when the e-process passes its threshold (`evidence`), which follows from the accepted false alarms per hour.

The running model with forgetting also competes. After an alarm with evidence of forgetting, all models
are fitted again to the bins since the likely time of a change (`change`). If these models predict better than the
former models, they replace them. Since that time, an effect is missing or parameters have changed.

Bins wait, and a few parts of the computations follow each sample (`work`). Therefore, a diagnosis is up to a second of
motion later than its last bin.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import NOTHING_TESTED, Decision
from estimators.decisions.gate import Gate
from estimators.decisions.score import Bootstrap
from estimators.findings import Obstacle
from estimators.online.binning import Bin, Binner, PlantBins
from estimators.online.change import ParameterChange, ParameterFit, find_change, fit_rows
from estimators.online.evidence import ReferenceDistribution, compute_threshold
from estimators.online.model_comparison import ModelComparison
from estimators.online.settings import ONLINE
from estimators.online.stream import check_rate
from estimators.online.work import Work
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Term, effects, list_loads
from pendulum_env.physics.joints import Links
from pendulum_env.physics.terms import is_pure_delay

TIME_VARYING = "time-varying"  # kind of terms


@dataclass(frozen=True)
class RankingEntry:
    """Score of one effect added to the running model.

    Attributes:
        effect: id of the effect.
        probability: probability that the model with this effect predicts best.
        gain: log predictive density minus that of the running model [nat].
        error: standard error of the gain, from the scatter between blocks of a second [nat].
        p_value: p-value of the gain.
        evidence: log wealth of the e-process for this effect [nat].
        residual: typical a-priori error with this effect over the last seconds of motion, the scaled median [N m].
        term: effect with the nonlinear parameters that predicted best.
        theta: parameters of the running model and, last, of the effect, by name.
    """

    effect: str
    probability: float
    gain: float
    error: float
    p_value: float
    evidence: float
    residual: float
    term: Term
    theta: Mapping[str, float]


@dataclass(frozen=True)
class OnlineDiagnosis:
    """Verdict on a running model, updated once per second of motion.

    Attributes:
        kind: "calibrating"; "missing" for an effect; "changed" for parameters; "unexplained" for an error above
            `Criterion.misfit_ratio` floors if no effect explains a third of it, `diagnose` on the recording is then the
            next step; or "nothing".
        evidence: log of the mean wealth of the e-process over effects and forgetting [nat].
        threshold: evidence of an alarm [nat].
        terms: terms of the running model.
        theta: its parameters by name.
        ranking: scores of effects, the most probable first.
        decision: tests of the most probable effect.
        group: ids of the most probable effect and its competitors; empty unless an effect is missing.
        remains: True if the missing effect leaves an error above `Criterion.misfit_ratio` floors: something else is
            missing, too.
        none: probability that no effect predicts better than the running model.
        motion: time of motion since the model began to run [s].
        error: root mean square a-priori error of the running model over the last seconds of motion [N m].
        floor: part of the error by noise and discretisation [N m]; NaN while it is unknown, and with links.
        added: ids of effects added to the running model.
        not_run: effects without online diagnosis, with the reason.
        changed: change and standard error of each changed parameter in its unit, the most significant first; empty
            while an effect is missing.
        since: time of the last change of parameters or onset of an effect [s]; None before a change.
    """

    kind: str
    terms: tuple[Term, ...] = ()
    theta: Mapping[str, float] = field(default_factory=dict)
    ranking: tuple[RankingEntry, ...] = ()
    decision: Decision = NOTHING_TESTED
    group: tuple[str, ...] = ()
    remains: bool = False
    none: float = 1.0
    evidence: float = -np.inf
    threshold: float = np.inf
    motion: float = 0.0
    error: float = float("nan")
    floor: float = float("nan")
    added: tuple[str, ...] = ()
    not_run: Mapping[str, Obstacle] = field(default_factory=dict)
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    since: float | None = None

    def __repr__(self) -> str:
        """Return one line."""
        return (
            f"OnlineDiagnosis(kind={self.kind!r}, group={self.group}, remains={self.remains}, "
            f"changed={(*self.changed,)}, evidence={self.evidence:.3g}, threshold={self.threshold:.3g}, "
            f"motion={self.motion:.3g}, error={self.error:.3g}, floor={self.floor:.3g})"
        )


class Diagnoser:
    """Online diagnosis of B pendulums, or of a linked mechanism, one sample of each per step.

    Attributes:
        each: monitors, one per plant.
        rate: samples per second [Hz].
        batch: number B of plants.
        threshold: evidence of an alarm [nat].
        not_run: effects without online diagnosis, with the reason.
    """

    def __init__(
        self,
        rate: float,
        terms: Sequence[Term] = BASE,
        *,
        batch: int = 1,
        library: Mapping[str, type[Term]] | None = None,
        smoothing: Smoothing | None = None,
        given: ParameterFit | None = None,
        alarms_per_hour: float = 1.0,
        criterion: Criterion = Criterion(),
    ) -> None:
        """Create the diagnosis of a model.

        Args:
            rate: samples per second [Hz].
            terms: of the model, with values of their nonlinear parameters; links come first.
            batch: number B of pendulums.
            library: effects by id; None for all known effects.
            smoothing: smoothing of the measurement; by default, that of the paper's encoder at this rate.
            given: parameters of the model. Parameters of the plant that differ significantly are reported as changed,
                until an effect is added or undone, or parameters change.
            alarms_per_hour: accepted mean number of false alarms per hour of motion.
            criterion: thresholds of the decisions, as of `diagnose`.

        Raises:
            ValueError: if a number is out of its range, or a term of the model depends on the past.
        """
        check_rate(rate)
        reasons = {term.id: reason for term in terms if (reason := find_obstacle(type(term)))}
        if reasons:
            raise ValueError(
                f"{next(iter(reasons))} depends on the past and has no online diagnosis: remove it from the model"
            )
        library = effects() if library is None else library
        self.not_run = {id: reason for id, effect in library.items() if (reason := find_obstacle(effect))}
        library = {id: effect for id, effect in library.items() if id not in self.not_run}
        links = [term for term in terms if isinstance(term, Links)]  # their columns come with the bins
        self.rate, self.batch = rate, batch
        self._binner = Binner(rate, links, smoothing or Smoothing.from_encoder(COUNTS, rate), batch)
        plant = self._binner.plant
        self.threshold = compute_threshold(alarms_per_hour, ONLINE.bins.chunk * plant.length)
        blank = OnlineDiagnosis("calibrating", threshold=self.threshold, not_run=self.not_run)
        arguments = terms, library, plant, blank, criterion, given
        self.each = tuple(EffectMonitor(*arguments) for _ in range(batch))
        self._parts = ONLINE.work.per_bin * len(plant.joints) / plant.n_samples  # of work per sample

    @property
    def diagnoses(self) -> tuple[OnlineDiagnosis, ...]:
        """Return the diagnosis of each plant."""
        return tuple(monitor.diagnosis for monitor in self.each)

    def reset(self, which: Mask | None = None) -> None:
        """Restart plants (B,) with their next sample; all by default."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        self._binner.reset(mask)
        for b in np.flatnonzero(mask):
            self.each[b].reset()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[OnlineDiagnosis, ...]:
        """Add a sample of every plant, as `OnlineEstimator.take`; return the diagnosis of each."""
        for plant, bin_ in self._binner.take(time, position, torque):
            self.each[plant].take(bin_)
        for monitor in self.each:
            monitor.advance(self._parts)
        return self.diagnoses

    def finish(self) -> tuple[OnlineDiagnosis, ...]:
        """Complete the diagnoses of all samples so far, for example at the end of a recording; return them."""
        for monitor in self.each:
            monitor.finish()
        return self.diagnoses


class EffectMonitor:
    """Online diagnosis of one plant from bins of its joints.

    Attributes:
        diagnosis: the current diagnosis.
    """

    _change: ParameterChange | None

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        plant: PlantBins,
        blank: OnlineDiagnosis,
        criterion: Criterion,
        given: ParameterFit | None = None,
    ) -> None:
        """Create the monitor with its first diagnosis, and parameters to compare the plant with."""
        self._base, self._library, self._plant, self._blank = tuple(terms), library, plant, blank
        self._criterion, self._given = criterion, given
        self._chunk = ONLINE.bins.chunk * len(plant.joints)  # bins of all joints in a chunk
        self.reset()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Return the terms of the running model."""
        return self._past[-1]

    def reset(self) -> None:
        """Remove all data and added effects; given parameters are compared again."""
        self._past = [self._base]
        self._waiting, self._credit = deque[Bin](), 0.0  # bins, and parts to compute
        self._begin_comparison()
        self._recent: deque[Bin] = deque(maxlen=2 * self._comparison.fit_bins.n_most)
        if self._given is not None:
            self._change = self._make_change(self._given, ONLINE.limits.blocks * self._criterion.block)

    def _begin_comparison(self, bins: Sequence[Bin] = ()) -> None:
        """Begin a comparison of models with kept bins; the comparison with given parameters ends."""
        self._comparison, self._change = self._make_comparison(bins), None
        self._work: Work[None] | None = self._comparison.fit()
        self.diagnosis = replace(self._blank, terms=self.terms, added=self._added)

    def _make_comparison(
        self, bins: Sequence[Bin] = (), reference: ReferenceDistribution | None = None
    ) -> ModelComparison:
        """Create a comparison of the running model with the effects that it lacks."""
        library = {id: effect for id, effect in self._library.items() if id not in self._added}
        return ModelComparison(self.terms, library, self._plant, bins, reference, block=self._criterion.block)

    def _make_change(self, before: ParameterFit, seconds: float, since: float | None = None) -> ParameterChange:
        """Create the change from former parameters; it is reported after a time of motion [s]."""
        names = [column.name for term in self.terms for column in term.columns]
        return ParameterChange(names, before, self._plant.count_bins(seconds), since)

    @property
    def _added(self) -> tuple[str, ...]:
        return tuple(term.id for term in self.terms[len(self._base) :])

    # -------------------------------------------------------------------------------------------------- running model

    def add(self, effect: str) -> Term:
        """Add an effect to the running model, with the nonlinear parameters that predicted best.

        The comparison of models restarts; the comparison with given parameters ends.

        Raises:
            ValueError: if the effect is unknown, in the model already, or not tried yet.
        """
        find("effect that is run", effect, self._library)
        if effect in self._added:
            raise ValueError(f"{effect} is in the model already: undo removes the effect that was added last")
        term = next((term for (term,), _ in self._comparison.leaders[1:] if term.id == effect), None)
        if term is None:
            raise ValueError(f"{effect} has not been tried yet: wait until the diagnosis no longer calibrates")
        self._past.append((*self.terms, term))
        self._begin_comparison(self._comparison.fit_bins.bins)
        return term

    def undo(self) -> None:
        """Remove the effect that was added last.

        The comparison of models restarts; the comparison with given parameters ends.

        Raises:
            ValueError: if no effect was added.
        """
        if len(self._past) == 1:
            raise ValueError("the model has no added effect: call add first")
        self._past.pop()
        self._begin_comparison(self._comparison.fit_bins.bins)

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, bin_: Bin) -> None:
        """Add a bin of motion, which waits for `advance`."""
        self._waiting.append(bin_)

    def advance(self, parts: float) -> None:
        """Compute parts of the work on waiting bins; a fraction of a part is kept for the next call."""
        self._credit += parts
        while self._credit >= 1.0:
            self._credit -= 1.0
            if not self._compute_part():
                self._credit = 0.0

    def finish(self) -> None:
        """Complete the diagnosis of all bins so far."""
        while self._compute_part():
            pass

    def _compute_part(self) -> bool:
        """Compute a part of the work; return False if there is none."""
        if self._work is None:
            if not self._waiting:
                return False
            self._work = self._process_bin(self._waiting.popleft())
        work = self._work
        try:
            next(work)
        except StopIteration:
            if self._work is work:  # and no comparison has begun
                self._work = None
        return True

    def _process_bin(self, bin_: Bin) -> Work[None]:
        """Pass a bin to the models; after a chunk, check the evidence."""
        self._recent.append(bin_)
        has_chunk_ended = yield from self._comparison.take(bin_)
        if self._comparison.fit_bins.has_begun_to_move(bin_.joint):
            change = self._change
            self._begin_comparison(self._comparison.fit_bins.bins)
            self._change = change
        elif has_chunk_ended:
            yield from self._check_alarm()

    def _check_alarm(self) -> Work[None]:
        """Check the evidence after a chunk: replace the models after a change, and update the diagnosis.

        The diagnosis is updated once per second of motion, and immediately when the evidence reaches the threshold.
        """
        gains, threshold = self._comparison.gains, self._blank.threshold
        change_evidence, evidence = float(gains.e_process.log_wealth[-1]), gains.e_process.log_mean_wealth
        is_known = self.diagnosis.kind == "missing"
        # a missing effect always gives evidence: forgetting alone must then reach the threshold
        limit = ONLINE.limits.change_evidence
        least = threshold + np.log(len(gains.e_process.log_wealth)) if is_known else limit
        if evidence >= threshold and change_evidence >= least:
            if (change := (yield from self._locate_change())) is None:
                return  # too early to compare a change
            if (yield from self._accept_change(change)):
                yield from self._update_diagnosis()
                return
            gains.e_process.restart(-1)
        if gains.has_block_ended or (gains.e_process.log_mean_wealth >= threshold and not is_known):
            yield from self._update_diagnosis()

    def _locate_change(self) -> Work[int | None]:
        """Find the bin among the recent ones after which other parameters fit best.

        Returns:
            Its index; None while the bins since then are too few for a fit and a prediction.
        """
        recent, chunk = list(self._recent), ONLINE.bins.chunk
        n_since_rise, n_calibration = chunk * self._comparison.gains.n_since_rise, self._comparison.fit_bins.n_needed
        needed = n_calibration + self._plant.count_bins(self._criterion.block)
        if n_since_rise < needed:
            return None
        last = len(recent) - needed
        first = min(max(n_calibration, len(recent) - n_since_rise - n_calibration), last)
        rows = yield from self._comparison.linearise_rows(recent)
        row = yield from find_change(*rows, first, last + chunk)
        return min(row, last) if row <= last or n_since_rise >= 2 * needed else None

    def _accept_change(self, change: int) -> Work[bool]:
        """Replace the models by those fitted since a change, if these predict the bins since then better."""
        recent = list(self._recent)
        former = self._comparison
        comparison = self._make_comparison(reference=former.gains.reference)
        predicted = len(recent) - change - former.fit_bins.n_needed
        bins_since = recent[change + predicted % ONLINE.bins.chunk :]  # whole chunks
        for bin_ in bins_since:
            yield from comparison.take(bin_)
        chunks = len(comparison.gains.chunks)
        gain = comparison.gains.compute_best_density(chunks) - former.gains.compute_best_density(chunks)
        if gain < self._blank.threshold:
            return False
        rows = yield from former.linearise_rows(recent[:change])
        before = fit_rows(*rows, self._chunk)
        self._change = self._make_change(before, ONLINE.limits.report_time, recent[change].time)
        self._comparison = comparison
        self._recent = deque(bins_since, maxlen=self._recent.maxlen)
        return True

    # ------------------------------------------------------------------------------------------------------- diagnosis

    def _update_diagnosis(self) -> Work[None]:
        """Replace the diagnosis; effects are ranked after two chunks."""
        yield
        comparison = self._comparison
        leaders = comparison.leaders
        floor = yield from comparison.compute_floor(self._criterion.accuracy)
        verdict = replace(
            self._blank,
            terms=self.terms,
            theta=self._name_parameters(*leaders[0]),
            motion=comparison.n_predicted * self._plant.length,
            error=comparison.error,
            floor=floor,
            added=self._added,
            not_run={**self._blank.not_run, **comparison.not_run},
        )
        if len(comparison.gains.chunks) >= 2:
            verdict = yield from self._rank_effects(verdict, leaders[1:])
        self.diagnosis = verdict

    def _rank_effects(
        self, verdict: OnlineDiagnosis, leaders: Sequence[tuple[tuple[Term, ...], Array]]
    ) -> Work[OnlineDiagnosis]:
        """Return a verdict with the ranking of effects, and with changes of parameters.

        While an effect is missing, no changes of parameters are reported.
        """
        comparison, change, criterion = self._comparison, self._change, self._criterion
        blocks, e_process = comparison.gains.blocks[:, :-1], comparison.gains.e_process
        yield
        bootstrap = Bootstrap(np.zeros(len(blocks), dtype=np.intp))
        yield
        no_effect, *probabilities = bootstrap.probabilities(list(blocks.T)).tolist()
        penalty = float(np.log(max(1, len(probabilities))))
        ranking = []
        error_alone, *errors = comparison.typical_errors.tolist()
        numbers_of_effects = probabilities, e_process.log_wealth[:-1].tolist(), errors
        effects = zip(leaders, blocks.T[1:], *numbers_of_effects, strict=True)
        for ((term,), theta), densities, probability, log_wealth, residual in effects:
            yield
            gain = bootstrap.gain(densities, blocks[:, 0], penalty)
            numbers = probability, gain.total, gain.error, gain.p_value, log_wealth
            ranking.append(RankingEntry(term.id, *numbers, residual, term, self._name_parameters((term,), theta)))
        ranking.sort(key=lambda entry: (-round(entry.probability, 3), -entry.gain))
        is_changing = bool(e_process.log_wealth[-1] >= ONLINE.limits.change_evidence)
        decision = self._decide(ranking, is_changing)
        is_missing, is_unexplained, remains = bool(ranking) and decision.passed, False, False
        if is_missing:
            left, floor = ranking[0].residual, verdict.floor
            if remains := bool(left > criterion.misfit_ratio * floor):
                excess = error_alone**2 - floor**2
                share, least = (error_alone**2 - left**2) / max(excess, 1e-300), ONLINE.limits.least_explained
                decision = decision.join(Decision((Gate("explained_share", share, least, share >= least),)))
                # a law in time alone imitates any error of a periodic motion
                is_unexplained = share < least or ranking[0].term.kind == TIME_VARYING
        else:  # a suspected change, which raises the error, is accepted or rejected within this time
            n_since_rise = ONLINE.bins.chunk * comparison.gains.n_since_rise
            n_bins = n_since_rise if is_changing else comparison.n_predicted
            is_unexplained = n_bins >= self._plant.count_bins(ONLINE.limits.blocks * criterion.block)
            is_unexplained &= verdict.error > criterion.misfit_ratio * verdict.floor
        is_missing &= not is_unexplained
        group = [ranking[0].effect] if is_missing else []
        group += [entry.effect for entry in ranking if is_missing and entry.probability > criterion.tie_probability]
        if change is not None and not is_changing and change.is_due(len(comparison.fit_bins.bins)):
            rows = yield from comparison.linearise_rows(comparison.fit_bins.bins)
            change.compare(*rows, self._chunk)
        changed: Mapping[str, tuple[float, float]] = {} if is_missing or change is None else change.changed
        return replace(
            verdict,
            kind="missing" if is_missing else "changed" if changed else "unexplained" if is_unexplained else "nothing",
            ranking=tuple(ranking),
            decision=decision,
            group=tuple(dict.fromkeys(group)),
            remains=remains and is_missing,
            none=no_effect,
            evidence=e_process.log_mean_wealth,
            changed=changed,
            since=None if change is None else change.since,
        )

    def _decide(self, ranking: Sequence[RankingEntry], is_changing: bool) -> Decision:
        """Decide on the most probable effect by its gain, and by the evidence of all effects.

        The limit of the evidence is the threshold, or half of it after a change with an alarm. While another change is
        suspected, the whole threshold applies, because effects imitate a change. A suspicion since the first second of
        predictions does not count as another change.
        """
        gains, fit_bins = self._comparison.gains, self._comparison.fit_bins
        after_change = self._change is not None and self._change.since is not None
        after_change &= len(fit_bins.bins) < fit_bins.n_most
        n_before = self._comparison.n_predicted - ONLINE.bins.chunk * gains.n_since_rise
        after_change &= not (is_changing and n_before >= self._plant.count_bins(self._criterion.block))
        limit = (ONLINE.limits.share_after_change if after_change else 1.0) * self._blank.threshold
        evidence = Gate("evidence", gains.effect_evidence, limit, gains.effect_evidence >= limit, "nat")
        best = [Gate("gain", entry.gain, 0.0, entry.gain > 0, "nat", entry.error) for entry in ranking[:1]]
        return Decision((*best, evidence))

    def _name_parameters(self, added: tuple[Term, ...], theta: Array) -> dict[str, float]:
        """Return parameters of the running model and of added terms by name."""
        names = [column.name for term in (*self.terms, *added) for column in term.columns]
        return dict(zip(names, theta.tolist(), strict=False))


def find_obstacle(effect: type[Term]) -> Obstacle | None:
    """Find the reason why an effect has no online diagnosis; None if it has a diagnosis."""
    if effect.has_state() and not is_pure_delay(effect):
        return Obstacle.HAS_STATE
    if len(list_loads(effect.at)) > 1:
        return Obstacle.LOADS_TWO_JOINTS
    if any(parameter.instant for parameter in effect.nonlinear_parameters):
        return Obstacle.IS_SUDDEN
    return None
