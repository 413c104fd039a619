"""Fits of terms to rows, to simulated segments and to the states of a link, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.data.fits import fit_terms
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.decisions.errors import Step, Terms
from estimators.decisions.gate import Gate
from estimators.memoize import memoized
from estimators.selection.motion_score import fit_to_motion
from estimators.selection.physical import find_violations
from pendulum_env.physics import BASE, Model, has_link, has_transmission, list_ids, list_loads, release_term
from pendulum_env.physics.model import complete_model


@dataclass(eq=False, repr=False)
class Fits:
    """Fits of terms to training data, with errors on training and held-out data; results are memoised.

    Attributes:
        train: data to fit.
        holdout: data to predict.
        base: terms that the search starts from.
        linked: fitted model that estimated the states of a link; None without a link.
    """

    train: RegressionData
    holdout: RegressionData
    base: Terms = BASE
    linked: Step | None = None
    _in_motion: dict[Terms, Step] = field(init=False, default_factory=dict)

    @property
    def parts(self) -> tuple[RegressionData, RegressionData]:
        """Training and held-out data."""
        return self.train, self.holdout

    def with_link(self, linked: Step) -> Fits:
        """Return fits to the same data with link states estimated by the model of `linked`."""
        train, holdout = self._estimate_link_states(linked.model.terms, tuple(map(float, linked.model.theta)))
        return Fits(train, holdout, self.base, linked)

    @memoized
    def _estimate_link_states(self, terms: Terms, theta: tuple[float, ...]) -> list[RegressionData]:
        """Return training and held-out data with link states estimated by the model of some parameters (P,)."""
        model = Model.build(terms, np.array(theta))
        return [part.with_link_states(model) for part in self.parts]

    def list_parts(self, model: Model) -> Sequence[RegressionData]:
        """Return training and held-out data, with states of the link estimated by a model unless they are known."""
        if self.linked is not None or not has_link(model.terms):
            return self.parts
        return self._estimate_link_states(model.terms, tuple(map(float, model.theta)))

    def release_known(self, terms: Terms) -> Terms:
        """Return the terms with known parameters free; unchanged for free swings, which need a known inertia."""
        freed = tuple(map(release_term, terms))
        is_scaled = freed != terms and any(recording.known_inertia for recording in self.train.recordings)
        return terms if is_scaled else freed

    def fit_model(self, terms: Terms) -> Model:
        """Fit the terms to the training data, without standard errors."""
        return self._withhold_inertia(Model.build(*self.train.maker.fit(terms)))

    @memoized
    def fit_model_with_std(self, terms: Terms) -> Model:
        """Fit the terms to the training data with standard errors."""
        return fit_terms(self.train, terms)[0]

    def _withhold_inertia(self, model: Model) -> Model:
        """Return a model without an inertia that the base model shows to be unknown; a link has its own inertia."""
        return model if has_link(model.terms) else model.mark_unknown(self._unknown)

    @cached_property
    def _unknown(self) -> frozenset[str]:
        """Name of an inertia to withhold, insignificant by noise alone; else an empty set."""
        if not self.train.layout.predicts_torque or "inertia" not in list_ids(self.base):
            return frozenset()
        model, fit = fit_terms(self.train, self.base)
        noise = float(fit.compute_std_by_noise(next(iter(self.train.floors.values())))[0])
        inertia = replace(model.estimates["inertia"], std=noise)
        return frozenset() if inertia.is_significant else frozenset({"inertia"})

    def fit(self, terms: Terms, added: str | None = None) -> Step:
        """Return the step of adding the effect `added`: the fit of the terms to the training data, and its errors."""
        return self.make_step(self.fit_model(terms), added=added)

    def fit_with_std(self, terms: Terms, added: str | None = None) -> Step:
        """Return the step of adding the effect `added`, as `fit`, with standard errors."""
        return self.make_step(self.fit_model_with_std(terms), added=added)

    def make_step(self, model: Model, added: str | None = None) -> Step:
        """Return a step with the errors of a model on training and held-out data, with link states estimated.

        The model gets the units of the recordings; an insignificant inertia is withheld.
        """
        parts = self.list_parts(model)
        model = complete_model(model.mechanism, model).convert_units(self.train.recordings[0].units)
        model = self._withhold_inertia(model)
        errors = [compute_errors(part, model) for part in parts]
        return Step(added, model, dict(zip(("train", "holdout"), errors, strict=True)))

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

    @memoized
    def fit_terms_to_motion(self, terms: Terms) -> Model:
        """Fit the terms to the torque, then to the motion."""
        return self.refit_to_motion(self.fit(terms)).model

    def find_violations(self, terms: Terms) -> list[Gate]:
        """Return a failed gate for each physical bound that a fit of the terms violates at joints of its effects."""
        joints = {joint for term in terms[len(self.base) :] for joint in list_loads(term.at)}
        motions = {at: x for at, x in self.train.motions.items() if at in joints}
        fits = self.train.maker.fit_folds(terms)  # the score depends on these parameters
        recorded = self.train.recorded_motions
        if not find_violations(self._withhold_inertia(Model.build(fits.terms, fits.theta)), motions, recorded):
            return []
        return find_violations(self._withhold_inertia(self.fit_model_with_std(terms)), motions, recorded)
