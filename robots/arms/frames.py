"""Joints of an arm whose columns have another sign or zero than the robot file, and the columns that correct them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from estimators.checks.remedies import WrongColumn, group_remedies
from estimators.data.regression_data import RegressionData
from estimators.findings import Quantity
from estimators.regression.least_squares import IdentificationError
from estimators.weak_form.links import choose_common_width
from estimators.weak_form.resolution import RESOLUTION
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.recording import Recording
from pendulum_env.recording.origin import Origin
from robots.arms.body import find_body
from robots.arms.recording import ArmRecording


@dataclass(frozen=True)
class FrameSettings:
    """Search for the zero of a joint."""

    zeros: tuple[float, ...] = (-90.0, -45.0, -5.0, 5.0, 45.0, 90.0, 180.0)  # tried first [degrees]
    reach: float = math.radians(45.0)  # of the search near the best of them [rad]
    precision: float = math.radians(0.02)  # of the likeliest zero [rad]
    multiple: float = math.radians(45.0)  # usual error of a zero [rad]
    same: float = math.radians(0.5)  # distance from a multiple below which the error is the multiple [rad]


FRAMES = FrameSettings()


@dataclass(frozen=True)
class Frame:
    """Correction of a joint.

    Attributes:
        joint: its name.
        angle: added to its position, after the change of sign [rad].
        is_opposite: whether its position and torque have the opposite sign.
    """

    joint: str
    angle: float = 0.0
    is_opposite: bool = False

    def correct(self, arm: ArmRecording) -> ArmRecording:
        """Return a recording with the sign and the zero of the joint corrected."""
        at, sign = arm.names.index(self.joint), -1.0 if self.is_opposite else 1.0
        position, torque = arm.position.copy(), arm.torque.copy()
        position[:, at], torque[:, at] = sign * position[:, at] + self.angle, sign * torque[:, at]
        return replace(arm, position=position, torque=torque)

    def correct_columns(self, origin: Origin) -> dict[str, str] | None:
        """Return the columns of a joint, by quantity, with this sign and zero; None if they cannot be written."""
        if not self.is_opposite:
            return origin.shift_zero(self.angle, digits=1)
        position, torque = origin.flip_sign("position"), origin.flip_sign("torque")
        return None if position is None or torque is None else position | {"torque": torque["torque"]}


def find_wrong_frame(recordings: Sequence[Recording], base: Sequence[Term]) -> WrongColumn | None:
    """Find the joint whose columns have another sign or zero than the robot file; None if no correction explains much.

    The base model of corrected recordings leaves less residual, the geometric mean over the joints. At one joint, it is
    at most the share `RESOLUTION.tilted`.
    """
    arms = [recording for recording in recordings if isinstance(recording, ArmRecording)]
    widths = [choose_common_width(arm.joints) for arm in arms]
    before = measure_residuals(arms, base, widths)
    if not np.isfinite(before).all():
        return None

    def measure(frame: Frame) -> Array:
        return measure_residuals([frame.correct(arm) for arm in arms], base, widths) - before

    falls = {frame: measure(frame) for frame in propose_frames(base)}
    best = min(falls, key=lambda frame: float(falls[frame].mean()))
    if not best.is_opposite:
        best = refine_zero(best, lambda frame: float(measure(frame).mean()))
    fall = falls[best] if best in falls else measure(best)
    if fall.mean() >= 0 or fall.min() > math.log(RESOLUTION.tilted):
        return None
    return WrongColumn(
        f"position_{best.joint}",
        group_remedies((arm.name, correct_options(arm, best)) for arm in arms),
        angle=None if best.is_opposite else Quantity(-best.angle, unit="rad"),
        has_bias=True,
        joint=best.joint,
    )


def propose_frames(base: Sequence[Term]) -> Iterator[Frame]:
    """Propose the opposite sign of each joint, and other zeros of all but the last, whose link may be turned."""
    body = find_body(base)
    for joint, is_prismatic in zip(body.joints, body.is_prismatic, strict=True):
        yield Frame(joint, is_opposite=True)
        for zero in () if is_prismatic or joint == body.joints[-1] else FRAMES.zeros:
            yield Frame(joint, math.radians(zero))


def measure_residuals(arms: Sequence[ArmRecording], base: Sequence[Term], half_widths: Sequence[float]) -> Array:
    """Return the logarithm of the RMS residual of the base model at each joint (n,); infinite without a fit.

    Windows have the half width [s] of each recording.
    """
    try:
        data = RegressionData.from_arm(arms, terms=base, half_widths=half_widths)
        residual = data.residual(base, data.maker.fit(base)[1])
    except IdentificationError:
        return np.full(len(find_body(base).joints), np.inf)
    return np.log([*data.layout.compute_joint_errors(residual).values()])


def refine_zero(frame: Frame, measure: Callable[[Frame], float]) -> Frame:
    """Return the frame with the zero near its own at which `measure` is least, or a multiple of the usual error."""
    near, options = (frame.angle - FRAMES.reach, frame.angle + FRAMES.reach), {"xatol": FRAMES.precision}
    found = scipy.optimize.minimize_scalar(
        lambda angle: measure(replace(frame, angle=float(angle))), bounds=near, method="bounded", options=options
    )
    usual = FRAMES.multiple * round(found.x / FRAMES.multiple)
    angle = usual if usual and abs(found.x - usual) < FRAMES.same else float(found.x)
    return replace(frame, angle=math.remainder(angle, 2 * math.pi))


def correct_options(arm: ArmRecording, frame: Frame) -> dict[str, str] | None:
    """Return the option `columns` that corrects a joint of a recording; None if its origin is unknown."""
    if not arm.origins:
        return None
    origin = arm.origins[arm.names.index(frame.joint)]
    changed = frame.correct_columns(replace(origin, named_columns={}))
    if changed is None:
        return None
    return {**origin.named_columns, **{f"{quantity}_{frame.joint}": text for quantity, text in changed.items()}}
