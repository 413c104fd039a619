"""Models on training and held-out data: score of one against another, errors, and residuals.

Immutable: a search that prepares the data in another way uses other `Models`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.kept import kept
from estimators.progress import Progress, no_progress
from estimators.selection.criterion import Criterion
from estimators.selection.data import fit_terms
from estimators.selection.errors import Step
from estimators.selection.left import Left, Terms, drifting_in
from estimators.selection.physical import impossible, objection
from estimators.selection.prepared import Comparable
from estimators.selection.score import BLOCK, Blocks, Bootstrap, Gain, cross_validated, predicted
from estimators.simulation import output_error
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array
from pendulum_env.arms.model import model_of
from pendulum_env.physics import BASE, Model, Term, effects
from pendulum_env.physics.model import SURE
from pendulum_env.physics.table import COMPETING, ByTime
from pendulum_env.physics.term import loads
from pendulum_env.physics.terms import has_link, has_transmission, ids


@dataclass
class Models:
    """Training and held-out data with the models tried on them.

    Attributes:
        train: recordings to fit.
        holdout: recordings to predict.
        progress: told what is being done.
        library: effects that may be named, by id.
        criterion: thresholds of the decisions.
        rng: of the bootstrap.
        base: terms that the search starts from.
        tables: nonparametric functions that compete with the effects, without those of the base model.
        linked: the model by which the state of a link is estimated, if there is one.
        drawn: random weights of blocks, if there are some already.
    """

    train: Comparable
    holdout: Comparable
    progress: Progress = no_progress
    library: Mapping[str, type[Term]] = field(default_factory=effects)
    criterion: Criterion = field(default_factory=Criterion)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    base: Terms = BASE
    tables: Sequence[type[Term]] = COMPETING
    linked: Step | None = None
    drawn: Bootstrap | None = None

    def __post_init__(self) -> None:
        self.regression, self.screen, self.parts = self.train.regression, self.train.screen, (self.train, self.holdout)
        known = ids(self.base)
        self.tables = [table for table in self.tables if table.id not in known]
        self.left = Left(self.train, self.holdout, self.criterion, self.base)
        self._where = [_blocks(part, BLOCK) for part in self.parts]
        self._finer = [_blocks(part, self.criterion.moment) for part in self.parts]
        self._unknown = self._find_unknown()
        self._in_motion: dict[Terms, Step] = {}
        first, second = (where.of_block for where in self._where)
        same = self.train.recordings == self.holdout.recordings  # parts of the same recordings
        of_block = np.concatenate([first, second if same else second + first.max() + 1])
        self.bootstrap = self.drawn or Bootstrap(of_block, self.rng)

    def watching(self, linked: Step) -> Models:
        """The same with the link's state estimated by a model from the motion around each instant."""
        train, holdout = (part.watching(linked.model) for part in self.parts)
        return replace(self, train=train, holdout=holdout, linked=linked, drawn=self.bootstrap)

    @property
    def cost_with_link(self) -> float:
        """Held-out cost of the model by which the link's state is estimated."""
        return np.inf if self.linked is None else held_out_cost(self.linked)

    @kept
    def density(self, terms: Terms) -> Array:
        """Log predictive density of every block, those of the training data first, (S,) [nat]."""
        if any(isinstance(term, ByTime) for term in terms):
            return self.fitted_anew(terms)
        told, (first, second) = self._predictive(terms), self._where
        fitted, unseen = (part.regression.equations(terms).recorded for part in self.parts)
        if fitted is not None and unseen is not None:
            known = replace(fitted, weights=self.regression.weights(terms))
            recorded = np.concatenate([cross_validated(known, first), predicted(known.solve(), unseen, second)])
            for lag in (term for term in terms if term.lead):
                without = tuple(other for other in terms if other is not lag)
                several = any(other.lead for other in without)
                acting = self.density(without) if several else self._predictive(without, lag)
                if self.bootstrap.gain(recorded, acting).chance > self.criterion.chance:
                    return recorded  # a filter that only makes the torque smaller
        return told

    def _predictive(self, terms: Terms, undone: Term | None = None) -> Array:
        """Log predictive density of every block by what the terms leave of the torque that acts (S,) [nat].

        To compare with a filter that is `undone`, with as much noise as the derivative of the acceleration has there.
        """
        regression, (first, second) = self.regression, self._where
        fitted, unseen = (part.regression.equations(terms) for part in self.parts)
        hidden = [part.regression.hidden_noise(terms) for part in self.parts]
        if undone is not None:
            inertia = self.left.inertia[undone.at or self.left.joints[0]]
            for own, part in zip(hidden, self.parts, strict=True):
                noise = [w.rate_noise(inertia) for w in part.data.part(undone.at).windows]
                own.append((part.data.where(undone.at), float(np.mean(np.square(noise))) * undone.lead**2))
        return np.concatenate(
            [
                cross_validated(fitted, first, hidden[0], regression.solve_without(terms)),
                predicted(regression.solve(terms), unseen, second, hidden[1]),
            ]
        )

    @kept
    def fitted_anew(self, terms: Terms) -> Array:
        """The same, refitted to each part of the data, since a drift differs between recordings.

        Each moment predicts the next there, so folds are shorter than blocks of the score.
        """
        parts = []
        for part, where in zip(self.parts, self._finer, strict=True):
            here = drifting_in(part, terms)
            parts.append(cross_validated(part.regression.balance(here), where, part.regression.hidden_noise(here)))
        return np.concatenate(parts)

    def gain(self, after: Terms, before: Terms) -> Gain:
        """Gain of one model over another, with a penalty for the number of variants tried."""
        return self.bootstrap.gain(self.density(after), self.density(before), self.penalty(after, before))

    def penalty(self, after: Terms, before: Terms) -> float:
        """Multiple-comparison penalty: logarithm of the number of models tried [nat]."""
        return float(np.log(max(1, len(self.library) * self.variants(after, before))))

    def variants(self, after: Terms, before: Terms) -> int:
        """Number of variants tried of the effects by which one model is larger than another, at least one."""
        known = {other.id: other for other in before}
        tried = [self.screen.looked_at(before, type(term)) for term in after if term.id not in known]
        more = [shape for term in after if term.id in known for shape in term.free if shape not in known[term.id].free]
        return max(1, sum(tried) + sum(int(shape.high - shape.low) for shape in more if shape.integer))

    def is_significant(self, after: Terms, before: Terms) -> bool:
        """Whether one model predicts significantly better than another."""
        return self.gain(after, before).chance <= self.criterion.chance

    def is_level(self, one: Terms, other: Terms) -> bool:
        """Whether the first of two models has a probability above `rival`."""
        probability = self.bootstrap.probabilities([self.density(one), self.density(other)])[0]
        return bool(probability > self.criterion.rival)

    def promise(self, terms: Terms) -> float:
        """Sort key of models, the most probable first: negative log density [nat]."""
        return -float(self.density(terms).sum())

    def model(self, terms: Terms) -> Model:
        """The terms fitted to the training data, without standard errors, which take time."""
        model = Model.build(self.regression.as_fitted(terms), self.regression.solve(terms))
        return model.withholding(self._unknown)

    def _find_unknown(self) -> frozenset[str]:
        """Name the inertia if it is within 3 standard errors of zero by noise alone: nothing is simulated by it."""
        if self.train.in_loop or "inertia" not in ids(self.base):
            return frozenset()
        model, fit = fit_terms(self.train, self.base)
        inertia, rms = model.estimates["inertia"], float(np.sqrt(np.mean(fit.residual**2)))
        noise = inertia.std * min(1.0, self.left.floor / max(rms, 1e-300))
        return frozenset({"inertia"}) if abs(inertia.value) <= SURE * noise else frozenset()

    def step(self, added: str | None, terms: Terms) -> Step:
        """Fit the terms to the training data and take the errors."""
        return self.with_errors(added, self.model(terms))

    def report(self, added: str | None, terms: Terms) -> Step:
        """The same with standard errors."""
        return self.with_errors(added, fit_terms(self.train, terms)[0])

    def with_errors(self, added: str | None, model: Model) -> Step:
        """A model as a step, with its errors on training and held-out data, and with link states estimated."""
        parts = {"train": self.train, "holdout": self.holdout}
        if self.linked is None and has_link(model.terms):
            parts = {name: part.watching(model) for name, part in parts.items()}
        model = model_of(model).per(self.train.recordings[0].torque_unit).withholding(self._unknown)
        return Step(added, model, {name: part.errors(model) for name, part in parts.items()})

    def in_motion(self, step: Step) -> Step:
        """A step with the parameters that follow the motion best.

        With a large unexplained residual, the parameters of the smallest torque error may follow the motion badly.
        """
        if has_transmission(step.model.terms) or not self.train.segments or not step.model.is_inertia_known:
            return step  # a simulation from an unknown state of the link soon diverges
        if step.model.terms not in self._in_motion:
            point = output_error.fit(self.train.segments, Point.of(step.model))
            refined = output_error.model(self.train.segments, point)
            self._in_motion[step.model.terms] = self.with_errors(step.added, refined)
        return replace(self._in_motion[step.model.terms], added=step.added)

    def is_possible(self, terms: Terms) -> bool:
        """Whether the effects of some terms are physically possible at their own joints."""
        where = {joint for term in terms[len(self.base) :] for joint in loads(term.at)}
        motions = {at: x for at, x in self.train.motions.items() if at in where}
        return not impossible(self.model(terms), motions)

    def is_confirmed(self, after: Step, before: Step) -> bool:
        """Whether both held-out errors fall and the parameters are physically possible."""
        return objection(after, before, self.train.motions) is None

    def lowers_errors(self, after: Terms, before: Terms) -> bool:
        """Whether both held-out errors fall, with the parameters fitted to the torque or else to the motion."""
        new, old = self.step(None, after), self.step(None, before)
        return self.is_confirmed(new, old) or self.is_confirmed(self.in_motion(new), self.in_motion(old))


def _blocks(part: Comparable, length: float) -> Blocks:
    """Stretches of some data, with folds of pieces of a length [s]."""
    return Blocks(*part.data.blocks(BLOCK), part.data.blocks(length)[0])


def held_out_cost(step: Step) -> float:
    """Product of both held-out errors [N m rad]: a model is better where one falls by more than the other rises."""
    errors = step.errors["holdout"]
    return errors.torque_rms * (1.0 if np.isnan(errors.position_rms) else errors.position_rms)
