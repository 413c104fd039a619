"""Physics of the pendulum: terms, the library of effects, models and their simulation."""

from pendulum_env.physics.base import BASE, Coulomb, Gravity, Inertia, Viscous
from pendulum_env.physics.description import Description
from pendulum_env.physics.estimate import Estimate
from pendulum_env.physics.library import effect, effects, list_addable, list_nameable, register
from pendulum_env.physics.model import Model
from pendulum_env.physics.model_file import ModelError
from pendulum_env.physics.plugin import PluginError, load_plugin
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.term import Column, KnownLoad, NonlinearParameter, Samples, Term

# Names of earlier releases, kept for one more
Shape, addable, nameable = NonlinearParameter, list_addable, list_nameable

__all__ = [
    "BASE",
    "Column",
    "Coulomb",
    "Description",
    "Estimate",
    "Gravity",
    "Inertia",
    "KnownLoad",
    "Model",
    "ModelError",
    "NonlinearParameter",
    "PluginError",
    "Samples",
    "Shape",
    "Term",
    "Trajectory",
    "Viscous",
    "effect",
    "effects",
    "list_addable",
    "list_nameable",
    "load_plugin",
    "register",
    "simulate",
]
