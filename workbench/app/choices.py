"""Options of a search: effects to look for, known values and bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from estimators.arguments import apply_limits, select_effects
from pendulum_env.arms.joints import find_body
from pendulum_env.physics import Term
from workbench.options import parse_bounds
from workbench.options import parse_effects as effects_of
from workbench.options import parse_values as values_of


@dataclass(frozen=True)
class SearchChoices:
    """Effects to look for, known values and bounds, each as text of the command-line option."""

    only: str = ""  # comma-separated ids of the effects to look for; empty: all
    without: str = ""  # comma-separated ids of the effects to leave out
    fix: str = ""  # known values, `gravity=2.01,...`
    bound: str = ""  # bounds, `viscous=0:0.5,...`

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> SearchChoices:
        """Create choices from the form fields `ask-only`, `ask-without`, `ask-fix` and `ask-bound`."""
        values = (form.get(f"ask-{field.name}") or "" for field in fields(cls))
        return cls(*(",".join(map(str, value)) if isinstance(value, list) else str(value).strip() for value in values))

    @property
    def effects(self) -> dict[str, Any]:
        """Return the arguments `only` and `without` of `diagnose`; raises ValueError if an effect is unknown."""
        return {"only": effects_of(self.only) or None, "without": effects_of(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """Return the arguments `fixed` and `bounds` of `diagnose` and `add`; raises InputError if they are invalid."""
        fixed, bounds = values_of(self.fix) if self.fix else {}, parse_bounds(self.bound) if self.bound else {}
        return {"fixed": fixed, "bounds": bounds}

    def check(self, terms: Sequence[Term]) -> None:
        """Raise ValueError if an effect or parameter does not exist for a model with these terms."""
        select_effects(None, **self.effects, body=find_body(terms))
        apply_limits(terms, {}, **self.limits)

    def write_options(self, *fields: str) -> list[str]:
        """Write the given fields as command-line options, without empty ones."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]


NO_CHOICES = SearchChoices()  # all effects, no known values
