"""The four terms of the paper's pendulum: tau = I q'' + mgl sin q + b q' + fc sgn q'."""

from dataclasses import dataclass

import numpy as np

from pendulum_env.physics.term import Column, Term, return_one


@dataclass(frozen=True)
class Inertia(Term):
    """Moment of inertia about the pivot, I q''; stores I q'^2 / 2."""

    id = "inertia"
    law = "I q''"
    kind = "inertial"

    columns = (Column("inertia", "kg m^2", mass=return_one, is_of_body=True),)


@dataclass(frozen=True)
class Gravity(Term):
    """Weight at a distance from the axis, mgl sin q; stores mgl (1 - cos q)."""

    id = "gravity"
    law = "mgl sin q"
    kind = "potential"
    by_angle = ("sine",)

    columns = (
        Column("gravity", "N m", force=lambda x: np.sin(x.position), potential=lambda x: 1.0 - np.cos(x.position)),
    )


@dataclass(frozen=True)
class Viscous(Term):
    """Viscous friction b q', b >= 0; dissipates b q'^2."""

    id = "viscous"
    law = "b q'"
    kind = "dissipative"

    columns = (Column("viscous", "N m s/rad", force=lambda x: x.velocity, is_of_body=True),)


@dataclass(frozen=True)
class Coulomb(Term):
    """Dry friction fc sgn q', set-valued at rest (|friction| <= fc); dissipates fc |q'|."""

    id = "coulomb"
    law = "fc sgn q'"
    kind = "dissipative"

    columns = (Column("coulomb", "N m", dry=return_one, is_of_body=True),)


BASE: tuple[Term, ...] = (Inertia(), Gravity(), Viscous(), Coulomb())
