"""Physics of the pendulum: terms, the library of effects, models and their simulation."""

from pendulum_env.physics.base import BASE, Coulomb, Gravity, Inertia, Viscous
from pendulum_env.physics.description import Description
from pendulum_env.physics.estimate import SIGNIFICANT, Estimate
from pendulum_env.physics.library import effect, effects, find_term, list_addable, list_nameable, register
from pendulum_env.physics.limits import Bounds, release_term
from pendulum_env.physics.mechanism import PENDULUM, Mechanism, describe_joints
from pendulum_env.physics.model import Model
from pendulum_env.physics.model_file import ModelError
from pendulum_env.physics.plugin import PluginError, load_plugin
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.table import COMPETING, TABLES, ByTime, Table
from pendulum_env.physics.term import LOAD, Column, KnownLoad, NonlinearParameter, Samples, Term, list_loads
from pendulum_env.physics.terms import (
    count_term_parameters,
    find_link,
    has_link,
    has_stop,
    has_transmission,
    is_dry,
    is_hidden,
    list_ids,
)

# Names of 1.0.0, kept for one release
Shape, addable, nameable = NonlinearParameter, list_addable, list_nameable

__all__ = [
    "BASE",
    "COMPETING",
    "LOAD",
    "PENDULUM",
    "SIGNIFICANT",
    "TABLES",
    "Bounds",
    "ByTime",
    "Column",
    "Coulomb",
    "Description",
    "Estimate",
    "Gravity",
    "Inertia",
    "KnownLoad",
    "Mechanism",
    "Model",
    "ModelError",
    "NonlinearParameter",
    "PluginError",
    "Samples",
    "Shape",
    "Table",
    "Term",
    "Trajectory",
    "Viscous",
    "count_term_parameters",
    "describe_joints",
    "effect",
    "effects",
    "find_link",
    "find_term",
    "has_link",
    "has_stop",
    "has_transmission",
    "is_dry",
    "is_hidden",
    "list_addable",
    "list_ids",
    "list_loads",
    "list_nameable",
    "load_plugin",
    "register",
    "release_term",
    "simulate",
]
