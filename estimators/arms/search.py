"""The search for effects at joints of an arm that a model lacks.

Every effect of a library at every joint is tried. Columns that body and friction have are projected out once, so that
a variant costs a small solve on the rows of its joint; the most promising ones are then judged by the log predictive
density of stretches that they were not fitted to (`estimators.selection.score`), by the pendulum's `Criterion`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.arms.evidence import ArmEvidence
from estimators.checks.physical import impossible
from estimators.progress import Progress
from estimators.selection.criterion import Criterion
from estimators.selection.score import Bootstrap, Gain, foretold
from estimators.selection.search import complexity
from estimators.weak_form.dataset import LEAST_NOISE
from estimators.weak_form.shapes import gauss_newton, shape_slopes
from pendulum_env._typing import JSON, Array, Mask
from pendulum_env.arms.joints import JointTerm, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.physics import Model, Term
from pendulum_env.words import listing

VERDICTS = ("selected", "ambiguous", "rejected")  # in the order of a table
JUDGED = 8  # most promising effects that are scored
SEARCHED = 24  # most promising ones whose shape parameters are searched, from the grid on
SINGULAR = 1e-6  # share of a column that body and friction have to leave: with less it is theirs

Terms = tuple[JointTerm, ...]


@dataclass(frozen=True)
class ArmCandidate:
    """An effect at a joint that was judged, in the round that says most of it.

    Attributes:
        effect: `stribeck@elbow`.
        gain: log predictive density over the model before it [nat].
        error: its standard error [nat].
        probability: among the effects that were judged with it, in the same place.
        verdict: selected, ambiguous or rejected.
        reason: why, in words.
    """

    effect: str
    gain: float
    error: float
    probability: float
    verdict: str
    reason: str

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return dict(vars(self))


@dataclass
class ArmSearch:
    """The loop that adds effects, and looks for each anew beside those that were added after it."""

    train: ArmEvidence
    held: ArmEvidence
    library: Mapping[str, type[Term]]
    criterion: Criterion
    rng: np.random.Generator
    progress: Progress
    rounds: dict[str | None, list[ArmCandidate]] = field(default_factory=dict)  # by what each selected

    def __post_init__(self) -> None:
        base = friction(self.train.body.joints)
        spread = np.array([np.std(self.train.torque[self.train.of(k)]) for k in range(len(self.train.body.joints))])
        weights = 1.0 / np.maximum(spread, LEAST_NOISE * spread.max())  # a joint without a motor has no torque
        for _ in range(2):  # joints with less noise count more
            balance = self.train.balance(base, weights)
            error = balance.error(balance.solve())
            weights = weights / np.sqrt([np.mean(error[self.train.of(k)] ** 2) for k in range(len(weights))])
        self.weights = weights
        first, second = self.train.stretches.of_stretch, self.held.stretches.of_stretch
        self.bootstrap = Bootstrap(np.concatenate([first, second + first.max() + 1]), self.rng)
        self._densities: dict[Terms, Array] = {}
        self._solved: dict[Terms, Array] = {}

    def solve(self, terms: Terms) -> Array:
        """Linear parameters (P,), base parameters first."""
        if terms not in self._solved:
            self._solved[terms] = self.train.balance(terms, self.weights).solve()
        return self._solved[terms]

    def residual(self, terms: Terms) -> Array:
        """Torque (R,) that the fit leaves [N m]."""
        return self.train.residual(terms, self.solve(terms))

    def density(self, terms: Terms) -> Array:
        """Log predictive density of every stretch (S,), those of the training data first [nat]."""
        if terms not in self._densities:
            fitted, unseen = (part.balance(terms, self.weights) for part in (self.train, self.held))
            where = self.train.stretches, self.held.stretches
            told = foretold(fitted, unseen, *where)
            if fitted.recorded is not None and unseen.recorded is not None:
                recorded = foretold(fitted.recorded, unseen.recorded, *where)
                withouts = [tuple(other for other in terms if other is not own) for own in terms if own.term.lead]
                gains = [self.bootstrap.gain(recorded, self.density(without)) for without in withouts]
                if any(gain.chance > self.criterion.chance for gain in gains):
                    told = recorded  # a filter that only makes the torque smaller
            self._densities[terms] = told
        return self._densities[terms]

    def gain(self, after: Terms, before: Terms) -> Gain:
        """What one model predicts better; the more was tried, the more it has to be."""
        return self.bootstrap.gain(self.density(after), self.density(before), self.penalty(after, before))

    def penalty(self, after: Terms, before: Terms) -> float:
        """Logarithm of the number of models that were tried: the best of so many gains that much by chance."""
        variants = [self._looked_at(own, before) for own in after if own not in before]
        return float(np.log(len(self.library) * len(self.train.body.joints) * max(1, sum(variants))))

    def _looked_at(self, own: JointTerm, terms: Terms) -> int:
        residual = self.residual(terms)[self.train.of(own.joint)]
        return type(own.term).looked_at(self.train.samples(own.joint), residual)

    def trifle(self, joint: int) -> float:
        """Torque at a joint that smoothing leaves, which is not exact either [N m]."""
        return LEAST_NOISE * float(np.std(self.train.torque[self.train.of(joint)]))

    def find(self, base: Terms) -> Terms:
        """The terms with all effects that surely predict better and explain what is left."""
        terms = base
        states: dict[frozenset[str], Terms] = {}
        while len(terms) - len(base) < self.criterion.most:
            longer = self._add(terms)
            if longer is None:
                break
            terms = longer
            for own in longer[len(base) : -1]:  # another may be in its place, or none, now that more is known
                others = tuple(other for other in terms if other is not own)
                terms = self._add(others) or others
            found = frozenset(own.id for own in terms[len(base) :])
            if found in states:  # in circles: the best of them
                circle = list(states.values())[list(states).index(found) :]
                return max(circle, key=lambda one: float(self.density(one).sum()))
            states[found] = terms
        return terms

    def ranking(self, terms: Terms) -> list[ArmCandidate]:
        """Every effect that was judged where the terms were selected or nothing was, once: by verdict, then by gain."""
        best: dict[str, ArmCandidate] = {}
        for id in (*(own.id for own in terms), None):
            for one in self.rounds.get(id, ()):
                if one.effect not in best or VERDICTS.index(one.verdict) <= VERDICTS.index(best[one.effect].verdict):
                    best[one.effect] = one  # a rival stays one beside the effect that it rivals
        return sorted(best.values(), key=lambda one: (VERDICTS.index(one.verdict), -one.gain))

    def _add(self, terms: Terms) -> Terms | None:
        """The terms with one more effect, the one of the best prediction that nothing speaks against."""
        promising = [(*terms, own) for own in self.screened(terms)]
        for k, longer in enumerate(promising):
            self.progress(f"judging {longer[-1].id}", k / len(promising))
            self.density(longer)
        order = list(self.library)
        promising.sort(key=lambda longer: order.index(longer[-1].term.id))  # equal laws by the library's order
        promising.sort(key=lambda longer: -round(float(self.density(longer).sum()), 2))
        objections = {longer: self._objection(longer, terms) for longer in promising}
        convincing = [longer for longer in promising if objections[longer] is None]
        level = [longer for longer in convincing if self._is_level(longer, convincing[0])]
        chosen = min(level, key=lambda longer: complexity(longer[-1].term), default=None)
        if chosen is not None:  # what is as good with more parameters is no rival
            simple = complexity(chosen[-1].term)
            promising = [one for one in promising if one not in level or complexity(one[-1].term) == simple]
        odds = (
            self.bootstrap.probabilities([self.density(longer) for longer in promising]) if promising else np.empty(0)
        )
        name = "" if chosen is None else chosen[-1].id
        told = self.rounds[None if chosen is None else chosen[-1].id] = []
        for longer, probability in zip(promising, odds.tolist(), strict=True):
            gain = self.gain(longer, terms)
            if longer == chosen:
                simpler = f"predicts as well as {level[0][-1].id}, with fewer parameters"
                verdict, reason = "selected", "predicts best" if longer == level[0] else simpler
            elif longer in level and probability > self.criterion.rival:
                verdict, reason = "ambiguous", f"predicts as well as {name}, or nearly"
            else:
                verdict, reason = "rejected", objections[longer] or f"{name} predicts better"
            told.append(ArmCandidate(longer[-1].id, gain.total, gain.error, probability, verdict, reason))
        return chosen

    def _is_level(self, one: Terms, other: Terms) -> bool:
        """Whether the first of two models may well be the better one."""
        return bool(self.bootstrap.probabilities([self.density(one), self.density(other)])[0] > self.criterion.rival)

    def _objection(self, longer: Terms, terms: Terms) -> str | None:
        """What speaks against an effect, in words; None if nothing does.

        It has to gain surely, to explain a good share of what is left at a joint, where it has to lower the error on
        held-out data as well, and to be one that a body can have.
        That joint need not be its own: where the links' parameters imitate the effect there, other joints miss them.
        """
        gain = self.gain(longer, terms)
        if gain.chance > self.criterion.chance:
            return "gains no more than chance may give"
        # what shows in few places only, as friction at low speed, hardly shows in what neighbours share
        sure = gain.total - self.penalty(longer, terms) >= self.criterion.sure * gain.error
        before, after = self.residual(terms), self.residual(longer)
        gone = before**2 - after**2
        unseen = [self.held.residual(one, self.solve(one)) ** 2 for one in (longer, terms)]
        joints = [j for j in range(len(self.weights)) if np.less(*(own[self.held.of(j)].mean() for own in unseen))]
        shown = (self._explains(before, after, float(np.mean(gone[self.train.of(j)])), j, sure) for j in joints)
        if not any(shown):
            return "explains too little of what is left to be it"
        wrong = self.impossible(longer)
        return f"would mean {listing(wrong)}, which no joint has" if wrong else None

    def _explains(self, before: Array, after: Array, explained: float, joint: int, sure: bool) -> bool:
        """Whether a residual (R,) is surely more than noise at a joint, and another leaves a good share less there.

        Args:
            before: the one [N m].
            after: the other [N m].
            explained: power that is gone at the joint [N^2 m^2].
            joint: where.
            sure: whether it is surely more than noise, whatever neighbours share of it.
        """
        left, _ = self.train.structure(after, joint)
        return (
            (sure or self.train.structure(before, joint)[1] >= self.criterion.sure)
            and explained > self.trifle(joint) ** 2
            and explained > self.criterion.share * (explained + left**2)
        )

    def impossible(self, terms: Terms) -> list[str]:
        """What no joint has of the one where the last of the terms is, in phrases; empty if all is well."""
        joint, sizes = terms[-1].joint, [len(own.term.columns) for own in terms]
        owner = np.repeat([-1, *(own.joint for own in terms)], [len(self.train.body.base), *sizes])
        theta = self.solve(terms)[owner == joint]
        model = Model.build([own.term for own in terms if own.joint == joint], theta)
        return impossible(model, self.train.samples(joint))

    def screened(self, terms: Terms, joints: Sequence[str] | None = None) -> list[JointTerm]:
        """The most promising effects at these joints, or all, their shape parameters searched, the best first."""
        balance = self.train.balance(terms, self.weights)
        frame = np.linalg.qr(balance.phi / np.maximum(np.linalg.norm(balance.phi, axis=0), 1e-300))[0]
        error = balance.error(self.solve(terms))
        error = error - frame @ (frame.T @ error)
        present = {own.id for own in terms}
        found: list[tuple[float, JointTerm]] = []
        for joint, name in enumerate(self.train.body.joints):
            if joints is not None and name not in joints:
                continue
            self.progress(f"screening {name}", joint / len(self.train.body.joints))
            here = self.train.of(joint)
            left = _Left(self.train, joint, name, frame[here], error, here, self.weights[joint])
            x, residual = self.train.samples(joint), error[here] / self.weights[joint]
            for effect in self.library.values():
                if f"{effect.id}@{name}" in present:
                    continue
                variants = [variant for variant in effect.grid(x, residual) if variant.possible(x)]
                reductions = [left.reduction(variant) for variant in variants]
                if reductions:
                    best = int(np.argmax(reductions))
                    found.append((reductions[best], JointTerm(joint, name, variants[best])))
        found.sort(key=lambda entry: -entry[0])
        refined = []
        for reduction, own in found[:SEARCHED]:
            here = self.train.of(own.joint)
            left = _Left(self.train, own.joint, own.at, frame[here], error, here, self.weights[own.joint], frame)
            if any(not shape.integer for shape in own.term.free):
                term = gauss_newton(own.term, left.residuals)
                if term.possible(self.train.samples(own.joint)):
                    own = JointTerm(own.joint, own.at, term)
                    reduction = max(reduction, left.reduction(term))
            refined.append((reduction, own))
        refined.sort(key=lambda entry: -entry[0])
        return [own for reduction, own in refined[:JUDGED] if reduction > 0]

    def report(self, terms: Terms) -> ArmModel:
        """The model with standard errors, from the training data."""
        clusters = np.unique(2 * self.train.stretches.stretch, return_inverse=True)[1]
        balance = self.train.balance(terms, self.weights)
        slopes = self._shape_slopes(terms, self.solve(terms))
        jacobian = np.column_stack(list(slopes.values())) if slopes else None
        std, count = balance.fit(clusters, jacobian).std, balance.phi.shape[1]
        shape_std = dict(zip(slopes, std[count:].tolist(), strict=True))
        return ArmModel.build(self.train.body, terms, self.solve(terms), std[:count], shape_std)

    def _shape_slopes(self, terms: Terms, theta: Array) -> dict[str, Array]:
        """Derivatives (R,) of the weighted torque by continuous shape parameters, by `id.shape@joint`."""
        slopes, first = {}, len(self.train.body.base)
        for own in terms:
            linear = theta[first : (first := first + len(own.term.columns))]

            def torques(variants: Sequence[Term], own: JointTerm = own, linear: Array = linear) -> list[Array]:
                columns = [self.train.columns(replace(own, term=variant)) for variant in variants]
                return [part.linear @ linear + part.fixed for part in columns]

            here = self.train.of(own.joint)
            for name, slope in shape_slopes(own.term, torques).items():
                slopes[f"{name}@{own.at}"] = whole = np.zeros(len(here))
                whole[here] = slope * self.weights[own.joint]
        return slopes


@dataclass(frozen=True, eq=False)
class _Left:
    """What body and terms leave of one joint's rows, for variants of effects there.

    With an orthonormal frame Q of the columns that are fitted along, what a column C on the rows of one joint adds is
    C - Q Q_i' C, whose products are C'C - (Q_i'C)'(Q_i'C): only the joint's own rows are touched.
    """

    train: ArmEvidence
    joint: int
    name: str
    frame: Array  # Q_i (R_i, P)
    error: Array  # (R,), without what the frame has
    here: Mask  # rows of the joint
    weight: float
    whole: Array | None = None  # Q (R, P)

    def _columns(self, variant: Term) -> tuple[Array, Array]:
        own = self.train.columns(JointTerm(self.joint, self.name, variant))
        return own.linear * self.weight, own.fixed * self.weight

    def reduction(self, variant: Term) -> float:
        """By how much a variant lowers the squared error."""
        linear, fixed = self._columns(variant)
        error = self.error[self.here]
        gained = 0.0
        if variant.fixed:  # at its own size
            told = self.frame.T @ fixed
            gained = float(2 * error @ fixed - (fixed @ fixed - told @ told))
        if linear.shape[1] == 0:
            return gained
        size = np.linalg.norm(linear, axis=0)
        if not (size > 0).all():
            return -np.inf
        linear = linear / size
        told = self.frame.T @ linear
        gram = linear.T @ linear - told.T @ told
        values, vectors = np.linalg.eigh(gram)
        use = values > SINGULAR
        target = vectors[:, use].T @ (linear.T @ error)
        return gained + float(np.sum(target**2 / values[use])) if use.any() else -np.inf

    def residuals(self, variants: Sequence[Term]) -> list[Array]:
        """Residual (R,) of the best fit with each variant."""
        assert self.whole is not None
        results = []
        for variant in variants:
            linear, fixed = self._columns(variant)
            own = np.zeros((len(self.error), linear.shape[1] + 1))
            own[self.here, :-1], own[self.here, -1] = linear, fixed
            own -= self.whole @ (self.frame.T @ own[self.here])
            error = self.error - own[:, -1]
            if linear.shape[1]:
                error = error - own[:, :-1] @ np.linalg.lstsq(own[:, :-1], error, rcond=1e-10)[0]
            results.append(error)
        return results
