"""What an arm carries: the body at a link that recordings show beside a model, or beside recordings without it.

Ten standard parameters of a body that is fixed to a link are ten columns of that link's, which are combinations of the
base parameters': Y_link = Y K, K the link's columns of `Body.combine`. In one recording they are part of the base
parameters; where these are known, or the same in other recordings, what is left is the payload's. Friction at the
joints is fitted anew, as it changes with temperature.
Source: Khosla and Kanade, IEEE Conference on Decision and Control, 1985; Gaz and De Luca, IROS 2017.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from estimators.arms.standard import pseudo_inertia
from estimators.regression.equations import Equations, IdentificationError
from estimators.regression.least_squares import Fit, solve
from estimators.schemes.balance import ARM_SCHEMES
from estimators.schemes.fitting import by_joint, regressions, stack
from estimators.signals.measurements import measure_joints
from pendulum_env._typing import JSON, Array, Index, Mask
from pendulum_env.arms.body import STANDARD
from pendulum_env.arms.joints import links_of
from pendulum_env.lookup import find
from pendulum_env.physics import Estimate, Model
from pendulum_env.recording import Recording

SCHEME = ARM_SCHEMES[1]  # filtered dynamic: the torque of each joint, without differentiating noise
HIDDEN = 1e-6  # share of a direction that no motion of the joints shows, from which a parameter is unknown
SURE, SHARE = 5.0, 0.5  # standard errors of a mass, and share of the torque left, from which a payload stands out


@dataclass(frozen=True)
class Payload:
    """A body that an arm carries.

    Attributes:
        joint: in front of the link that carries it, in whose frame everything is told.
        estimates: its mass, first moments and moments of inertia about the joint's origin, by their names in URDF's
            frame (`m`, `mx` ... `Izz`), those that the motion of the joints shows.
        center: of mass (3,) [m], where mass and first moments are shown.
        exists: whether some body has these parameters, within two standard errors; None if not all are shown.
        left: torque that remains of each joint [N m], without the payload and with it.
    """

    joint: str
    estimates: Mapping[str, Estimate]
    center: tuple[Estimate, ...] | None
    exists: bool | None
    left: Mapping[str, tuple[float, float]]

    @property
    def hidden(self) -> tuple[str, ...]:
        """Parameters that no motion of the joints shows."""
        return tuple(name for name in STANDARD if name not in self.estimates)

    @property
    def stands_out(self) -> bool:
        """Whether a body may well be what has changed: it has mass, and explains most of what two joints lack."""
        mass = self.estimates.get("m")
        helped = sum(after < SHARE * before for before, after in self.left.values())
        return mass is not None and mass.value > SURE * mass.std and self.exists is not False and helped >= 2

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": "pendulum-ident/payload@1",
            "joint": self.joint,
            "theta": {name: one.json() for name, one in self.estimates.items()},
            "center": None if self.center is None else [one.json() for one in self.center],
            "hidden": list(self.hidden),
            "exists": self.exists,
            "torque_rms": {name: {"without": a, "with": b} for name, (a, b) in self.left.items()},
        }


def find_payload(
    model: Model,
    carrying: Sequence[Recording],
    without: Sequence[Recording] = (),
    joint: str | None = None,
) -> Payload:
    """The body that an arm carries in some recordings.

    Args:
        model: of the arm without it. Its friction is fitted anew; its base parameters are, too, if there are
            recordings without the payload, and taken as they are otherwise: the standard errors then count the noise of
            the recordings that carry alone.
        carrying: recordings with the payload.
        without: recordings without it.
        joint: in front of the link that carries it, the last one by default.

    Raises:
        IdentificationError: if there is too little motion.
        ValueError: if there is no such joint.
    """
    body = links_of(model.terms)
    joint = joint or body.joints[-1]
    k = body.links.index(find("joint", joint, {name: name for name in body.joints}))
    combine = body.combine[:, 10 * k : 10 * (k + 1)]  # (P, 10)
    unseen = scipy.linalg.null_space(combine, rcond=HIDDEN)
    shown = scipy.linalg.null_space(unseen.T) if unseen.size else np.eye(len(STANDARD))  # (10, r)
    segments = [measure_joints(recording.joints) for recording in (*without, *carrying)]
    data = stack(segments, partial(regressions(model.terms), SCHEME))
    loaded = data.recording >= len(without)
    of_base, of_friction = np.split(data.equations.phi, [len(combine)], axis=1)
    extra = np.where(loaded[:, None], of_base @ combine @ shown, 0.0)
    if without:
        known, y = [of_base, of_friction * ~loaded[:, None], of_friction * loaded[:, None]], data.equations.y
    else:
        known, y = [of_friction], data.equations.y - of_base @ model.theta[: len(combine)]
    use = data.usable
    if not (use & loaded).any():
        raise IdentificationError(f"{carrying[0].name}: too little motion clear of reversals to tell a payload")
    clusters = np.unique(data.clusters[use], return_inverse=True)[1]
    each = [Equations(np.column_stack(columns)[use], y[use]) for columns in (known, [*known, extra])]
    empty, fit = (solve(equations, by_joint(equations, data.joint[use]), clusters) for equations in each)
    size = shown.shape[1]
    values, covariance = shown @ fit.theta[-size:], shown @ fit.covariance[-size:, -size:] @ shown.T
    std = np.sqrt(np.diag(covariance))
    estimates = {
        name: Estimate(float(values[n]), float(std[n]), body.unit_of(f"{name}@{joint}"))
        for n, name in enumerate(STANDARD)
        if not unseen.size or np.linalg.norm(unseen[n]) < HIDDEN
    }
    left = _missed(body.joints, np.where(loaded, data.joint, -1)[use], empty, fit)
    center = _center(values, covariance) if set(STANDARD[:4]) <= estimates.keys() else None
    return Payload(
        joint, estimates, center, _exists(values, covariance) if len(estimates) == len(STANDARD) else None, left
    )


def _missed(joints: Sequence[str], joint: Index, before: Fit, after: Fit) -> dict[str, tuple[float, float]]:
    """Torque that two fits leave of each joint that has equations, by its number in each of them (R,), -1 for none."""
    rows = {name: joint == n for n, name in enumerate(joints)}

    def rms(fit: Fit, own: Mask) -> float:
        return float(np.sqrt(np.mean(fit.residual[own] ** 2)))

    return {name: (rms(before, own), rms(after, own)) for name, own in rows.items() if own.any()}


def _center(values: Array, covariance: Array) -> tuple[Estimate, ...] | None:
    """Centre of mass from mass and first moments, with first-order standard errors; None where there is no mass."""
    mass = values[0]
    if mass <= 2 * np.sqrt(covariance[0, 0]):
        return None
    found = []
    for n in (1, 2, 3):
        slope = np.array([-values[n] / mass**2, 1 / mass])
        variance = slope @ covariance[np.ix_([0, n], [0, n])] @ slope
        found.append(Estimate(float(values[n] / mass), float(np.sqrt(variance)), "m"))
    return tuple(found)


def _exists(values: Array, covariance: Array) -> bool:
    """Whether the pseudo-inertia is positive, within two standard errors of its least eigenvalue.

    Source: Wensing, Kim and Slotine, IEEE Robotics and Automation Letters 3(1), 2018.
    """
    eigenvalues, vectors = np.linalg.eigh(pseudo_inertia(values))
    least = vectors[:, 0]
    slope = np.array([least @ pseudo_inertia(unit) @ least for unit in np.eye(len(values))])
    return bool(eigenvalues[0] + 2 * np.sqrt(slope @ covariance @ slope) > 0)
