"""Sizes of the parts of a model that a format lacks."""

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.physics.potential import WEIGHT
from pendulum_env.physics.term import Column

ANGLES = np.linspace(-np.pi, np.pi, 145)  # [rad]
SPEEDS = np.linspace(0.0, 5.0, 101)[1:]  # [rad/s]
STATELESS = ("potential", "dissipative", "actuation")  # kinds whose torque follows from motion and motor torque


def make_samples() -> Samples:
    """Make samples at all angles and speeds, forward and backward (N,), without torque."""
    speeds = np.concatenate([-SPEEDS[::-5], SPEEDS[::5]])
    position, velocity = (values.ravel() for values in np.meshgrid(ANGLES, speeds))
    zeros = np.zeros_like(position)
    return Samples(zeros, position, velocity, zeros)


def compute_torque(columns: tuple[Column, ...], model: Model, x: Samples) -> Array:
    """Return the torque of columns of a model (N,) [N m], without acceleration."""
    torque = np.zeros_like(x.position)
    for column in columns:
        torque = torque + model.estimates[column.name].value * column.torque(x, 0.0)
    return torque


def describe_size(model: Model, term: Term) -> str:
    """Describe the size of a term: its largest torque over a turn and `SPEEDS`, else its parameters.

    The motor holds the weight of the model; without weight, effects that follow the load have no torque.
    """
    x = make_samples()
    if term.kind in STATELESS and not term.has_memory and term.columns and not term.has_impacts:
        weights = tuple(column for part in model.terms if part.id in WEIGHT for column in part.columns)
        x = Samples(x.time, x.position, x.velocity, compute_torque(weights, model, x))
        largest = float(np.abs(compute_torque(term.columns, model, x)).max())
        if largest > 0:
            return f"up to {largest:.2g} {model.units().unit('N m')}"
    values = {name: model.estimates[name].value for column in term.columns if (name := column.name) in model.estimates}
    units = {column.name: column.unit for column in term.columns}
    values |= {f"{term.id}.{p.name}": term.nonlinear_values[p.name] for p in term.free}
    units |= {f"{term.id}.{p.name}": p.unit for p in term.free}
    return ", ".join(f"{name} {value:.3g} {units[name]}".removesuffix(" 1") for name, value in values.items())
