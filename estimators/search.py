"""The search for what a model lacks: effects added, confirmed on held-out data, swapped and pruned.

1. add: the effect that best predicts stretches of the training data it was not fitted to;
2. confirm: it must lower the error on held-out recordings, in torque and in free-running simulation;
3. swap and prune: once all are in, each is challenged by every other effect and by its own absence.

It stops when nothing that is left lowers the errors by more than chance and by more than a few per cent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

import numpy as np

from estimators.diagnosis import Step
from estimators.evidence import Evidence, fit_terms
from estimators.free_running import position_noise
from estimators.plausibility import HELD_OUT, beyond, impossible, is_nothing, objection
from estimators.screen import Screen, Trial
from estimators.unnamed import IMITATED, IMITATORS, PowerLaw
from pendulum_env.physics import BASE, Model, Term, effects

MATERIAL = 0.97  # an effect has to lower the cross-validated torque error to this share of it
SHARE = 0.2  # and to explain this much of what noise does not,
NEEDED = 0.36  # or this much to stay once all others are in,
WANDERING = 0.6  # or this much if it changes with time and the model does not fit: it would follow any slow drift
PLAIN = float(np.sqrt(1 - NEEDED))  # which is this share of the error where noise is small
SURPRISE = 10.0  # and to be this many nats likelier than its absence, besides the number of variants tried
NOISY = 1.05  # times the noise floor, an error that noise may well explain
TIE = 5.0  # nats within which two effects count as equally likely
ALIKE = 1.15  # and ratio of held-out errors within which they do
TEMPER = 3.0  # likelihood ratios are flattened by this: model errors are not white noise
LOOSE = 2.5  # times the noise floor: transmissions leave more than this, and take long to search
BRANCHES = 3  # effects, of those that promise most, from which a search may start
TRIED = 8  # that are tried until one is confirmed
MOST = 6  # effects in one model
ORDERED = 3  # effects up to which every order is tried

Progress = Callable[[str, float], None]  # what is being done, share of the work that is done


def no_progress(what: str, share: float) -> None:
    """Show nothing."""


@dataclass
class Search:
    """Training and held-out evidence with the trials made on them."""

    train: Evidence
    holdout: Evidence
    progress: Progress = no_progress
    unnamed: PowerLaw | None = None  # damping found that no effect of the library is

    def __post_init__(self) -> None:
        self.screen = Screen(self.train.data)
        self.held_out = Screen(self.holdout.data)
        self.library = effects()
        inertia = self.screen.project(*self.screen.shared(BASE))[1][0]
        self.floor = self.train.data.noise(abs(float(inertia)))

    def nats(self, better: Trial, worse: Trial) -> float:
        """Log likelihood ratio of two trials on the training data."""
        return self.screen.nats(better, worse)

    def margin(self, one: Trial, other: Trial) -> float:
        """Nats within which two trials tie; the noise that a term filters out is known to a quarter only."""
        count = len(self.train.data.weights)
        unsure = 0.25 * abs(one.hidden - other.hidden) / max(one.predicted_rms, 1e-12) ** 2
        return TIE + 0.5 * count * unsure

    def alternatives(self, terms: Sequence[Term], barred: Sequence[str] = ()) -> list[Trial]:
        """The best variant of every effect that the terms lack, best prediction first; ties to the simpler effect."""
        present = {term.id for term in terms} | set(barred)
        missing = [effect for id, effect in self.library.items() if id not in present]
        if has_transmission(terms):  # a joint has one
            missing = [effect for effect in missing if effect.kind != "transmission"]
        missing.sort(key=lambda effect: effect.kind == "transmission")  # last: they take long to search
        least = self.screen.trial(terms).predicted_rms
        trials: list[Trial] = []
        for done, effect in enumerate(missing):
            if effect.kind == "transmission" and (least < LOOSE * self.floor or len(terms) > len(BASE)):
                continue  # something simpler explains it; or a transmission would have shown before all else
            self.progress(f"screening {effect.id}", done / len(missing))
            trial = self.screen.best(terms, effect)
            if trial is not None and not beyond(trial.terms, self.screen.project(*self.screen.shared(trial.terms))[1]):
                trials.append(trial)
                least = min(least, trial.predicted_rms)
        trials.sort(key=lambda trial: trial.predicted_rms)
        return self._simplest_first(trials)

    def rivals(self, current: Trial, term: Term) -> list[Trial]:
        """The best variant of every other effect in the place of a term of a trial, as `alternatives` has them."""
        others = tuple(other for other in current.terms if other is not term)
        barred = [term.id]
        if current.predicted_rms < LOOSE * self.floor:  # nothing as large as a transmission is in question
            barred += [id for id, effect in self.library.items() if effect.kind == "transmission"]
        return self.alternatives(others, barred)

    def _simplest_first(self, trials: list[Trial]) -> list[Trial]:
        if not trials:
            return []
        ties = [trial for trial in trials if self.nats(trials[0], trial) < self.margin(trials[0], trial)]
        ties.sort(key=lambda trial: complexity(trial.terms[-1]))
        return ties + trials[len(ties) :]

    def is_material(self, after: Trial, before: Trial, share: float = SHARE) -> bool:
        """Whether the last term of `after` lowers the predicted error by more than chance and by more than a trifle.

        Args:
            after: with the term.
            before: without it.
            share: of what noise does not explain, that the term has to explain.
        """
        variants = 1 + sum(1 for _ in after.terms[-1].grid(self.train.samples, self.screen.residual(before.terms)))
        enough = SURPRISE + 2 * np.log(variants)
        old, new = before.predicted_rms, after.predicted_rms
        if after.hidden > before.hidden and old < NOISY * self.floor:
            return False  # a law that alters the noise itself is not to be read from noise
        explained = (old**2 - new**2) / (old**2 - self.floor**2) if old > self.floor else 0.0
        return self.nats(after, before) > enough and new < MATERIAL * old and explained > share

    def step(self, added: str | None, terms: Sequence[Term]) -> Step:
        """Fit the terms to the training data and take the errors; without standard errors, which take longer."""
        _, theta = self.screen.project(*self.screen.shared(terms))
        return self.with_errors(added, Model.build(terms, theta))

    def report(self, added: str | None, terms: Sequence[Term]) -> Step:
        """The same with standard errors."""
        return self.with_errors(added, fit_terms(self.train, terms)[0])

    def with_errors(self, added: str | None, model: Model) -> Step:
        """A model as a step, with its errors on the training and on the held-out data."""
        return Step(added, model, {"train": self.train.errors(model), "holdout": self.holdout.errors(model)})

    def held_out_rms(self, terms: Sequence[Term]) -> float:
        """Torque error on the held-out data of the terms fitted to the training data [N m]."""
        _, theta = self.screen.project(*self.screen.shared(terms))
        phi, y = self.held_out.shared(terms)
        return float(np.sqrt(np.mean((y - phi @ theta) ** 2)))

    def is_confirmed(self, after: Step, before: Step, torque: float = HELD_OUT) -> bool:
        """Whether held-out errors fall, both of them, and the parameters are those of a body with friction."""
        return objection(after, before, self.train.samples, torque) is None

    def is_as_good(self, rival: Step, chosen: Step) -> bool:
        """Whether a rival follows the held-out recordings as well as the model that was chosen, or nearly."""
        new, old = rival.errors["holdout"], chosen.errors["holdout"]
        if new.torque_rms >= ALIKE * old.torque_rms:
            return False
        noise = position_noise(self.holdout.flights, chosen.model.terms, chosen.model.theta)
        return new.position_rms < max(ALIKE * old.position_rms, noise)

    def fits(self, step: Step) -> bool:
        """Whether the torque fits."""
        return step.errors["train"].torque_rms < LOOSE * self.floor

    def explains(self, steps: Sequence[Step]) -> bool:
        """Whether the last model fits, or does at least much better on held-out data than the base model.

        What does neither is another thing, such as a torque that wanders, some of which one or the other can imitate.
        """
        new, old = (step.errors["holdout"].torque_rms for step in (steps[-1], steps[0]))
        return len(steps) == 1 or self.fits(steps[-1]) or new < PLAIN * old

    def settle(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Search every shape parameter again, now that all terms are in."""
        trial = self.screen.trial(terms)
        for term in terms:
            if any(not shape.integer for shape in term.free):
                trial = self.screen.refine(trial, term.id)
        return trial.terms

    def grow(self, steps: list[Step]) -> list[Step]:
        """Add effects one at a time while they help."""
        while len(steps) <= MOST:
            terms = steps[-1].model.terms
            before = self.screen.trial(terms)
            confirmed: list[tuple[Trial, Step]] = []
            for trial in self.alternatives(terms)[:TRIED]:
                if confirmed and not self._is_level(trial, confirmed[0][0]):
                    break
                step = self._confirmed(trial, before, steps[-1])
                if step is not None:
                    confirmed.append((trial, step))
            if not confirmed:
                break
            # what the torque cannot tell apart, the motion may
            steps = [*steps, min((step for _, step in confirmed), key=lambda step: step.errors["train"].position_rms)]
        return steps

    def _confirmed(self, trial: Trial, before: Trial, last: Step) -> Step | None:
        """The step to a trial, if its last term is material and held-out data confirm it."""
        if not self.is_material(trial, before):
            return None
        self.progress(f"confirming {trial.terms[-1].id}", 0.9)
        step = self.step(trial.terms[-1].id, self.settle(trial.terms))
        return step if self.is_confirmed(step, last) else None

    def find(self, base: tuple[Term, ...]) -> list[Step]:
        """Steps to the best model there is; where the one that grows first does not fit, others may start otherwise.

        A start may make held-out errors worse, as a wall does that held-out data hardly reach while they show what else
        is missing. The model that it leads to has to be confirmed all the same: step by step or, if it fits, at once.
        """
        bare = self.step(None, base)
        grown = self.grow([bare])
        found = self.prune(grown)
        if self.fits(found[-1]) or has_transmission(found[-1].model.terms):
            return found
        before = self.screen.trial(base)
        begun = {step.added for step in grown[1:2]}
        starts = [trial for trial in self.alternatives(base)[:BRANCHES] if self.is_material(trial, before)]
        for trial in sorted(starts, key=lambda trial: complexity(trial.terms[-1])):
            id = trial.terms[-1].id
            if id in begun:
                continue
            branch = self.prune(self.grow([bare, self.step(id, self.settle(trial.terms))]))
            if self.fits(branch[-1]) and self.is_confirmed(branch[-1], bare):
                return branch
            if self.are_confirmed(branch):
                found = min(found, branch, key=self._cost)
        return found

    def _cost(self, steps: list[Step]) -> float:
        """Predicted error of the last model [N m], raised for each effect by as much as it has to be worth."""
        return self.screen.trial(steps[-1].model.terms).predicted_rms / PLAIN ** len(steps)

    def disown(self, steps: list[Step]) -> list[Step]:
        """The steps without friction effects that only imitate a law which the library does not name."""
        base, terms = steps[0].model.terms, steps[-1].model.terms
        imitators = [term for term in terms[len(base) :] if term.id in IMITATORS]
        if not any(term.id == IMITATED or is_unusual(term) for term in imitators):
            return steps
        trial = self.screen.best(tuple(term for term in terms if term not in imitators), PowerLaw)
        if trial is None or trial.predicted_rms > LOOSE * self.floor:
            return steps
        *others, law = self.settle(trial.terms)
        simpler = complexity(law) < sum(complexity(term) for term in imitators)
        gain = self.nats(self.screen.trial((*others, law)), self.screen.trial(terms))
        if not isinstance(law, PowerLaw) or law.is_named or gain < (-TIE if simpler else SURPRISE):
            return steps
        self.unnamed = law
        needed = self.challenge((*base, law), (*base, law, *others[len(base) :]))
        return self.ladder(base, tuple(term for term in needed if term is not law))

    def prune(self, grown: list[Step]) -> list[Step]:
        """The steps after every effect has been challenged; as they have grown if held-out data do not confirm that."""
        base, terms = grown[0].model.terms, grown[-1].model.terms
        challenged = self.challenge(base, terms)
        if {term.id for term in challenged} != {term.id for term in terms}:
            challenged = self.settle(challenged)
        challenged = self.without_nothings(base, challenged)
        steps = self.ladder(base, challenged)
        if self.are_confirmed(steps):
            return steps
        reports = [self.report(step.added, step.model.terms) for step in grown]
        while any(is_nothing(reports[-1].model, term) for term in reports[-1].model.terms[len(base) :]):
            reports.pop()
        return reports

    def resolve(self, steps: list[Step]) -> list[Step]:
        """The steps with an effect replaced by one that training data cannot tell from it, but held-out data do.

        A spring and an offset look the same in small swings; one wide swing that was held out tells them apart.
        """
        base, last = steps[0].model.terms, steps[-1]
        current = self.screen.trial(last.model.terms)
        for term in last.model.terms[len(base) :]:
            for rival in self.rivals(current, term):
                if self.nats(current, rival) < self.margin(current, rival):
                    step = self.step(rival.terms[-1].id, rival.terms)
                    if self._follows_better(step, last):
                        resolved = self.ladder(base, self.settle(rival.terms))
                        return resolved if self.are_confirmed(resolved) else steps
        return steps

    def is_called_for(self, rival: Trial, chosen: Trial) -> bool:
        """Whether held-out data speak for a rival that training data leave open, if both are fitted to them anew."""
        better, worse = (self.held_out.trial(trial.terms) for trial in (rival, chosen))
        return self.held_out.nats(better, worse) > SURPRISE

    def _follows_better(self, rival: Step, chosen: Step) -> bool:
        """Whether a rival follows held-out recordings clearly better, in torque and in motion."""
        new, old = rival.errors["holdout"], chosen.errors["holdout"]
        possible = not impossible(rival.model, self.train.samples)
        return possible and ALIKE * new.torque_rms < old.torque_rms and ALIKE * new.position_rms < old.position_rms

    def without_nothings(self, base: tuple[Term, ...], terms: tuple[Term, ...]) -> tuple[Term, ...]:
        """The terms without added ones whose parameters come out as good as zero, the least missed first."""
        while len(terms) > len(base):
            model, _ = fit_terms(self.train, terms)
            nothings = [term for term in terms[len(base) :] if is_nothing(model, term)]
            if not nothings:
                break
            kept = (trial.terms for trial in self._weakest_first(base, terms))
            terms = next(others for others in kept if any(term not in others for term in nothings))
        return terms

    def _is_level(self, one: Trial, other: Trial) -> bool:
        """Whether two trials tie, and their last terms are equally complex."""
        level = complexity(one.terms[-1]) == complexity(other.terms[-1])
        return level and abs(self.nats(one, other)) < self.margin(one, other)

    def challenge(self, base: tuple[Term, ...], terms: tuple[Term, ...]) -> tuple[Term, ...]:
        """Swap added effects for others that do clearly better in their place, and drop those that are not needed.

        Beside all others, what is really there explains most of what noise does not. A model that lacks something else
        is imperfect in ways that nearly every effect helps a little to hide.
        """
        for _ in range(2 * MOST):
            current = self.screen.trial(terms)
            changed = None
            for without in self._weakest_first(base, terms):
                term = next(t for t in terms if t not in without.terms)
                drifts = term.kind == "time-varying" and current.predicted_rms > LOOSE * self.floor
                needed = WANDERING if drifts else NEEDED
                if not self.is_material(replace(current, terms=(*without.terms, term)), without, needed):
                    changed = without.terms
                elif len(without.terms) > len(base):
                    rivals = self.rivals(current, term)
                    if rivals and self.nats(rivals[0], current) > SURPRISE:
                        changed = self.settle(rivals[0].terms)
                if changed:
                    break
            if changed is None:
                break
            terms = changed
        return terms

    def _weakest_first(self, base: tuple[Term, ...], terms: tuple[Term, ...]) -> list[Trial]:
        """Trials without each of the added terms, the one that is missed least first."""
        withouts = [self.screen.trial(tuple(t for t in terms if t is not term)) for term in terms[len(base) :]]
        return sorted(withouts, key=lambda trial: trial.predicted_rms)

    def ladder(self, base: tuple[Term, ...], terms: tuple[Term, ...]) -> list[Step]:
        """Steps from the base to the final terms; first comes what the final model can do without least.

        Where that does not make every step lower the held-out errors, another order may.
        """
        order: list[Term] = []
        left = terms
        while len(left) > len(base):
            kept = self._weakest_first(base, left)[0].terms
            order.insert(0, next(term for term in left if term not in kept))
            left = kept
        orders = permutations(order) if len(order) <= ORDERED else [tuple(order)]
        preferred: list[Step] = []
        for one in orders:  # the first of the permutations is the order itself
            steps = [self.report(None, base)]
            for term in one:
                steps.append(self.report(term.id, (*steps[-1].model.terms, term)))
            if self.are_confirmed(steps):
                return steps
            preferred = preferred or steps
        return preferred

    def are_confirmed(self, steps: Sequence[Step]) -> bool:
        """Whether every step lowers the held-out errors."""
        return all(self.is_confirmed(after, before) for before, after in pairwise(steps))


def has_transmission(terms: Sequence[Term]) -> bool:
    """Whether one of the terms is a loose or elastic transmission."""
    return any(term.kind == "transmission" for term in terms)


def is_unusual(term: Term) -> bool:
    """Whether a shape parameter of a term has left its usual value."""
    return any(shape.usual is not None for shape in term.free)


def complexity(term: Term) -> int:
    """Number of parameters of a term."""
    return len(term.columns) + len(term.free)


def look(train: Evidence, test: Evidence, base: Sequence[Term], progress: Progress) -> tuple[Search, list[Step]]:
    """Search the library; returns the steps from the base model to the final one."""
    search = Search(train, test, progress)
    steps = search.disown(search.resolve(search.find(search.settle(base))))
    return search, steps if search.explains(steps) else steps[:1]
