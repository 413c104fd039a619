"""Errors of models on recordings, and steps from one model to a larger one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.findings import Finding, Kind, Quantity
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Model
from pendulum_env.physics.term import list_loads


@dataclass(frozen=True, repr=False)
class Errors:
    """Errors of a model on a recording.

    Attributes:
        torque_rms: the paper's norm (10) of measured minus modelled torque over the windows used [N m]; NaN of an arm
            with joints that turn and joints that slide.
        position_rms: free-running simulation against measured position over one-second windows [rad].
        torque_fit: 100 % less the torque error relative to the torque's own deviation from its mean; 100 is perfect,
            and 0 is as good as a constant [%]. NaN if unknown.
        position_fit: the same of position in free run, relative to the deviation in each one-second window [%].
        joints: torque errors of the joints by name [N m].
        shares: what these are of the root mean square of the joint's torque; None without a motor.
        in_loop: mean absolute error of whole recordings that are simulated with their controller in the loop [rad].
        in_loop_rms: root mean square of the same [rad].

    What cannot be simulated, as an arm or a model whose inertia is unknown, has NaN for a position error.
    """

    torque_rms: float
    position_rms: float
    torque_fit: float = np.nan
    position_fit: float = np.nan
    joints: Mapping[str, float] = field(default_factory=dict)
    shares: Mapping[str, float | None] = field(default_factory=dict)
    in_loop: float = np.nan
    in_loop_rms: float = np.nan

    def with_loop(self, missed: Array) -> Errors:
        """Return the errors with those of positions (R,) [rad] simulated with the controller in the loop."""
        mean, rms = float(np.mean(np.abs(missed))), float(np.sqrt(np.mean(missed**2)))
        return replace(self, in_loop=mean, in_loop_rms=rms)

    def __repr__(self) -> str:
        errors = [f"{name}={value:.4g}" for name, value in self._totals.items()]
        errors += [f"{joint}={error:.4g}" for joint, error in self.joints.items() if joint]
        return f"<Errors: {', '.join(errors)}>"

    @property
    def is_in_loop(self) -> bool:
        """Return whether there are errors of simulated motion with the controller in the loop."""
        return bool(np.isfinite(self.in_loop))

    @property
    def kinds(self) -> dict[str, str]:
        """Names of the errors that a model is judged by, that at each joint first, with their units."""
        if self.is_in_loop:
            return {"in_loop": "rad"}
        return {"torque_rms": "N m"} | ({"position_rms": "rad"} if np.isfinite(self.position_rms) else {})

    @property
    def unit(self) -> str:
        """Unit of the error at a joint."""
        return next(iter(self.kinds.values()))

    def at(self, joint: str) -> float:
        """Return the torque error at a joint [N m], or the error in the loop [rad]."""
        return get_error_at(self.joints, joint, getattr(self, next(iter(self.kinds))))

    @property
    def _totals(self) -> dict[str, float]:
        """Return the known errors of all joints together, by name."""
        return {name: size for name, size in vars(self).items() if isinstance(size, float) and np.isfinite(size)}

    def json(self) -> JSON:
        """Plain dictionary for JSON, without unknown errors."""
        joints = {at: {"torque_rms": rms, "share": self.shares.get(at)} for at, rms in self.joints.items()}
        return {**self._totals, "joints": joints}


def get_error_at(joints: Mapping[str, float], at: str, otherwise: float) -> float:
    """Return the root mean square of the errors of the joints that a term loads [N m]."""
    own = [joints[joint] for joint in list_loads(at) if joint in joints]
    return float(np.sqrt(np.mean(np.square(own)))) if own else otherwise


def get_single(floors: Mapping[str, float]) -> float:
    """Return the noise floor of a single joint [N m]; NaN for several joints."""
    return next(iter(floors.values())) if len(floors) == 1 else np.nan


@dataclass(frozen=True, repr=False)
class Step:
    """Model on the path from the base model: the effect that was added (None: the base) and errors after the refit."""

    added: str | None
    model: Model
    errors: Mapping[str, Errors]  # "train", "holdout"

    def with_log_format(self, log_format: JSON) -> Step:
        """Return the step with a model that has a log format."""
        return replace(self, model=replace(self.model, log_format=log_format))

    def __repr__(self) -> str:
        added = "base model" if self.added is None else f"with {self.added}"
        return f"<Step: {added}, held out {self.errors['holdout']!r}>"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "added": self.added,
            "theta": {name: estimate.json() for name, estimate in self.model.estimates.items()},
            "errors": {part: errors.json() for part, errors in self.errors.items()},
        }


def compute_error_fall(before: Step, after: Step) -> Finding:
    """Return the fall of the held-out errors from one step to the next."""
    old, new = before.errors["holdout"], after.errors["holdout"]
    numbers: dict[str, Quantity] = {}
    for kind, unit in (old.kinds | new.kinds).items():
        unit = after.model.units().unit(unit)
        numbers |= {f"{kind}.before": Quantity(getattr(old, kind), unit=unit)}
        numbers |= {f"{kind}.after": Quantity(getattr(new, kind), unit=unit)}
    return Finding(Kind.ERRORS_FALL, numbers)
