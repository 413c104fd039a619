"""What a diagnosis looks for and what is known before it, as the command line's options of these names have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from estimators.arguments import chosen_effects, within_limits
from pendulum_env.physics import Term
from workbench.inputs import ids, known, ranges


@dataclass(frozen=True)
class Asked:
    """Effects to look for, values that are known and bounds of others, each in the words of the command line.

    Attributes:
        only: ids of the effects that are looked for, with commas; empty: all.
        without: ids of those that are not.
        fix: `gravity=2.01,...`
        bound: `viscous=0:0.5,...`
    """

    only: str = ""
    without: str = ""
    fix: str = ""
    bound: str = ""

    @classmethod
    def of(cls, form: Mapping[str, Any]) -> Asked:
        """What the fields `ask-only` and so on of a form hold: ids in a list, or text."""
        values = (form.get(f"ask-{field.name}") or "" for field in fields(cls))
        return cls(*(",".join(map(str, value)) if isinstance(value, list) else str(value).strip() for value in values))

    @property
    def effects(self) -> dict[str, Any]:
        """What `diagnose` takes of effects; raises as the command line does."""
        return {"only": ids(self.only) or None, "without": ids(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """What `diagnose` and `add` take of parameters; raises as the command line does."""
        return {
            "fixed": known(self.fix) if self.fix else {},
            "bounds": ranges(self.bound) if self.bound else {},
        }

    def check(self, terms: Sequence[Term]) -> None:
        """Refuse what makes no sense beside a model's terms: raises ValueError as the command line does."""
        chosen_effects(None, **self.effects)
        within_limits(terms, {}, **self.limits)

    def options(self, *fields: str) -> list[str]:
        """Some fields as words of a command."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]

    def arguments(self, *kinds: dict[str, Any]) -> str:
        """Arguments of Python that are given, each with a comma before it."""
        return "".join(f", {name}={value!r}" for kind in kinds for name, value in kind.items() if value)


NOTHING = Asked()  # every effect is looked for, and nothing is known
