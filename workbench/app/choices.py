"""Effects that a user looks for, and values that a user knows."""

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
    """Effects to look for, values that are known and bounds of others, each in the words of the command line."""

    only: str = ""  # ids of the effects that are looked for, with commas; empty: all
    without: str = ""  # ids of those that are not
    fix: str = ""  # `gravity=2.01,...`
    bound: str = ""  # `viscous=0:0.5,...`

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> SearchChoices:
        """Return the values of the form fields `ask-only` and so on: ids in a list, or text."""
        values = (form.get(f"ask-{field.name}") or "" for field in fields(cls))
        return cls(*(",".join(map(str, value)) if isinstance(value, list) else str(value).strip() for value in values))

    @property
    def effects(self) -> dict[str, Any]:
        """Return the effects for `diagnose`; raises as the command line."""
        return {"only": effects_of(self.only) or None, "without": effects_of(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """Return the limits of parameters for `diagnose` and `add`; raises as the command line."""
        return {
            "fixed": values_of(self.fix) if self.fix else {},
            "bounds": parse_bounds(self.bound) if self.bound else {},
        }

    def check(self, terms: Sequence[Term]) -> None:
        """Refuse what makes no sense beside a model's terms: raises ValueError as the command line does."""
        select_effects(None, **self.effects, body=find_body(terms))
        apply_limits(terms, {}, **self.limits)

    def write_options(self, *fields: str) -> list[str]:
        """Write some fields as words of a command."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]


NO_CHOICES = SearchChoices()  # every effect is looked for, and nothing is known
