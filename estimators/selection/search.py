"""The search for what a model lacks: one loop that adds, swaps and drops effects by one score.

Which effects are in the model is decided by the log predictive density of stretches that were not fitted (`score`).
An effect is added where it surely gains, explains a good part of the structure that is left, could be that of a body,
and lowers both held-out errors; then each effect is challenged by every other in its place, and by its own absence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, permutations

import numpy as np

from estimators.checks.physical import impossible, objection
from estimators.progress import Progress, no_progress
from estimators.regression.least_squares import information, least_squares, robust_covariance
from estimators.selection.candidates import Screen, Trial
from estimators.selection.criterion import Criterion
from estimators.selection.data import Evidence, Step, fit_terms, inertias, shape_jacobian
from estimators.selection.foils import FOILS, wanders
from estimators.selection.score import STRETCH, Bootstrap, Gain, Stretches, cross_validated, predicted
from estimators.simulation import multiple_shooting, output_error
from estimators.simulation.link_segments import has_link
from estimators.weak_form.dataset import Structure
from estimators.weak_form.shapes import bound, freed
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term, effects

ORDERED = 3  # effects up to which every order is tried
SAME = 1e-6  # of a torque, by which equal laws may differ numerically
MOMENT = 0.2  # [s], over which a torque that wanders hardly changes
UNLIKELY = 0.5  # chance that an effect gains nothing, from which its shape is not searched any further
TRIED = 8  # effects that are tried until one is confirmed

Terms = tuple[Term, ...]


@dataclass(frozen=True)
class Left:
    """Power of what a model leaves of some data of a joint.

    Attributes:
        all: mean square, with that of the torque noise that the model takes out [N^2 m^2].
        shared: that of what neighbouring windows share [N^2 m^2].
    """

    all: float
    shared: float

    def share_of(self, gone: float, count: int) -> float:
        """Share that power which is gone has in all that was no noise, so many windows telling what is left of it."""
        return gone / (gone + self.shared + self.all / count**0.5)


@dataclass
class Search:
    """Training and held-out data with the models that were tried on them.

    Attributes:
        train: recordings to fit.
        holdout: recordings to predict.
        progress: told what is being done.
        library: effects that may be named, by id.
        criterion: what they have to achieve.
        rng: of the bootstrap.
        unnamed: the law without a name that does the work of named ones, if one does.
        linked: the model with a link whose motion is watched, if there is one.
        base: terms that the search started from.
        foils: laws without a name that compete with the named ones.
    """

    train: Evidence
    holdout: Evidence
    progress: Progress = no_progress
    library: Mapping[str, type[Term]] = field(default_factory=effects)
    criterion: Criterion = field(default_factory=Criterion)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    unnamed: Term | None = None
    linked: Step | None = None
    base: Terms = BASE
    foils: Sequence[type[Term]] = FOILS

    def __post_init__(self) -> None:
        self.screen, self.held_out = self.train.screen, self.holdout.screen
        self.joints = self.train.data.joints
        self.inertia = inertias(self.screen, self.base)
        self._floors = [
            {at: part.data.part(at).noise(self.inertia[at]) for at in self.joints}
            for part in (self.train, self.holdout)
        ]
        self._where = [_stretches(part, STRETCH) for part in (self.train, self.holdout)]
        self._finer = [_stretches(part, MOMENT) for part in (self.train, self.holdout)]
        first, second = (where.of_stretch for where in self._where)
        same = self.train.recordings == self.holdout.recordings  # parts of the same recordings
        self.bootstrap = Bootstrap(np.concatenate([first, second if same else second + first.max() + 1]), self.rng)
        self._densities: dict[Terms, Array] = {}
        self._left: dict[Terms, tuple[dict[str, Left], dict[str, Left]]] = {}
        self._structures: dict[Terms, tuple[dict[str, Structure], dict[str, Structure]]] = {}
        self._in_motion: dict[Terms, Step] = {}

    # ------------------------------------------------------------------------------------------------------- the score

    def density(self, terms: Terms) -> Array:
        """Log predictive density of every stretch, those of the training data first, (S,) [nat]."""
        if terms not in self._densities and any(wanders(term) for term in terms):
            self._densities[terms] = self._fitted_anew(terms)
        if terms not in self._densities:
            fitted, unseen = (screen.equations(terms) for _, screen in self._parts)
            first, second = self._where
            inside = cross_validated(fitted, first, self.screen.hidden_noise(terms), self.screen.solve_without(terms))
            outside = predicted(self.screen.solve(terms), unseen, second, self.held_out.hidden_noise(terms))
            told = np.concatenate([inside, outside])
            if fitted.recorded is not None and unseen.recorded is not None:
                known = replace(fitted.recorded, weights=self.screen.weights(terms))
                recorded = np.concatenate(
                    [cross_validated(known, first), predicted(known.solve(), unseen.recorded, second)]
                )
                without = tuple(term for term in terms if not term.lead)
                if self.bootstrap.gain(recorded, self.density(without)).chance > self.criterion.chance:
                    told = recorded  # a filter that only makes the torque smaller
            self._densities[terms] = told
        return self._densities[terms]

    def _fitted_anew(self, terms: Terms) -> Array:
        """The same, fitted to each part of the data anew: what wanders does so in each recording otherwise.

        There each moment tells the next, so that folds are shorter than stretches.
        """
        parts = []
        for (part, screen), where in zip(self._parts, self._finer, strict=True):
            here = _wandering_in(part, terms)
            parts.append(cross_validated(screen.balance(here), where, screen.hidden_noise(here)))
        return np.concatenate(parts)

    def gain(self, after: Terms, before: Terms) -> Gain:
        """What one model predicts better than another; the more variants were tried, the more it has to be."""
        return self.bootstrap.gain(self.density(after), self.density(before), self.penalty(after, before))

    def penalty(self, after: Terms, before: Terms) -> float:
        """Logarithm of the number of models that were tried: the best of so many gains that much by chance."""
        return float(np.log(max(1, len(self.library) * self.variants(after, before))))

    def variants(self, after: Terms, before: Terms) -> int:
        """Variants that were looked at of the effects by which one model is larger than another, at least one."""
        added = [term for term in after if term.id not in {other.id for other in before}]
        return max(1, sum(self.screen.looked_at(before, type(term)) for term in added))

    def is_sure(self, after: Terms, before: Terms) -> bool:
        """Whether one model predicts surely better than another."""
        return self.gain(after, before).chance <= self.criterion.chance

    def left(self, terms: Terms) -> tuple[dict[str, Left], dict[str, Left]]:
        """What a model leaves of each joint of the training data, and of those that are held out, as it was fitted."""
        if terms not in self._left:
            if any(wanders(term) for term in terms):
                residuals = [screen.residual(_wandering_in(part, terms)) for part, screen in self._parts]
            else:
                theta = self.screen.solve(terms)
                residuals = [screen.equations(terms).error(theta) for _, screen in self._parts]
            first, second = (
                self._left_of(part, screen, terms, residual)
                for residual, (part, screen) in zip(residuals, self._parts, strict=True)
            )
            self._left[terms] = first, second
        return self._left[terms]

    def _left_of(self, part: Evidence, screen: Screen, terms: Terms, residual: Array) -> dict[str, Left]:
        known, left = self._structures_of(part, residual), {}
        for at in self.joints:
            hidden = screen.hidden_noise([term for term in terms if term.at == at])
            power = float(np.mean(residual[part.data.where(at)] ** 2)) + sum(variance for _, variance in hidden)
            left[at] = Left(power, known[at].shared ** 2)
        return left

    def structures(self, terms: Terms) -> tuple[dict[str, Structure], dict[str, Structure]]:
        """What neighbouring windows of each joint share of the residual, fitted and `unseen`."""
        if terms not in self._structures:
            first, second = (
                self._structures_of(part, residual)
                for part, residual in ((self.train, self.screen.residual(terms)), (self.holdout, self.unseen(terms)))
            )
            self._structures[terms] = first, second
        return self._structures[terms]

    def _structures_of(self, part: Evidence, residual: Array) -> dict[str, Structure]:
        data = part.data
        return {at: data.part(at).structure(residual[data.where(at)], self.inertia[at]) for at in self.joints}

    def is_noise(self, part: Evidence, residual: Array) -> bool:
        """Whether a residual (R,) [N m] of the training or of the held-out data may as well be noise."""
        return self._are_noise(part, self._structures_of(part, residual))

    def _are_noise(self, part: Evidence, structures: Mapping[str, Structure]) -> bool:
        return all(self.criterion.is_noise(own, self.noise_of(part, at)) for at, own in structures.items())

    @property
    def floor(self) -> float:
        """Torque error that measurement noise alone gives on the training data of a joint, the first one [N m]."""
        return self.noise_of(self.train)

    def noise_of(self, part: Evidence, at: str | None = None) -> float:
        """Torque error that measurement noise alone gives there [N m]."""
        return self._floors[0 if part is self.train else 1][self.joints[0] if at is None else at]

    def shows(self, terms: Terms) -> bool:
        """Whether the terms leave more than white noise of what is fitted, at any joint."""
        return any(
            self.criterion.shows(own, self.noise_of(self.train, at)) for at, own in self.structures(terms)[0].items()
        )

    def are_noise(self, terms: Terms) -> tuple[bool, bool]:
        """Whether the terms leave noise only, of what is fitted, and of what is held out."""
        first, second = self.structures(terms)
        return self._are_noise(self.train, first), self._are_noise(self.holdout, second)

    def fits(self, terms: Terms) -> bool:
        """Whether the terms leave noise only, of what is fitted and of what is held out."""
        return all(self.are_noise(terms))

    def unseen(self, terms: Terms) -> Array:
        """What the terms leave of the held-out data (R,) [N m], fitted anew as far as the first fit may have erred.

        A law that is right has the same parameters wherever it is fitted. One that only imitates another law along one
        motion needs others along the next.
        """
        known, data, balance = (
            fit_terms(self.train, terms, self.screen)[1],
            self.holdout.data,
            self.held_out.balance(terms),
        )
        free = np.flatnonzero(np.diag(known.covariance))  # others are known, or at their bounds
        slopes = balance.slopes(known.theta, shape_jacobian(data, terms, known.theta)[0])[:, free]
        error, weights = balance.error(known.theta), balance.weights
        step = least_squares(slopes * weights[:, None], error * weights)
        covariance = robust_covariance(slopes * weights[:, None], (error - slopes @ step) * weights, data.clusters)
        told, asked = information(known.covariance[np.ix_(free, free)]), information(covariance)
        return np.asarray(error - slopes @ least_squares(told + asked, asked @ step))

    @property
    def _parts(self) -> tuple[tuple[Evidence, Screen], tuple[Evidence, Screen]]:
        return (self.train, self.screen), (self.holdout, self.held_out)

    def explained(self, after: Terms, before: Terms) -> float:
        """Share of the power that one model leaves and is no noise, which another explains: at the joint of the most.

        Where the links' parameters imitate an effect at its own joint, other joints miss them.
        """
        return max(self.explained_at(at, after, before) for at in self.joints)

    def explained_at(self, at: str, after: Terms, before: Terms) -> float:
        """The same at a joint, the least of all data.

        Data have no say where the one model leaves white noise. No noise is what the other takes out of the residual,
        be it as sharp as an impact, and what neighbouring windows share of the rest, of which so many windows tell no
        less than their noise allows; where they surely share nothing, all that is more than noise is none.
        """
        least = self.train.data.part(at).precision() ** 2
        shares = []
        both = zip(self._parts, self.left(before), self.left(after), self.structures(before), strict=True)
        for (part, _), lefts, less, structures in both:
            old, new, structure, floor = lefts[at], less[at], structures[at], self.noise_of(part, at)
            gone = old.all - new.all
            if not self.criterion.shows(structure, floor):
                continue
            if gone <= least:
                shares.append(0.0)
            elif structure.sure >= self.criterion.sure:
                shares.append(new.share_of(gone, len(part.data.part(at).weights)))
            else:
                shares.append(gone / max(old.all - floor**2, gone))
        return min(shares, default=0.0)

    def explains(self, after: Terms, before: Terms) -> bool:
        """Whether that is a good share."""
        return self.explained(after, before) > self.criterion.share

    # ----------------------------------------------------------------------------------------------------- candidates

    def candidates(self, terms: Terms, barred: Iterable[str] = ()) -> list[Terms]:
        """The terms with the best variant of each effect that they lack, the best prediction first."""
        present = {term.id for term in terms} | set(barred)
        missing = [effect for id, effect in self.library.items() if id not in present]
        if has_transmission(terms):  # a joint has one
            missing = [effect for effect in missing if effect.kind != "transmission"]
        missing.sort(key=lambda effect: effect.kind == "transmission")  # last: they take long to search
        found: list[Terms] = []
        for done, effect in enumerate(missing):
            if effect.kind == "transmission" and (
                len(terms) > len(self.base) or any(self.fits(other) for other in (terms, *found))
            ):
                continue  # something simpler explains it all; or a transmission would have shown before all else
            self.progress(f"screening {effect.id}", done / len(missing))
            trial = self._promising(terms, effect)
            if trial is not None and not impossible(self._model(trial.terms), self.train.motions):
                found.append(trial.terms)
        return sorted(found, key=self._promise)

    def _promising(self, terms: Terms, effect: type[Term]) -> Trial | None:
        """The best variant of an effect; of one that is unlikely to gain or explain much, the best of a coarse grid."""
        if not effect.rugged:
            ranked = self.screen.ranked(terms, effect)
            if not ranked:
                return None
            if (
                self.gain(ranked[0].terms, terms).chance > UNLIKELY
                or self.explained(ranked[0].terms, terms) < self.criterion.glimpse
            ):
                return ranked[0]
        return self.best(terms, effect)

    def best(self, terms: Terms, effect: type[Term]) -> Trial | None:
        """The best variant of an effect, with as few shape parameters as the data allow; None where there is none."""
        trials = self.screen.variants(terms, effect)
        if not trials:
            return None
        simplest, *others = trials
        for trial in others:
            if self.is_sure(trial.terms, simplest.terms):
                simplest = trial
        return simplest

    def freer(self, terms: Terms) -> list[Terms]:
        """The terms with one more shape parameter of an effect off its usual value, for each that may be."""
        variants = [(term, variant) for term in terms[len(self.base) :] for variant in freed(term)]
        return [
            self._refined(tuple(new if other is old else other for other in terms), old.id) for old, new in variants
        ]

    def _refined(self, terms: Terms, id: str) -> Terms:
        return self.screen.refine(self.screen.trial(terms), id).terms

    def loosened(self, terms: Terms) -> Terms:
        """The terms with shape parameters off their usual values, as long as that surely predicts better."""
        for freer in sorted(self.freer(terms), key=self._promise):
            if self.is_sure(freer, terms) and not impossible(self._model(freer), self.train.motions):
                return self.loosened(freer)
        return terms

    def _promise(self, terms: Terms) -> float:
        return -float(self.density(terms).sum())

    def _model(self, terms: Terms) -> Model:
        """The terms fitted to the training data, without standard errors, which take longer."""
        return Model.build(terms, self.screen.solve(terms))

    def rivals(self, terms: Terms, term: Term) -> list[Terms]:
        """The terms with the best variant of every other effect in the place of one, the best prediction first."""
        others = tuple(other for other in terms if other is not term)
        barred = [id for id, effect in self.library.items() if effect.at != term.at]  # an effect acts where it is
        if self.fits(terms):
            barred += [id for id, effect in self.library.items() if effect.kind == "transmission"]  # which are slow
        return self.candidates(others, [term.id, *barred])

    def alternatives(self, terms: Terms, term: Term) -> dict[str, float]:
        """Probability of each effect in the place of one of the terms, itself first, by id.

        A more complex law that contains the term, as a spring contains an offset, is no rival, and nor is one with
        which held-out errors would not fall.
        """
        others = tuple(other for other in terms if other is not term)
        rivals = [rival for rival in self.rivals(terms, term) if not self._contains(rival[-1], term)]
        open_still: dict[Terms, bool] = {}
        while True:
            models = [terms, *rivals]
            odds = self.bootstrap.probabilities([self.density(model) for model in models])
            likely = [rival for rival, share in zip(rivals, odds[1:], strict=True) if share > self.criterion.rival]
            open_still.update(
                {rival: self._may_replace(rival, terms, others) for rival in likely if rival not in open_still}
            )
            refuted = [rival for rival in likely if not open_still[rival]]
            if not refuted:
                return dict(zip((term.id, *(rival[-1].id for rival in rivals)), odds.tolist(), strict=True))
            rivals = [rival for rival in rivals if rival not in refuted]

    def _may_replace(self, rival: Terms, terms: Terms, others: Terms) -> bool:
        """Whether a rival lowers both errors of the others, and the terms do not surely follow the motion better."""
        rival, terms, others = named(rival), named(terms), named(others)
        if not self._lowers_errors(rival, others):
            return False
        if has_transmission(rival) or has_transmission(terms) or not self.train.flights:
            return True  # flights are soon lost
        first, second = (self.in_motion(self.step(None, one)).model for one in (terms, rival))
        gain, share = self.flight_gain(first, second)
        return gain.chance > self.criterion.chance or share <= self.criterion.share

    def flight_gain(self, after: Model, before: Model) -> tuple[Gain, float]:
        """What one model gains over another in flights, fitted and held out, and the share of squared error it takes.

        The score is the one of the windows: errors of a flight predict alike at every sample, so that what is gained is
        the logarithm of their sizes, to which noise is added: errors below it say nothing.
        """
        parts = (self.train.flights, self.holdout.flights)
        points = [output_error.Point(model.terms, model.theta) for model in (after, before)]
        new, old = (np.concatenate([output_error.sizes(part, one) ** 2 for part in parts]) for one in points)
        counts = [sum(len(flight.first) for flight in part) for part in parts]
        owner = np.repeat(np.arange(2), counts)
        noise = np.array([output_error.noise(part, points[1]) ** 2 for part in parts])[owner]
        gain = Bootstrap(owner, np.random.default_rng(0)).gain(-0.5 * np.log(new + noise), -0.5 * np.log(old + noise))
        had, left = (float(np.mean((squares - noise)[: counts[0]])) for squares in (old, new))
        return gain, (had - left) / had if had > 0 else 0.0

    def _contains(self, larger: Term, term: Term) -> bool:
        """Whether a term with more parameters can be the same torque as another, whatever that is."""
        if complexity(larger) <= complexity(term) or not term.columns:
            return False
        (own,), (other,) = self.screen.columns([term]), self.screen.columns([larger])
        left = own.linear - other.linear @ np.linalg.lstsq(other.linear, own.linear, rcond=None)[0]
        return bool(np.linalg.norm(left) < SAME * np.linalg.norm(own.linear))

    def _lowers_errors(self, after: Terms, before: Terms) -> bool:
        """Whether both held-out errors fall, if not with the parameters that leave least torque, in motion."""
        new, old = self.step(None, after), self.step(None, before)
        return self.is_confirmed(new, old) or self.is_confirmed(self.in_motion(new), self.in_motion(old))

    # -------------------------------------------------------------------------------------------------------- the loop

    def find(self, base: Sequence[Term]) -> list[Step]:
        """Steps from the base model to the final one.

        Where the most promising first effect leads to no end, the search starts anew from the next ones.
        """
        self.base = start = self.settle(tuple(base))
        best = self.grow(start, start)
        if not self.fits(best):
            begun, firsts = {term.id for term in best}, self.candidates(start)
            for first in firsts[: self.criterion.beam]:
                if first[-1].id not in begun and self.is_sure(first, start) and self.is_level(first, firsts[0]):
                    other = self.grow(self.settle(first), start)
                    if self.is_sure(other, best) and self.are_confirmed(self.ladder(start, other)):
                        best = other
        return self.confirmed(start, self.owned(start, self.pruned(start, best)))

    def pruned(self, base: Terms, terms: Terms) -> Terms:
        """The terms without effects that explain less than what no effect does: they may be a part of that."""
        while not self.fits(terms):
            withouts = [tuple(t for t in terms if t is not term) for term in terms[len(base) :]]
            idle = [without for without in withouts if not self._is_needed(terms, without)]
            if not idle:
                break
            terms = min(idle, key=self._promise)
        return terms

    def _is_needed(self, terms: Terms, without: Terms) -> bool:
        return self.is_sure(terms, without) and self.explained(terms, without) > self.criterion.needed

    def confirmed(self, base: Terms, terms: Terms) -> list[Step]:
        """Steps to the terms, or to as many of them as lower both errors one after the other."""
        steps = self.ladder(base, terms)
        while not self.are_confirmed(steps):
            steps = self.ladder(base, steps[-2].model.terms)
        return steps

    def grow(self, terms: Terms, base: Terms) -> Terms:
        """Add effects while they gain; after each, swap and drop."""
        seen = {forms(terms)}
        while len(terms) - len(base) < self.criterion.most:
            longer = self.add(terms)
            if longer is None:
                break
            revised = self.revise(longer, base)
            if forms(revised) in seen:  # rather one effect too many, which is pruned in the end, than round in circles
                revised = longer
            follows = forms(revised) == forms(longer) or self.are_confirmed(self.ladder(base, revised))
            terms = revised if follows else longer
            if forms(terms) in seen:
                break
            seen.add(forms(terms))
        return terms

    def add(self, terms: Terms) -> Terms | None:
        """The terms with one more effect: of those that nothing speaks against and that predict alike, the simplest."""
        if not self.shows(terms):
            return None  # nothing can be learnt from white noise
        confirmed: list[Terms] = []
        for longer in sorted(self.candidates(terms) + self.freer(terms), key=self._promise)[:TRIED]:
            if confirmed and not self.is_level(longer, confirmed[0]):
                break
            if not (self.is_sure(longer, terms) and self.explains(longer, terms)):
                continue
            longer = self.settle(longer)
            self.progress(f"confirming {', '.join(sorted(one[0] for one in forms(longer) - forms(terms)))}", 0.9)
            if has_link(longer) and not has_link(terms):
                watched = self.watch(longer, terms) if not confirmed else None
                if watched is not None:
                    return watched
            elif self._lowers_errors(longer, terms):
                confirmed.append(longer)
        return min(confirmed, key=parameters, default=None)  # the likelier one of several

    def watch(self, longer: Terms, terms: Terms) -> Terms | None:
        """The terms of a model with a link, fitted along with the link's motion, which all that follows works with.

        Carried along the measured motion from the start, the link's state is soon lost, and its torque with it. None if
        the model is not confirmed even so.
        """
        step, before = self.step(longer[-1].id, longer), self.step(None, terms)
        self.progress(f"watching the link of {step.added}", 0.9)
        shot = self.with_errors(step.added, multiple_shooting.estimate(self.train.data.windows, step.model))
        found = [one for one in (shot, step) if self.is_confirmed(one, before)]
        if not found or not self.is_confirmed(found[0], self.in_motion(before)):
            return None
        self.linked = min(found, key=held_out_cost)
        model = self.linked.model
        self.train, self.holdout = self.train.watching(model), self.holdout.watching(model)
        self.screen, self.held_out = self.train.screen, self.holdout.screen
        for known in (self._densities, self._left, self._structures):
            known.clear()
        return model.terms

    def is_level(self, one: Terms, other: Terms) -> bool:
        """Whether the first of two models may well be the better one."""
        probability = self.bootstrap.probabilities([self.density(one), self.density(other)])[0]
        return bool(probability > self.criterion.rival)

    def revise(self, terms: Terms, base: Terms) -> Terms:
        """Drop effects that are not needed beside the others, and swap those in whose place another surely gains."""
        for _ in range(2 * self.criterion.most):
            changed = self._challenged(terms, base)
            if changed is None:
                break
            terms = self.settle(changed)
        return terms

    def _challenged(self, terms: Terms, base: Terms) -> Terms | None:
        withouts = [tuple(t for t in terms if t is not term) for term in terms[len(base) :]]
        tighter = [
            self._refined(tuple(new if t is old else t for t in terms), old.id)
            for old in terms[len(base) :]
            for new in bound(old)
        ]
        for without in sorted(withouts + tighter, key=self._promise):
            if not (self.is_sure(terms, without) and self.explains(terms, without)):
                return without
            if len(base) < len(without) < len(terms):
                term = next(term for term in terms if term not in without)
                for rival in self.rivals(terms, term)[:1]:
                    if self.is_sure(rival, terms):
                        return rival
        return None

    def settle(self, terms: Terms) -> Terms:
        """Search every shape parameter again, now that all terms are in."""
        trial = self.screen.trial(terms)
        for term in terms:
            if any(not shape.integer for shape in term.free) and term.id not in self.train.data.watched:
                trial = self.screen.refine(trial, term.id)
        return trial.terms

    def owned(self, base: Terms, terms: Terms) -> Terms:
        """The terms without effects that only imitate a law without a name, and with those that it had hidden.

        They do where that law, beside those that keep their place, surely predicts better and explains most of what
        they leave; and where a simpler law leaves only noise as well.
        """
        self.unnamed = None
        unsettled = not self.fits(terms)
        if len(terms) == len(base) and not unsettled:
            return terms
        leads: list[tuple[float, Terms]] = []  # and the terms with the law
        for law, left in self._with_foils(base, terms):
            # a law of time is fitted to each recording anew, and so have its rivals to be
            density = self._fitted_anew if wanders(law) else self.density
            lead = self.bootstrap.gain(density(left), density(terms), self.penalty(left, terms))
            if unsettled:
                takes_over = (
                    lead.chance <= self.criterion.chance and self.explained(left, terms) > self.criterion.needed
                )
            else:  # what leaves only noise gives way to a simpler law
                simpler = parameters(left) < parameters(terms)
                level = self.bootstrap.probabilities([density(left), density(terms)])[0] > self.criterion.rival
                takes_over = simpler and level and self.fits(left)
            if takes_over:
                leads.append((lead.total, left))
        if not leads:
            return terms
        *_, left = max(leads, key=lambda entry: entry[0])
        grown = self._grown_beside(base, left)
        self.unnamed = next(term for term in grown if type(term) in FOILS)
        return named(grown)

    def _grown_beside(self, base: Terms, terms: Terms) -> Terms:
        """The terms, one of them a law without a name, with the effects that explain most of what they leave.

        Others without a name compete: where one of them predicts surely better, no further effect is named.
        """
        while len(terms) - len(base) <= self.criterion.most and not self.fits(terms):
            needed = (longer for longer in self.candidates(terms)[:TRIED] if self._is_needed(longer, terms))
            longer = next(needed, None)
            if longer is None:
                break
            others = [self.best(terms, foil) for foil in self.foils if foil not in map(type, terms)]
            if any(trial is not None and self.is_sure(trial.terms, longer) for trial in others):
                break
            terms = self.settle(longer)
        return terms

    def _with_foils(self, base: Terms, terms: Terms) -> Iterator[tuple[Term, Terms]]:
        """Each law without a name, and the terms with it: instead of all effects, or beside those that it leaves."""
        for foil in self.foils:
            for others in (base, terms):
                trial = self.best(others, foil)
                if trial is not None:
                    left = self._beside(base, trial.terms, foil.id)
                    yield next(term for term in left if term.id == foil.id), left

    def _beside(self, base: Terms, terms: Terms, law: str) -> Terms:
        """The terms without the effects that are not needed beside the law of an id, which has no name."""
        while True:
            effects = [term for term in terms[len(base) :] if term.id != law]
            withouts = [self.settle(tuple(t for t in terms if t is not term)) for term in effects]
            idle = [without for without in withouts if not self._is_needed(terms, without)]
            if not idle:
                return terms
            terms = min(idle, key=self._promise)

    # ----------------------------------------------------------------------------------------------------------- steps

    def step(self, added: str | None, terms: Terms) -> Step:
        """Fit the terms to the training data and take the errors."""
        return self.with_errors(added, self._model(terms))

    def report(self, added: str | None, terms: Terms) -> Step:
        """The same with standard errors."""
        return self.with_errors(added, fit_terms(self.train, terms, self.screen)[0])

    def with_errors(self, added: str | None, model: Model) -> Step:
        """A model as a step, with its errors on the training and on the held-out data; what a link does is watched."""
        parts = {"train": self.train, "holdout": self.holdout}
        if self.linked is None and has_link(model.terms):
            parts = {name: part.watching(model) for name, part in parts.items()}
        return Step(added, model, {name: part.errors(model) for name, part in parts.items()})

    def in_motion(self, step: Step) -> Step:
        """A step with the parameters that follow the motion best.

        Where much is left unexplained, those that leave the least torque may follow the motion badly.
        """
        if has_transmission(step.model.terms) or not self.train.flights:
            return step  # a simulation that starts from a link that was not watched is soon lost
        if step.model.terms not in self._in_motion:
            point = output_error.fit(self.train.flights, step.model.terms, step.model.theta)
            refined = output_error.model(self.train.flights, point)
            self._in_motion[step.model.terms] = self.with_errors(step.added, refined)
        return replace(self._in_motion[step.model.terms], added=step.added)

    def is_confirmed(self, after: Step, before: Step) -> bool:
        """Whether both held-out errors fall, and the parameters are those of a body."""
        return objection(after, before, self.train.motions) is None

    def are_confirmed(self, steps: Sequence[Step]) -> bool:
        """Whether every step is confirmed; or all at once if they leave only noise, and none can be left out."""
        if all(self.is_confirmed(after, before) for before, after in pairwise(steps)):
            return True
        base, terms = steps[0].model.terms, steps[-1].model.terms
        withouts = [tuple(t for t in terms if t is not term) for term in terms if term.id not in ids(base)]
        return (
            self.fits(terms)
            and self.is_confirmed(steps[-1], steps[0])
            and (len(withouts) == 1 or all(self._lowers_errors(terms, without) for without in withouts))
        )

    def ladder(self, base: Terms, terms: Terms) -> list[Step]:
        """Steps from the base to the final terms, in an order in which each lowers both errors if there is one.

        First comes what the final model can do without least. Where much is left unexplained, the errors may fall only
        with the parameters that follow the motion best.
        """
        order: list[Term] = []
        left = terms
        while len(left) > len(base):
            withouts = [tuple(t for t in left if t is not term) for term in left[len(base) :]]
            kept = max(withouts, key=lambda terms: float(self.density(terms).sum()))
            order.insert(0, next(term for term in left if term not in kept))
            left = kept
        orders = list(permutations(order)) if len(order) <= ORDERED else [tuple(order)]
        made: dict[Terms, Step] = {}

        def course(one: Sequence[Term], view: Callable[[Step], Step]) -> list[Step]:
            steps = []
            for count in range(len(one) + 1):
                present = tuple(term for term in terms if term.id in ids(base) or term in one[:count])
                if present not in made:
                    made[present] = self.report(None, present)
                steps.append(view(replace(made[present], added=one[count - 1].id if count else None)))
            return steps

        views: list[Callable[[Step], Step]] = [lambda step: step, self.in_motion]
        for view in views if len(order) and self.train.flights else views[:1]:
            for one in orders:
                steps = course(one, view)
                if self.are_confirmed(steps):
                    return steps
        return course(orders[0], views[0])


def _stretches(part: Evidence, length: float) -> Stretches:
    """Stretches of some data, with folds of pieces of a length [s]."""
    return Stretches(*part.data.stretches(STRETCH), part.data.stretches(length)[0])


def held_out_cost(step: Step) -> float:
    """Product of both held-out errors [N m rad]: a model is better where one falls by more than the other rises."""
    errors = step.errors["holdout"]
    return errors.torque_rms * (1.0 if np.isnan(errors.position_rms) else errors.position_rms)


def named(terms: Terms) -> Terms:
    """The terms without laws that have no name."""
    return tuple(term for term in terms if type(term) not in FOILS)


def ids(terms: Sequence[Term]) -> frozenset[str]:
    """Ids of some terms."""
    return frozenset(term.id for term in terms)


def forms(terms: Sequence[Term]) -> frozenset[tuple[str, ...]]:
    """Ids of some terms, each with the names of the shape parameters that are told."""
    return frozenset((term.id, *(shape.name for shape in term.free)) for term in terms)


def _wandering_in(part: Evidence, terms: Terms) -> Terms:
    """The terms with what wanders in time as it may do so in some data."""
    return tuple(next(iter(type(t).grid(part.samples, np.empty(0)))) if wanders(t) else t for t in terms)


def has_bristles(term: Term) -> bool:
    """Whether it is friction with a state, which nobody measures."""
    return term.kind == "dissipative" and term.remembers


def is_hidden(term: Term) -> bool:
    """Whether it has a state that nobody measures, of a link or of bristles: windows know little of it, motion more."""
    return term.link or has_bristles(term)


def has_transmission(terms: Sequence[Term]) -> bool:
    """Whether one of the terms is a loose or elastic transmission."""
    return any(term.kind == "transmission" for term in terms)


def parameters(terms: Sequence[Term]) -> int:
    """Number of parameters of a model."""
    return sum(complexity(term) for term in terms)


def complexity(term: Term) -> int:
    """Number of parameters of a term."""
    return len(term.columns) + len(term.free)
