"""Errors of models on recordings, and steps from one model to a larger one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.findings import Change, Finding, Quantity
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Model, Term, list_loads
from pendulum_env.quantity import get_finite

Terms = tuple[Term, ...]
FILE_NAMES = {
    "motion": "in_loop",
    "motion_rms": "in_loop_rms",
    "motion_share": "in_loop_share",
}  # other names of attributes of `Errors` in files


@dataclass(frozen=True, repr=False)
class Errors:
    """Errors of a model on some data; NaN if unknown.

    Attributes:
        torque_rms: RMS of measured minus modelled torque over windows, the paper's norm (10) [N m]; NaN for links
            of which some joints turn and others slide.
        position_rms: RMS of measured minus simulated position of free runs over segments [rad]; NaN with links, or if
            the inertia is unknown.
        torque_fit: 100 (1 - torque_rms / standard deviation of the torque) [%]; 0 is as good as a constant.
        position_fit: the same of the position in segments [%].
        joints: torque RMS of each joint by name [N m]; with controllers, `motion` of each [rad].
        shares: torque RMS of each joint over the RMS of its torque, None without a motor; or `motion_share` of each.
        motion: mean absolute position error of whole recordings, simulated from the reference of a controller [rad].
        motion_rms: RMS of the same [rad].
        motion_share: `motion` over the range of the measured positions; NaN if the joint moves by less than it.
    """

    torque_rms: float
    position_rms: float
    torque_fit: float = np.nan
    position_fit: float = np.nan
    joints: Mapping[str, float] = field(default_factory=dict)
    shares: Mapping[str, float | None] = field(default_factory=dict)
    motion: float = np.nan
    motion_rms: float = np.nan
    motion_share: float = np.nan

    def __repr__(self) -> str:
        errors = [f"{name}={value:.4g}" for name, value in self._totals.items()]
        errors += [f"{joint}={error:.4g}" for joint, error in self.joints.items() if joint]
        return f"<Errors: {', '.join(errors)}>"

    def with_motion_errors(self, error: Array, measured: Array) -> Errors:
        """Return the errors with those of simulated positions (R,) [rad], given the measured ones (R,) [rad]."""
        mean, rms, span = float(np.mean(np.abs(error))), float(np.sqrt(np.mean(error**2))), float(np.ptp(measured))
        return replace(self, motion=mean, motion_rms=rms, motion_share=mean / span if span > mean else np.nan)

    @property
    def is_of_motion(self) -> bool:
        """Return whether the errors include those of motion simulated with a controller."""
        return bool(np.isfinite(self.motion))

    @property
    def motion_errors(self) -> tuple[float, ...]:
        """Return mean and RMS of the error of motion [rad]; empty without a controller."""
        return (self.motion, self.motion_rms) if self.is_of_motion else ()

    @property
    def kinds(self) -> dict[str, str]:
        """Names of the errors that decide on a model, as in files, that of joints first, with their units."""
        if self.is_of_motion:
            return {FILE_NAMES["motion"]: "rad"}
        return {"torque_rms": "N m"} | ({"position_rms": "rad"} if np.isfinite(self.position_rms) else {})

    @property
    def unit(self) -> str:
        """Unit of the first of the `kinds`."""
        return next(iter(self.kinds.values()))

    @property
    def total(self) -> float:
        """Error of the first of the `kinds`, of all joints."""
        return self.get_error(next(iter(self.kinds)))

    def get_error(self, kind: str) -> float:
        """Return the error of one of the `kinds`; NaN if unknown."""
        attributes = {name: attribute for attribute, name in FILE_NAMES.items()}
        return float(getattr(self, attributes.get(kind, kind)))

    def get_joint_error(self, joint: str) -> float:
        """Return the torque error at a joint [N m]; without joints, the error of motion [rad]."""
        return get_error_at(self.joints, joint, self.total)

    def get_share(self, joint: str) -> float | None:
        """Return the error at a joint over the RMS of its torque, or over the range of its motion; None if unknown."""
        share = self.shares.get(joint, self.motion_share)
        return None if share is None else get_finite(share)

    @property
    def _totals(self) -> dict[str, float]:
        """Return the known errors of all joints together, by name in files."""
        errors = {FILE_NAMES.get(name, name): size for name, size in vars(self).items()}
        return {name: size for name, size in errors.items() if isinstance(size, float) and np.isfinite(size)}

    def json(self) -> JSON:
        """Return a dictionary for JSON, without unknown errors."""
        kind = next(iter(self.kinds))
        joints = {at: {kind: size, "share": self.get_share(at)} for at, size in self.joints.items()}
        return {**self._totals, "joints": joints}


def join_errors(errors: Mapping[str, Errors]) -> Errors:
    """Join the errors of joints in the loop: mean of their mean errors, RMS of their RMS errors."""
    motion = {at: one.motion for at, one in errors.items()}
    rms = float(np.sqrt(np.mean([one.motion_rms**2 for one in errors.values()])))
    shares = {at: one.motion_share for at, one in errors.items()}
    return Errors(
        np.nan, np.nan, joints=motion, shares=shares, motion=float(np.mean([*motion.values()])), motion_rms=rms
    )


def get_error_at(joints: Mapping[str, float], at: str, otherwise: float) -> float:
    """Return the RMS of the errors of joints, by name, over those that a term at `at` loads; else `otherwise`."""
    of_term = [joints[joint] for joint in list_loads(at) if joint in joints]
    return float(np.sqrt(np.mean(np.square(of_term)))) if of_term else otherwise


def get_single(floors: Mapping[str, float]) -> float:
    """Return the only noise floor [N m]; NaN for several joints."""
    return next(iter(floors.values())) if len(floors) == 1 else np.nan


def encode_estimates(model: Model) -> JSON:
    """Return the estimates of a model by name as a dictionary for JSON; an undetermined value is null."""
    known = {name: estimate.json() for name, estimate in model.estimates.items()}
    return {
        name: entry | {"value": None, "std": None} if model.estimates[name].is_unknown else entry
        for name, entry in known.items()
    }


@dataclass(frozen=True, repr=False)
class Step:
    """Model on the path from the base model.

    Attributes:
        added: id of the added effect; None for the base model.
        model: refitted model.
        errors: errors of the model on `train` and `holdout`.
    """

    added: str | None
    model: Model
    errors: Mapping[str, Errors]

    def with_log_format(self, log_format: JSON) -> Step:
        """Return the step with a model that has a log format."""
        return replace(self, model=replace(self.model, log_format=log_format))

    def compute_noise_ratio(self, floors: Mapping[str, float]) -> float:
        """Return the held-out error over the noise floor of a joint, the largest of all joints."""
        errors = self.errors["holdout"]
        return max((errors.get_joint_error(at) / max(floor, 1e-300) for at, floor in floors.items()), default=0.0)

    def mark_bias(self, floors: Mapping[str, float], misfit_ratio: float) -> Model:
        """Return the model, its estimates marked as biased if a torque error is above `misfit_ratio` noise floors."""
        is_misfit = self.compute_noise_ratio(floors) > misfit_ratio and not self.errors["holdout"].is_of_motion
        return self.model.mark_biased() if is_misfit else self.model

    def __repr__(self) -> str:
        added = "base model" if self.added is None else f"with {self.added}"
        return f"<Step: {added}, held out {self.errors['holdout']!r}>"

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "added": self.added,
            "theta": encode_estimates(self.model),
            "errors": {part: errors.json() for part, errors in self.errors.items()},
        }


@dataclass(frozen=True)
class ErrorFall(Finding):
    """Held-out errors that an effect lowers.

    Attributes:
        changes: errors before and after, by kind; empty with links.
        joint: name of the joint; empty for a pendulum.
        ratio: torque error of that joint after over before; None for a pendulum.
    """

    changes: Mapping[str, Change] = field(default_factory=dict)
    joint: str = ""
    ratio: float | None = None


def compute_error_fall(before: Step, after: Step) -> ErrorFall:
    """Return a finding with the held-out errors before and after a step."""
    old, new = before.errors["holdout"], after.errors["holdout"]
    units = {kind: after.model.units().unit(unit) for kind, unit in (old.kinds | new.kinds).items()}
    return ErrorFall(
        {
            kind: Change(Quantity(old.get_error(kind), unit=unit), Quantity(new.get_error(kind), unit=unit))
            for kind, unit in units.items()
        }
    )
