"""Effects of users: a law of their own; and a table, which is no formula, beside the formula that it holds."""

from dataclasses import dataclass

import numpy as np

from pendulum_env.physics import Column, Term


@dataclass(frozen=True)
class CubicDamping(Term):
    """Damping that grows with the cube of the speed."""

    id, law, kind = "cubic_damping", "c q'^3", "dissipative"

    columns = (Column("cubic_damping", "N m s^3/rad^3", force=lambda x: x.velocity**3),)


@dataclass(frozen=True)
class Table(Term):
    """A torque by angle, looked up."""

    id, law, kind = "table", "t(q)", "potential"

    columns = (Column("table", "N m", force=lambda x: np.interp(x.position, [-1.0, 1.0], [-1.0, 1.0])),)


@dataclass(frozen=True)
class Clipped(Table):
    """The same torque, computed."""

    columns = (Column("table", "N m", force=lambda x: np.clip(x.position, -1.0, 1.0)),)
