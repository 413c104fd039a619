"""The result of a diagnosis: what is missing in the model, how sure that is, and what the errors were on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from estimators.agreement import Disagreement
from estimators.evidence import Errors
from estimators.regions import Region
from estimators.suggestion import Suggestion
from pendulum_env._typing import JSON
from pendulum_env.physics import Model
from pendulum_env.words import listing, name, opening

SCHEMA = "pendulum-ident/diagnosis@1"


class Verdict(StrEnum):
    """What became of a candidate effect."""

    SELECTED = "selected"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"
    NOT_EXCITED = "not_excited"


@dataclass(frozen=True)
class Candidate:
    """One effect of the library as the data judge it.

    Attributes:
        effect: its id.
        score: probability, between 0 and 1, that it is what the data call for at its place among the alternatives.
        verdict: what became of it.
        error_ratio: torque error on held-out data with the effect, over the error without it.
        reason: why, in words.
    """

    effect: str
    score: float
    verdict: Verdict
    error_ratio: float
    reason: str

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "effect": self.effect,
            "score": self.score,
            "verdict": str(self.verdict),
            "error_ratio": self.error_ratio,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Step:
    """One rung of the ladder: the effect that was added (None: the base model) and the errors after the refit."""

    added: str | None
    model: Model
    errors: Mapping[str, Errors]  # "train", "holdout"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "added": self.added,
            "theta": {name: estimate.json() for name, estimate in self.model.estimates.items()},
            "errors": {part: errors.json() for part, errors in self.errors.items()},
        }


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """What a diagnosis found.

    Attributes:
        steps: the base model, then one entry for each effect added.
        candidates: every effect of the library, selected ones first.
        ambiguous: groups of effects that these data cannot tell apart.
        unexplained: regions whose residual no candidate explains, empty when the noise floor is reached.
        noise_floor: torque error that measurement noise alone gives [N m].
        advice: experiments that would settle what is open, in words.
        suggestion: the experiment that would settle most of what is open, None if nothing is, or none would.
        forbidden: what the limits of the rig keep any experiment from settling, in words; None if nothing.
        inseparable: groups that no torque would tell apart, whatever it was.
        disagreements: recordings that show another plant than the others; fitted ones among them are set apart.
        window_share: length of the windows used, relative to the length that the noise asks for.
    """

    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    ambiguous: tuple[tuple[str, ...], ...]
    unexplained: tuple[Region, ...]
    noise_floor: float
    advice: tuple[str, ...]
    suggestion: Suggestion | None = None
    forbidden: str | None = None
    inseparable: tuple[tuple[str, ...], ...] = ()
    disagreements: tuple[Disagreement, ...] = ()
    window_share: float = 1.0

    @property
    def model(self) -> Model:
        """The final model."""
        return self.steps[-1].model

    @property
    def selected(self) -> tuple[str, ...]:
        """Ids of the effects found to be missing, in the order in which they were added."""
        return tuple(step.added for step in self.steps if step.added is not None)

    @property
    def headline(self) -> str:
        """The result in one sentence: `Stribeck friction is missing`."""
        rivals = {group[0]: group for group in self.ambiguous}
        found = [listing([name(id) for id in rivals.get(effect, (effect,))], "or") for effect in self.selected]
        if found:
            rest = ", and more that no known effect explains" if self.unexplained else ""
            return f"{opening(listing(found))} {'is' if len(found) == 1 else 'are'} missing{rest}"
        if not self.candidates:  # nobody has looked yet
            return "Something is missing in this model" if self.unexplained else "The model explains what was measured"
        if self.unexplained:
            return "Something is missing, and no known effect explains it"
        return "Nothing is missing"

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.headline}>"

    def _repr_html_(self) -> str:
        from estimators.notebook import show_diagnosis  # only a notebook asks for it

        return show_diagnosis(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON, as the design of the command line fixes it."""
        base = self.steps[0].model
        return {
            "schema": SCHEMA,
            "base": {
                "terms": [term.id for term in base.terms],
                "theta": {name: estimate.json() for name, estimate in base.estimates.items()},
            },
            "selected": list(self.selected),
            "steps": [step.json() for step in self.steps],
            "candidates": [candidate.json() for candidate in self.candidates],
            "ambiguous": [list(group) for group in self.ambiguous],
            "unexplained": {
                "present": bool(self.unexplained),
                "where": "; ".join(region.text for region in self.unexplained) or None,
            },
            "regions": [region.json() for region in self.unexplained],
            "noise_floor": {"torque_rms": self.noise_floor},
            "advice": list(self.advice),
            "suggestion": self.suggestion.json() if self.suggestion is not None else None,
            "forbidden": self.forbidden,
            "inseparable": [list(group) for group in self.inseparable],
            "disagreements": [disagreement.json() for disagreement in self.disagreements],
        }
