"""Recordings of an arm, with one column per joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.mechanism import LinkLoad
from pendulum_env.recording import Recording, RecordingError
from pendulum_env.recording.actuator import Actuator
from pendulum_env.recording.joint_names import OF_JOINTS
from pendulum_env.recording.origin import Origin


@dataclass(frozen=True, eq=False, repr=False)
class ArmRecording(Recording):
    """Recording of n joints, with positions [rad] and torques [N m] of shape (N, n).

    Linear joints have positions in m and forces in N.

    Attributes:
        names: names of the moving joints (n,).
        still: positions (M,) of held joints by name, for those with a column.
        payload: known body on a link; its torque is subtracted before a fit. None without one.
        origins: columns of the file of each joint (n,), with those that the user named; empty if unknown.
        drives: actuator of each joint (n,), if each follows a column of `reference`; empty for logged torque.

    Raises:
        RecordingError: as `Recording` does.
    """

    names: tuple[str, ...] = ()
    still: Mapping[str, Array] = field(default_factory=dict)
    payload: LinkLoad | None = None
    origins: tuple[Origin, ...] = ()
    drives: tuple[Actuator, ...] = ()

    @classmethod
    def from_arrays(cls, name: str, names: Sequence[str], time: Array, position: Array, torque: Array) -> Self:
        """Make a recording of time (N,) [s], positions (N, n) [rad] and torques (N, n) [N m]; raises as `Recording`."""
        return cls(time, position, torque, name=name, names=tuple(names))

    of = from_arrays  # its name in 1.0.0, kept for one release

    def __post_init__(self) -> None:
        if getattr(self, "torque", None) is None:
            raise RecordingError(f"recording {self.name!r} is of an arm, which needs the torque of every joint")
        super().__post_init__()

    def get_shape(self, quantity: str) -> tuple[int, ...]:
        """Return the shape of a quantity: (N, n) for those of joints, else (N,)."""
        return (*np.shape(self.time), len(self.names)) if quantity in OF_JOINTS else np.shape(self.time)

    @cached_property
    def joints(self) -> tuple[Recording, ...]:
        """Return the recording of each joint."""
        series: dict[str, Any] = {name: values for name in OF_JOINTS if (values := getattr(self, name)) is not None}
        common: dict[str, Any] = {"name": self.name, "starts": self.starts, "is_checked": True}
        each = [{id: np.ascontiguousarray(x[:, k]) for id, x in series.items()} for k in range(len(self.names))]
        # the mechanism knows which joints slide, so that their units do not come from a file
        origins = [None if origin.is_prismatic else origin for origin in self.origins] or [None] * len(self.names)
        drives = self.drives or [None] * len(self.names)
        return tuple(
            Recording(
                self.time, origin=origin, drive=drive, torque_unit=drive.unit if drive else self.torque_unit,
                clock_start=self.clock_start, **common | columns
            )
            for origin, drive, columns in zip(origins, drives, each, strict=True)
        )  # fmt: skip

    @property
    def link_load(self) -> LinkLoad | None:
        """Return the known payload."""
        return self.payload

    @property
    def is_free(self) -> bool:
        """Return False: an arm has no free swings."""
        return False

    @property
    def columns(self) -> dict[str, Array]:
        """Return the recorded columns by name, `time`, `position_<joint>`, ..., (N,) each."""
        columns = {
            f"{quantity}_{at}": getattr(joint, quantity)
            for quantity in OF_JOINTS
            if getattr(self, quantity) is not None
            for at, joint in zip(self.names, self.joints, strict=True)
        }
        return {"time": self.time, **columns}

    @property
    def summary(self) -> str:
        """Return duration, rate, and numbers of samples and joints as text."""
        return f"{super().summary}, {len(self.names)} joint{'s' * (len(self.names) > 1)}"


def add_payload(recording: Recording, load: LinkLoad) -> Recording:
    """Return a recording of an arm with a known payload, added to a known one at the same link."""
    known = recording.link_load
    if known is not None:
        load = LinkLoad(load.joint, known.standard + load.standard)
    return replace(recording, payload=load)  # type: ignore[call-arg]
