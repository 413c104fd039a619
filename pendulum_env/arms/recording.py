"""Recordings of an arm: as those of a pendulum, with one column per joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.arms.body import LinkLoad
from pendulum_env.arms.columns import OF_JOINTS
from pendulum_env.recording import Recording, RecordingError


@dataclass(frozen=True, eq=False, repr=False)
class ArmRecording(Recording):
    """N samples of n joints: a recording with positions and torques (N, n) [rad] and [N m].

    Joints that slide have positions in m and forces in N where others have rad and N m.

    Attributes:
        names: of the joints that move (n,).
        still: positions (M,) of joints that do not move, of those that have a column, as rows of the file have them.
        payload: known body that a link carries; its torque is no part of a model. None if nothing is known of one.

    Raises:
        RecordingError: as `Recording` does.
    """

    names: tuple[str, ...] = ()
    still: Mapping[str, Array] = field(default_factory=dict)
    payload: LinkLoad | None = None

    @classmethod
    def from_arrays(cls, name: str, names: Sequence[str], time: Array, position: Array, torque: Array) -> Self:
        """Create a recording of time (N,) [s], positions (N, n) [rad], torques (N, n) [N m]; raises as `Recording`."""
        return cls(time, position, torque, name=name, names=tuple(names))

    of = from_arrays  # its name in 1.0.0, kept for one release

    def __post_init__(self) -> None:
        if getattr(self, "torque", None) is None:
            raise RecordingError(f"recording {self.name!r} is of an arm, which needs the torque of every joint")
        super().__post_init__()

    def get_shape(self, quantity: str) -> tuple[int, ...]:
        """Return the shape of a quantity; quantities of joints have one column per joint."""
        return (*np.shape(self.time), len(self.names)) if quantity in OF_JOINTS else np.shape(self.time)

    @cached_property
    def joints(self) -> tuple[Recording, ...]:
        """Return each joint alone, with the same meaning of a held torque."""
        series: dict[str, Any] = {name: values for name in OF_JOINTS if (values := getattr(self, name)) is not None}
        of_each: list[dict[str, Any]] = [
            {name: np.ascontiguousarray(values[:, k]) for name, values in series.items()}
            for k in range(len(self.names))
        ]
        return tuple(
            Recording(self.time, name=self.name, starts=self.starts, is_checked=True, **quantities)
            for quantities in of_each
        )

    @property
    def is_free(self) -> bool:
        """Return False: the mass of links is not scaled by one inertia."""
        return False

    @property
    def columns(self) -> dict[str, Array]:
        """Return time, and `position_<joint>` and so on where recorded, (N,) each."""
        columns = {
            f"{what}_{at}": getattr(joint, what)
            for what in OF_JOINTS
            if getattr(self, what) is not None
            for at, joint in zip(self.names, self.joints, strict=True)
        }
        return {"time": self.time, **columns}

    @property
    def summary(self) -> str:
        """Return length, rate, number of samples and joints."""
        return f"{super().summary}, {len(self.names)} joint{'s' * (len(self.names) > 1)}"


def get_payload(recording: Recording) -> LinkLoad | None:
    """Return the known payload of a recording."""
    return recording.payload if isinstance(recording, ArmRecording) else None


def add_payload(recording: Recording, load: LinkLoad) -> Recording:
    """Return a recording of an arm with a known payload, in addition to one already known at the same link."""
    before = get_payload(recording)
    if before is not None:
        load = LinkLoad(load.joint, before.standard + load.standard)
    return replace(recording, payload=load)  # type: ignore[call-arg]
