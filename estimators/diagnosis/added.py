"""The result of adding an effect to a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.diagnosis.likeness import likenesses
from estimators.selection.criterion import Criterion
from estimators.selection.data import Step
from pendulum_env.notebook import shown
from pendulum_env.physics import Model
from pendulum_env.words import along, listing

SURE = 3.0  # times its standard errors, from which a table has a shape
CHANCE = "lowers the held-out errors by no more than chance would"


def looks(step: Step) -> str | None:
    """The formulas that a table which was added comes nearest to, in a sentence; None of an effect."""
    tables = step.model.tables
    if step.added not in tables:
        return None
    table, curve = tables[step.added]
    if np.mean(curve.value**2) < (SURE * np.median(curve.std)) ** 2:  # at an end they may be large
        return f"{step.added} looks like no formula: its standard errors are nearly as large as itself"
    near = [along(one.text) if table.slides else one.text for one in likenesses(table, curve)]
    nearest = f"{listing(near, 'or')} of its shape" if near else "no formula that is known here"
    return f"{step.added} looks like {nearest}"


@dataclass(frozen=True, repr=False)
class Addition:
    """One effect added to a model.

    Attributes:
        before: the model refitted without the effect, and its errors.
        after: the same with the effect.
        noise_floor: torque error that measurement noise alone gives [N m].
        objection: what speaks against the effect, None if nothing does.
        doubt: why the torque constant of a current is not known; None if it is, or torque was logged.
    """

    before: Step
    after: Step
    noise_floor: float
    objection: str | None = None
    doubt: str | None = None

    @property
    def text(self) -> str:
        """Whether the effect earns its place, in a sentence: only data that it was not fitted to can tell."""
        if self.objection is not None:
            return f"{self.after.added} {self.objection}: these recordings give no reason to keep it"
        old, new = self.before.errors["holdout"], self.after.errors["holdout"]
        if self.is_in_loop:
            return (
                f"{self.after.added} lowers the held-out error in the loop to {new.in_loop / old.in_loop:.1%} of before"
            )
        torque, position = new.torque_rms / old.torque_rms, new.position_rms / old.position_rms
        falls = f"torque to {torque:.1%}, position to {position:.1%} of before"
        return f"{self.after.added} lowers the held-out errors: {falls}"

    @property
    def looks_like(self) -> str | None:
        """The formulas that a table which was added comes nearest to, in a sentence; None of an effect."""
        return looks(self.after) if self.objection is None else None

    @property
    def is_in_loop(self) -> bool:
        """Whether errors are those of motion that was simulated with the controller in the loop."""
        return self.before.errors["holdout"].is_in_loop

    @property
    def left(self) -> float:
        """Held-out error that is left, in noise floors."""
        error = self.after.errors["holdout"]
        if self.is_in_loop:  # where what is left counts as noise up to some times the encoder's
            return error.in_loop / (Criterion().misfit * self.noise_floor)
        return error.torque_rms / self.noise_floor

    @property
    def model(self) -> Model:
        """The model with the effect."""
        return self.after.model

    def __repr__(self) -> str:
        return f"<Addition: {self.text}>"

    def _repr_html_(self) -> str:
        return shown(self)
