"""Evaluation of models on training and held-out data: fits, scores, errors and residuals, each computed once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.data.fits import fit_terms
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.data.removed_noise import compute_removed_noise, list_absorbed_noise
from estimators.data.variants import count_tried
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Step, Terms, compute_held_out_cost
from estimators.decisions.gate import Gate
from estimators.decisions.score import (
    Bootstrap,
    Gain,
    cross_validate_density,
    predict_density,
)
from estimators.memoize import memoized
from estimators.progress import Progress, no_progress
from estimators.selection.motion_score import (
    compute_motion_gain,
    compute_motion_noise,
    compute_motion_squares,
    fit_to_motion,
    is_misfit,
)
from estimators.selection.physical import (
    find_violations,
    make_base_gates,
    make_coefficient_gate,
    make_confirmation_gates,
)
from estimators.selection.residuals import Residuals, set_grid
from pendulum_env._typing import Array
from pendulum_env.arms.model import make_arm_model
from pendulum_env.physics import (
    BASE,
    COMPETING,
    Model,
    Table,
    Term,
    effects,
    has_link,
    has_transmission,
    is_dry,
    list_ids,
    list_loads,
    release_term,
)

Density = Callable[[Terms], Array]


@dataclass
class ModelEvaluator:
    """Fits, scores and residuals of models on training and held-out data; results are memoised.

    Attributes:
        train: data to fit.
        holdout: data to predict.
        progress: called with the present work and the share that is done.
        library: effects that may be selected, by id.
        criterion: thresholds of the decisions.
        rng: random numbers of the bootstrap.
        base: terms that the search starts from.
        tables: nonparametric functions that compete with the effects; those of the base model are removed.
        linked: fitted model that estimated the states of a link; None without a link.
        drawn: random weights of blocks; drawn from `rng` if None.
    """

    train: RegressionData
    holdout: RegressionData
    progress: Progress = no_progress
    library: Mapping[str, type[Term]] = field(default_factory=effects)
    criterion: Criterion = field(default_factory=Criterion)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    base: Terms = BASE
    tables: Sequence[type[Term]] = COMPETING
    linked: Step | None = None
    drawn: Bootstrap | None = None

    def __post_init__(self) -> None:
        self.parts = self.train, self.holdout
        ids = list_ids(self.base)
        self.tables = [table for table in self.tables if table.id not in ids]
        self.residuals = Residuals(self.train, self.holdout, self.criterion, self.base)
        self._blocks = [part.layout.scored for part in self.parts]
        self._blocks_with_short_folds = [part.layout.make_blocks(self.criterion.drift_piece) for part in self.parts]
        self._unknown = self._find_unknown()
        self._in_motion: dict[Terms, Step] = {}
        train_blocks, holdout_blocks = (blocks.of_block for blocks in self._blocks)
        is_split = self.train.recordings == self.holdout.recordings  # parts of the same recordings
        of_block = np.concatenate(
            [train_blocks, holdout_blocks if is_split else holdout_blocks + train_blocks.max() + 1]
        )
        self.bootstrap = self.drawn or Bootstrap(of_block, self.rng)
        self.held_out = slice(len(train_blocks), None)  # blocks of a density that belong to held-out data

    def with_link(self, linked: Step) -> ModelEvaluator:
        """Return an evaluator of the same data with link states estimated by the model of `linked`."""
        train, holdout = self._estimate_link_states(linked.model.terms, tuple(map(float, linked.model.theta)))
        return replace(self, train=train, holdout=holdout, linked=linked, drawn=self.bootstrap)

    @memoized
    def _estimate_link_states(self, terms: Terms, theta: tuple[float, ...]) -> list[RegressionData]:
        """Return training and held-out data with link states estimated by the model of some parameters (P,)."""
        model = Model.build(terms, np.array(theta))
        return [part.with_link_states(model) for part in self.parts]

    @memoized
    def density(self, terms: Terms) -> Array:
        """Return the log predictive density of each block, those of the training data first, (S,) [nat].

        Tables that do not cover the held-out data, as functions of time, are refitted to each part of the data. A model
        with lags has the density of the recorded torque, unless that is significantly better than the acting torque
        without any one lag: then that of the acting torque. So a filter that only reduces the torque has no gain.
        """
        if self.residuals.are_refitted(terms):
            return self.refitted_density(terms)
        of_torque, (first, second) = self._density_of_torque(terms), self._blocks
        train, holdout = (part.equations(terms, by_noise=True).unfiltered for part in self.parts)
        if train is not None and holdout is not None:
            weighted_equations = replace(train, weights=self.train.equations(terms).weights)
            recorded = np.concatenate(
                [
                    cross_validate_density(weighted_equations, first),
                    predict_density(weighted_equations.solve(), holdout, second),
                ]
            )
            for lag in (term for term in terms if term.lead):
                without = tuple(other for other in terms if other is not lag)
                has_lags = any(other.lead for other in without)
                acting = self.density(without) if has_lags else self._density_of_torque(without, lag)
                if self.bootstrap.gain(recorded, acting).p_value > self.criterion.p_value:
                    return recorded
        return of_torque

    def _density_of_torque(self, terms: Terms, without: Term | None = None) -> Array:
        """Return the log density of each block (S,) [nat], by the residual of the acting torque.

        For a comparison with a model that has a lag `without`, the noise of the torque's derivative times the lag's
        time constant is added at its joint.
        """
        first, second = self._blocks
        absorbed = [list_absorbed_noise(part, terms) for part in self.parts]
        if without is not None:
            inertia = self.residuals.inertia[without.at or self.residuals.joints[0]]
            for of_part, part in zip(absorbed, self.parts, strict=True):
                noise = [w.noise.compute_rate_std(inertia) for w in part.data.part(without.at).windows]
                of_part.append((part.locate_rows(without.at), float(np.mean(np.square(noise))) * without.lead**2))
        fits, inertias = self.train.maker.fit_folds(terms), self.residuals.inertia
        removed = [compute_removed_noise(part, fits.terms, fits.theta, inertias) for part in self.parts]
        train_rows, holdout_rows = (part.equations(terms, by_noise=True) for part in self.parts)
        return np.concatenate(
            [
                cross_validate_density(train_rows, first, absorbed[0], fits.theta_without_fold, removed[0]),
                predict_density(fits.theta, holdout_rows, second, absorbed[1], removed[1]),
            ]
        )

    @memoized
    def refitted_density(self, terms: Terms) -> Array:
        """Return the cross-validated log density of each block, those of the training data first, (S,) [nat].

        Training and held-out data are fitted separately, since drift differs between them; tables that do not cover the
        held-out data get a grid over each. Folds are pieces of `criterion.drift_piece` seconds, from which a drift can
        be predicted.
        """
        parts = []
        for part, pieces in zip(self.parts, self._blocks_with_short_folds, strict=True):
            terms_on_grid = set_grid(part, terms)
            parts.append(
                cross_validate_density(part.equations(terms_on_grid), pieces, list_absorbed_noise(part, terms_on_grid))
            )
        return np.concatenate(parts)

    def screening_score(self, terms: Terms) -> float:
        """Return the negative log density of all blocks [nat], a sort key: the most probable model first."""
        return -float(self.density(terms).sum())

    def gain(self, after: Terms, before: Terms, density: Density | None = None) -> Gain:
        """Return the gain of the model `after` over the model `before`; its p-value includes `penalty`.

        `density` returns the log density of each block under a model (S,), by default `self.density`. Only blocks of
        `_choose_blocks` count.
        """
        new, old = map(density or self.density, (after, before))
        bootstrap, blocks = self._choose_blocks(after, before)
        return bootstrap.gain(new[blocks], old[blocks], self.penalty(after, before))

    def _choose_blocks(self, one: Terms, other: Terms) -> tuple[Bootstrap, slice]:
        """Return the blocks by which two models are compared, with random weights of them.

        If they differ in a table by angle that covers the held-out angles, only held-out data count. Folds of the
        training data may lack the angles of the part that they predict, and this part alone would decide.
        """
        has_table = any(isinstance(term, Table) and term.axis == "position" for term in set(one) ^ set(other))
        is_covered = not any(map(self.residuals.are_refitted, (one, other)))
        return (self._draw_held_out(), self.held_out) if has_table and is_covered else (self.bootstrap, slice(None))

    @memoized
    def _draw_held_out(self) -> Bootstrap:
        """Draw random weights of the held-out blocks alone."""
        return Bootstrap(self.bootstrap.of_block[self.held_out], np.random.default_rng(0))

    def penalty(self, after: Terms, before: Terms) -> float:
        """Return the multiple-comparison penalty [nat]: ln(effects in the library times `count_compared_variants`)."""
        return float(np.log(max(1, len(self.library) * self.count_compared_variants(after, before))))

    def count_compared_variants(self, after: Terms, before: Terms) -> int:
        """Return the number of tried variants of the terms that only `after` has, plus values of its freed integers.

        It is at least one.
        """
        terms_before = {other.id: other for other in before}
        counts = [count_tried(self.train, before, type(term)) for term in after if term.id not in terms_before]
        freed = [
            parameter
            for term in after
            if term.id in terms_before
            for parameter in term.free
            if parameter not in terms_before[term.id].free
        ]
        return max(
            1, sum(counts) + sum(int(parameter.high - parameter.low) for parameter in freed if parameter.integer)
        )

    def is_significant(self, after: Terms, before: Terms) -> bool:
        """Return whether the model `after` predicts significantly better than `before`."""
        return self.gain(after, before).p_value <= self.criterion.p_value

    def is_better_held_out(self, after: Terms, before: Terms) -> bool:
        """Return whether `after` predicts the held-out data alone significantly better than `before`.

        Folds of the training data may lack angles of the part that they predict, and favour laws with few parameters.
        """
        new, old = (self.density(terms)[self.held_out] for terms in (after, before))
        return self._draw_held_out().gain(new, old, self.penalty(after, before)).p_value <= self.criterion.p_value

    def evidence(self, after: Terms, before: Terms) -> Gain:
        """Return the gain of a larger model in torque, or in free motion if only that is significant.

        Windows of torque leave out rest and reversals, where dry friction acts in full. So free motion is simulated if
        the terms that `after` adds are dry friction, and if `before` is a misfit to the motion. Only effects of dry
        friction are compared in free motion, so the penalty counts them alone.
        """
        by_torque = self.gain(after, before)
        if by_torque.p_value <= self.criterion.p_value or not self._may_act_at_rest(after, before):
            return by_torque
        by_motion = self._gain_in_friction(after, before)
        return by_motion if by_motion.p_value <= self.criterion.p_value else by_torque

    def _may_act_at_rest(self, after: Terms, before: Terms) -> bool:
        """Return whether dry friction alone is added to a misfit to the motion."""
        return self._adds_dry_friction(after, before) and self.has_misfit(before)

    def _adds_dry_friction(self, after: Terms, before: Terms) -> bool:
        """Return whether a model has further terms, all of dry friction."""
        ids = list_ids(before)
        added = [term for term in after if term.id not in ids]
        return bool(added) and all(map(is_dry, added))

    def _gain_in_friction(self, after: Terms, before: Terms) -> Gain:
        """Return the gain in free motion of a model over another with less dry friction."""
        n_effects = sum(is_dry(kind()) for kind in self.library.values())
        penalty = float(np.log(max(1, n_effects * self.count_compared_variants(after, before))))
        return self.gain_in_motion(after, before, penalty)[0]

    @memoized
    def has_misfit(self, terms: Terms) -> bool:
        """Return whether the fit of some terms is a misfit to the motion."""
        return bool(self.train.segments) and self.is_misfit(self.fit(terms))

    def is_misfit(self, step: Step) -> bool:
        """Return whether a step is a misfit to the motion of the training data, see `motion_score.is_misfit`."""
        return is_misfit(self.train.segments, step.model, self.criterion)

    def is_supported(self, after: Terms, before: Terms) -> bool:
        """Return whether the larger model `after` passes all gates over `before`."""
        return all(gate.passed for gate in self.make_gates(after, before))

    def is_needed(self, after: Terms, before: Terms) -> bool:
        """Return whether `after` passes all gates with an explained share above `criterion.needed_share`.

        If `after` leaves structure, the share is that of all torque above the noise floor: an unknown law may cause a
        correlated part, and slow torque, which dominates the error of free motion. This error counts for effects that
        torque does not show.
        """
        return all(gate.passed for gate in self.make_gates(after, before, self.criterion.needed_share))

    def is_tied(self, one: Terms, other: Terms, density: Density | None = None) -> bool:
        """Return whether the first of two models has a probability above `criterion.tie_probability`; see `gain`."""
        new, old = map(density or self.density, (one, other))
        bootstrap, blocks = self._choose_blocks(one, other)
        return bool(bootstrap.probabilities([new[blocks], old[blocks]])[0] > self.criterion.tie_probability)

    def make_gates(self, after: Terms, before: Terms, least_share: float | None = None) -> list[Gate]:
        """Return the gates of a larger model up to the first failure: gain with p-value, share, parameters.

        The gain is that of `evidence`. If `before` has known parameters, `after` must also predict significantly better
        than `before` with these free; else it imitates other values of them. `least_share` is the limit of the
        explained share of torque or motion, by default `criterion.explained_share`; see `is_needed`.
        """
        gain, penalty, criterion = (self.evidence(after, before), self.penalty(after, before), self.criterion)
        is_rest_explained = least_share is None or self.residuals.is_noise(after)
        least_share = criterion.explained_share if least_share is None else least_share
        std = gain.error if np.isfinite(gain.error) else None
        gates = [
            Gate("gain", gain.total, penalty, gain.total > penalty, "nat", std),
            Gate("p_value", gain.p_value, criterion.p_value, gain.p_value <= criterion.p_value),
        ]
        if gates[-1].passed and (freed := self.release_known(before)) != before:
            chance = self.evidence(after, freed).p_value
            gates.append(Gate("known_parameters", chance, criterion.p_value, chance <= criterion.p_value))
        if gates[-1].passed:
            if is_rest_explained or not self.is_significant(after, before):
                name, share = "explained_share", self.explained_share(after, before, least_share)
            else:
                name, share = "share_above_floor", self.residuals.explained_share(after, before, above_floor=True)
            gates.append(Gate(name, share, least_share, share > least_share))
        if not gates[-1].passed:
            return gates
        return [*gates, *self.make_coefficient_gates(after, before), *self.make_base_gates(after, before)]

    @memoized
    def make_coefficient_gates(self, after: Terms, before: Terms) -> list[Gate]:
        """Return the gate of the coefficients of added effects, see `make_coefficient_gate`.

        Models with a link, and effects that only free motion shows, have no gate. Dry friction that the torque of few
        windows does not determine passes if free motion shows it.
        """
        if has_link(after) or not self.is_significant(after, before):
            return []
        fit = self.train.equations(after).fit(self.train.layout.clusters)
        gate = make_coefficient_gate(after, fit, list_ids(before), self.criterion.p_value)
        if not gate.passed and self._adds_dry_friction(after, before):
            chance = self._gain_in_friction(after, before).p_value
            gate = replace(gate, value=chance, passed=chance <= gate.limit)
        return [gate]

    def explained_share(self, after: Terms, before: Terms, enough: float = np.inf) -> float:
        """Return the share of the residual torque, or of the error of free motion, that a larger model explains.

        It is the larger of both shares: an effect matters if it changes the torque or the motion. Windows of torque
        leave out stick and reversals, and noise of the torque may exceed the torque of an effect that moves the joint
        far. Motion is simulated only if the share of the torque is not above `enough`.
        """
        share = self.residuals.explained_share(after, before)
        return share if share > enough else max(share, min(self.explained_shares_of_motion(after, before)))

    def explained_shares_of_motion(self, after: Terms, before: Terms) -> tuple[float, float]:
        """Return the shares of the power of free-running errors, training first, that one model has less than another.

        Shares are 0 if the gain over all segments is not significant, and without a simulation.
        """
        gain, shares = self.gain_in_motion(after, before, 0.0)
        return shares if gain.p_value <= self.criterion.p_value else (0.0, 0.0)

    @memoized
    def gain_in_motion(self, after: Terms, before: Terms, penalty: float = 0.0) -> tuple[Gain, tuple[float, float]]:
        """Return the gain of one model over another in free motion, and the shares of the power of errors it removes.

        Both are fitted to the motion, so that parameters of the other model imitate the effect as far as they can. The
        gain is undefined without segments, and with a transmission, because its segments soon diverge.
        """
        if not self.train.segments or has_transmission(after) or has_transmission(before):
            return Gain(0.0, 0.0, 1.0), (0.0, 0.0)
        if not all(self._fit_motion(terms).has_known_inertia for terms in (after, before)):
            return Gain(0.0, 0.0, 1.0), (0.0, 0.0)
        counts = [sum(len(segment.first) for segment in part.segments) for part in self.parts]
        new, old = map(self._compute_motion_squares, (after, before))
        return compute_motion_gain(
            np.repeat(np.arange(2), counts), new, old, self._compute_motion_noise(before), penalty
        )

    @memoized
    def _fit_motion(self, terms: Terms) -> Model:
        """Fit the terms to the torque, then to the motion."""
        return self.refit_to_motion(self.fit(terms)).model

    @memoized
    def _compute_motion_squares(self, terms: Terms) -> Array:
        """Return the mean square error of each segment, training first, of the terms fitted to motion (B,) [rad^2]."""
        model = self._fit_motion(terms)
        return np.concatenate([compute_motion_squares(part.segments, model) for part in self.parts])

    @memoized
    def _compute_motion_noise(self, terms: Terms) -> Array:
        """Return the mean square error of the same segments by torque noise and encoder noise (B,) [rad^2]."""
        model = self._fit_motion(terms)
        return np.concatenate([compute_motion_noise(part.segments, model, 0.0) for part in self.parts])

    def release_known(self, terms: Terms) -> Terms:
        """Return the terms with known parameters free; unchanged for free swings, which need a known inertia."""
        freed = tuple(map(release_term, terms))
        is_scaled = freed != terms and any(recording.known_inertia for recording in self.train.recordings)
        return terms if is_scaled else freed

    def model(self, terms: Terms) -> Model:
        """Fit the terms to the training data, without standard errors."""
        return Model.build(*self.train.maker.fit(terms)).mark_unknown(self._unknown)

    def _find_unknown(self) -> frozenset[str]:
        """Return the name of an inertia to withhold, insignificant by noise alone; else an empty set."""
        if not self.train.layout.predicts_torque or "inertia" not in list_ids(self.base):
            return frozenset()
        model, fit = fit_terms(self.train, self.base)
        inertia, rms = model.estimates["inertia"], float(np.sqrt(np.mean(fit.residual**2)))
        noise = inertia.std * min(1.0, self.residuals.noise_floor() / max(rms, 1e-300))
        return frozenset() if replace(inertia, std=noise).is_significant else frozenset({"inertia"})

    def fit(self, terms: Terms, added: str | None = None) -> Step:
        """Return the step of adding the effect `added`: the fit of the terms to the training data, and its errors."""
        return self.make_step(self.model(terms), added=added)

    def fit_with_std(self, terms: Terms, added: str | None = None) -> Step:
        """Return the step of adding the effect `added`, as `fit`, with standard errors."""
        return self.make_step(self._exact_model(terms), added=added)

    def make_step(self, model: Model, added: str | None = None) -> Step:
        """Return a step with the errors of a model on training and held-out data, with link states estimated.

        The model gets the units of the recordings; an insignificant inertia is withheld.
        """
        parts: Sequence[RegressionData] = self.parts
        if self.linked is None and has_link(model.terms):
            parts = self._estimate_link_states(model.terms, tuple(map(float, model.theta)))
        model = make_arm_model(model).convert_units(self.train.recordings[0].units).mark_unknown(self._unknown)
        return Step(
            added,
            model,
            {name: compute_errors(part, model) for name, part in zip(("train", "holdout"), parts, strict=True)},
        )

    def refit_to_motion(self, step: Step) -> Step:
        """Return the step with parameters refitted to free-running simulation, memoised by its terms.

        The step is unchanged for a transmission (its unknown state diverges), and without segments or known inertia.
        """
        if has_transmission(step.model.terms) or not self.train.segments or not step.model.has_known_inertia:
            return step
        if step.model.terms not in self._in_motion:
            self._in_motion[step.model.terms] = self.fit_to_motion(step.model)
        return replace(self._in_motion[step.model.terms], added=step.added)

    def fit_to_motion(self, start: Model, added: str | None = None) -> Step:
        """Return the step of adding the effect `added`, fitted to free-running simulation from a first model.

        It is stored for `refit_to_motion` of the fitted terms.
        """
        step = self.make_step(fit_to_motion(self.train.segments, start), added=added)
        return self._in_motion.setdefault(step.model.terms, step)

    def find_violations(self, terms: Terms) -> list[Gate]:
        """Return a failed gate for each physical bound that a fit of the terms violates at joints of its effects."""
        joints = {joint for term in terms[len(self.base) :] for joint in list_loads(term.at)}
        motions = {at: x for at, x in self.train.motions.items() if at in joints}
        fits = self.train.maker.fit_folds(terms)  # the score depends on these parameters
        if not find_violations(Model.build(fits.terms, fits.theta).mark_unknown(self._unknown), motions):
            return []
        return find_violations(self._exact_model(terms).mark_unknown(self._unknown), motions)  # with standard errors

    def is_confirmed(self, after: Step, before: Step) -> bool:
        """Return whether held-out errors of `after` are below those of `before` and its parameters are possible."""
        return all(gate.passed for gate in self.make_confirmation_gates(after, before))

    def make_confirmation_gates(self, after: Step, before: Step) -> list[Gate]:
        """Return the gates of physical bounds and held-out errors; see `make_confirmation_gates`.

        If only free motion shows the effects, torque errors may rise by `criterion.error_margin`. Bounds that a fit
        without standard errors violates are tested again with these.
        """
        terms = after.model.terms, before.model.terms
        is_hidden = not self.is_significant(*terms) and self._may_act_at_rest(*terms)
        margin = self.criterion.error_margin if is_hidden else 0.0
        gates = make_confirmation_gates(after, before, self.train.motions, margin)
        if not gates[0].passed and not any(estimate.std for estimate in after.model.estimates.values()):
            after = replace(after, model=self.fit_with_std(terms[0]).model)
            gates = make_confirmation_gates(after, before, self.train.motions, margin)
        return gates

    def keeps_base(self, after: Terms, before: Terms) -> bool:
        """Return whether a larger model keeps the base parameters of a smaller one; see `make_base_gates`."""
        return all(gate.passed for gate in self.make_base_gates(after, before))

    def make_base_gates(self, after: Terms, before: Terms) -> list[Gate]:
        """Return the gates of the base parameters of a larger model, see `make_base_gates`."""
        least = self.criterion.kept_inertia
        return make_base_gates(self._exact_model(after), self._exact_model(before), self.train.motions, least)

    @memoized
    def _exact_model(self, terms: Terms) -> Model:
        """Fit the terms to the training data with standard errors."""
        return fit_terms(self.train, terms)[0]

    def lowers_errors(self, after: Terms, before: Terms) -> bool:
        """Return whether `is_confirmed` holds for the fits of two models to torque, or else to motion."""
        new, old = self.fit(after), self.fit(before)
        if not self.is_confirmed(new, old):
            new, old = self.refit_to_motion(new), self.refit_to_motion(old)
        return self.is_confirmed(new, old)

    @property
    def cost_with_link(self) -> float:
        """Held-out cost of the step `linked`; infinite without a link."""
        return np.inf if self.linked is None else compute_held_out_cost(self.linked)
