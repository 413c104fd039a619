"""Physics of the pendulum: terms, the library of effects, models and their simulation."""

from pendulum_env.physics.base import BASE, Coulomb, Gravity, Inertia, Viscous
from pendulum_env.physics.library import effect, effects, register
from pendulum_env.physics.model import Estimate, Model, ModelError
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.term import Column, Samples, Shape, Term

__all__ = [
    "BASE",
    "Column",
    "Coulomb",
    "Estimate",
    "Gravity",
    "Inertia",
    "Model",
    "ModelError",
    "Samples",
    "Shape",
    "Term",
    "Trajectory",
    "Viscous",
    "effect",
    "effects",
    "register",
    "simulate",
]
