"""What MuJoCo does not have, as a program that is called before each of its steps: a controller, and effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pendulum_env.physics import Model, Samples, Term
from workbench.export import c, python
from workbench.export.dynamics import Dynamics, beside
from workbench.export.request import ExportError, Request

JOINT, ACTUATOR = "joint", "torque"  # names in the file beside it


def callback(model: Model, terms: Sequence[Term], request: Request) -> str:
    """The program for some terms of a model, and the drive, if there is one.

    Raises:
        ExportError: if a law is no formula.
    """
    dynamics = beside(model, terms, request.drive, request.step)
    if request.callback == "c":
        return c.program(model, dynamics, "joint") + _use_in_c(dynamics)
    return python.program(model, dynamics) + _use_in_python(dynamics)


def inertia_of(model: Model, terms: Sequence[Term]) -> float:
    """Inertia that some terms of a model add to that of the arm [kg m^2].

    Raises:
        ExportError: if it changes, as no body's does.
    """
    columns = [column for term in terms for column in term.columns]
    times = np.array([0.0, 1.0, 1e3, 1e6])
    x = Samples(times, times, times, 0.0 * times)
    total = 0.0
    for column in columns:
        masses = model.estimates[column.name].value * np.broadcast_to(column.mass(x), times.shape)
        if np.ptp(masses):
            raise ExportError(f"mjcf cannot hold {column.name}: no body of MuJoCo's changes its inertia")
        total += float(masses[0])
    return total


def _use_in_python(dynamics: Dynamics) -> str:
    given = [quantity for quantity in dynamics.given if quantity.name not in ("position", "velocity")]
    declared = ", ".join(q.name if q.usual is None else f"{q.name}={q.usual!r}" for q in given)
    return f'''

def before_step(model, data, state, {declared}):
    """Drive the joint of the file beside this one; call it before every mj_step, and keep the state it returns."""
    joint = model.joint("{JOINT}")
    angle, speed = data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]]
    state, torque, friction = step(state, angle, speed, {", ".join(q.name for q in given)})
    data.ctrl[model.actuator("{ACTUATOR}").id] = torque
    model.dof_frictionloss[joint.dofadr[0]] = friction
    return state
'''


def _use_in_c(dynamics: Dynamics) -> str:
    given = ", ".join(q.name for q in dynamics.given if q.name not in ("position", "velocity"))
    return f"""
/* Before every mj_step, with the joint and the actuator of the file beside this one:

       int joint = mj_name2id(m, mjOBJ_JOINT, "{JOINT}"), dof = m->jnt_dofadr[joint];
       double friction;
       joint_step(&state, d->qpos[m->jnt_qposadr[joint]], d->qvel[dof], {given},
                  &d->ctrl[mj_name2id(m, mjOBJ_ACTUATOR, "{ACTUATOR}")], &friction);
       m->dof_frictionloss[dof] = friction; */
"""
