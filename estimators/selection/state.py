"""State of the search: the model that it has reached."""

from __future__ import annotations

from dataclasses import dataclass, replace

from estimators.decisions.decision import Policy
from estimators.decisions.errors import Terms
from estimators.selection.candidates import refit_nonlinear
from estimators.selection.evidence import Evidence, Hypothesis
from estimators.weak_form.contacts import count_contacts
from pendulum_env.physics import Table, Term, has_stop


@dataclass(frozen=True)
class SearchState:
    """Model that the search has reached.

    Attributes:
        evidence: fits and scores of models; with a fitted link, on data with its estimated states.
        start: terms that the search started from.
        terms: terms of the model, those of `start` first.
        table: nonparametric function that replaces effects; None without one.
    """

    evidence: Evidence
    start: Terms
    terms: Terms
    table: Table | None = None

    @property
    def effects(self) -> Terms:
        """Terms that were added to the start."""
        return self.terms[len(self.start) :]

    @property
    def hypothesis(self) -> Hypothesis:
        """Model as one side of a decision, with the step that estimated its link states."""
        linked = self.evidence.fits.linked
        is_own = linked is not None and linked.model.terms == self.terms
        return Hypothesis(self.evidence, self.terms, linked if is_own else None)

    @property
    def is_noise(self) -> bool:
        """True if the residual of the model is noise on all data."""
        return self.evidence.residuals.is_noise(self.terms)

    @property
    def needs_stop(self) -> bool:
        """True if only a stop explains the torque at contacts that the data have, and the model has none."""
        train = self.evidence.train
        return not has_stop(self.terms) and train.layout.predicts_torque and count_contacts(train.data) > 0

    def has_room(self, count: int) -> bool:
        """Return whether the model may have some more effects."""
        return len(self.effects) + count <= self.evidence.criterion.search.max_effects

    def accepts(self, terms: Terms, policy: Policy[Hypothesis]) -> bool:
        """Return whether some terms may take the place of those of the state."""
        return self.evidence.decide(terms, self.terms, policy).passed

    def with_terms(self, terms: Terms) -> SearchState:
        """Return the state with other terms."""
        return replace(self, terms=terms)

    def refit(self, terms: Terms) -> SearchState:
        """Return the state with other terms and refitted nonlinear parameters."""
        return self.with_terms(refit_nonlinear(self.evidence, terms))


def remove_term(terms: Terms, term: Term) -> Terms:
    """Return the terms without one of them."""
    return tuple(other for other in terms if other is not term)
