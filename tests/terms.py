"""A user's effect, once as a table, which is no formula, and once as the formula that it holds."""

from dataclasses import dataclass

import numpy as np

from pendulum_env.physics import Column, Term


@dataclass(frozen=True)
class Table(Term):
    """A torque by angle, looked up."""

    id, law, kind = "table", "t(q)", "potential"

    @property
    def columns(self):
        return (Column("table", "N m", force=lambda x: np.interp(x.position, [-1.0, 1.0], [-1.0, 1.0])),)


@dataclass(frozen=True)
class Clipped(Table):
    """The same torque, computed."""

    @property
    def columns(self):
        return (Column("table", "N m", force=lambda x: np.clip(x.position, -1.0, 1.0)),)
