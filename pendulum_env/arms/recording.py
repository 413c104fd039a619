"""Recordings of an arm: one recording of a pendulum a joint, all on one clock."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.lookup import find
from pendulum_env.reading import LARGEST
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.columns import UNUSED, named_column
from pendulum_env.recording.preview import Preview, preview
from pendulum_env.recording.record import NEWTON_METRE, ColumnError
from pendulum_env.recording.storage import segment_numbers, write_columns
from pendulum_env.recording.study import Source

QUANTITIES = ("position", "torque")


@dataclass(frozen=True, eq=False, repr=False)
class ArmRecording:
    """N samples of n joints; a joint alone is a `Recording`, with the same meaning of a held torque.

    Joints that slide have positions in m and forces in N where others have rad and N m.

    Attributes:
        name: of the recording.
        names: of the joints that move.
        joints: what was recorded of them.
        still: positions (M,) of joints that do not move, of those that have a column, as rows of the file have them.

    Raises:
        RecordingError: if the joints' time differs.
    """

    name: str
    names: tuple[str, ...]
    joints: tuple[Recording, ...]
    still: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        first = self.joints[0]
        for name, joint in zip(self.names, self.joints, strict=True):
            same = len(joint) == len(first) and joint.starts == first.starts
            if not (same and np.allclose(joint.time, first.time, rtol=0, atol=0.1 / first.rate)):
                raise RecordingError(
                    f"{self.name}: joint '{name}' has other instants than joint '{self.names[0]}': "
                    "sample all joints at once"
                )

    @classmethod
    def of(cls, name: str, names: Sequence[str], time: Array, position: Array, torque: Array) -> ArmRecording:
        """From time (N,) [s], positions (N, n) [rad] and held torques (N, n) [N m].

        Raises:
            RecordingError: if a shape is wrong, or as `Recording` does.
        """
        for what, values in (("position", position), ("torque", torque)):
            if np.shape(values) != (len(time), len(names)):
                raise RecordingError(
                    f"{name}: {what} has shape {np.shape(values)}, {len(names)} joints and {len(time)} samples need "
                    f"({len(time)}, {len(names)})"
                )
        pairs = zip(names, np.transpose(position), np.transpose(torque), strict=True)
        return cls(name, tuple(names), tuple(Recording(f"{name} {joint}", time, q, u) for joint, q, u in pairs))

    def __len__(self) -> int:
        return len(self.joints[0])

    def __repr__(self) -> str:
        return f"<ArmRecording {self.name!r}: {self.summary}>"

    @property
    def summary(self) -> str:
        """Length, rate, number of samples and joints."""
        return f"{self.joints[0].summary}, {len(self.joints)} joint{'s' * (len(self.joints) > 1)}"

    @property
    def time(self) -> Array:
        """(N,) [s]."""
        return self.joints[0].time

    @property
    def position(self) -> Array:
        """(N, n) [rad]."""
        return np.column_stack([joint.position for joint in self.joints])

    @property
    def torque(self) -> Array:
        """(N, n) [N m]."""
        return np.column_stack([joint.torque for joint in self.joints])

    @property
    def segments(self) -> tuple[ArmRecording, ...]:
        """The recording cut at its gaps."""
        every = zip(*(joint.segments for joint in self.joints), strict=True)
        return tuple(replace(self, joints=joints) for joints in every)

    def slice(self, start: int | None, stop: int | None) -> ArmRecording:
        """Samples start to stop - 1; raises RecordingError as `Recording.slice` does."""
        return replace(self, joints=tuple(joint.slice(start, stop) for joint in self.joints))

    def split(self, fraction: float) -> tuple[ArmRecording, ArmRecording]:
        """The first `fraction` of the samples, and the rest; raises RecordingError as `Recording.split` does."""
        first, rest = zip(*(joint.split(fraction) for joint in self.joints), strict=True)
        return replace(self, joints=first), replace(self, joints=rest)


def read_arm_recording(
    path: str | os.PathLike[str],
    joints: Sequence[str],
    *,
    held: Collection[str] = (),
    unwrap: bool = False,
    columns: Mapping[str, str] | None = None,
    largest: float = LARGEST,
) -> ArmRecording:
    """Read a file with columns time, and for each joint `position_<joint>` and `torque_<joint>`.

    Instead of the joints' names, columns may bear numbers, as many as there are joints: `position_1`, ...

    Args:
        path: in any format that `read_recording` reads.
        joints: names, in the robot's order.
        held: names of joints that do not move; columns of their positions tell where they are.
        unwrap: undo jumps of 2 pi in positions.
        columns: columns by `time`, `position_<joint>` or `torque_<joint>` where their names do not tell, with unit and
            gain as for one joint: `{"torque_elbow": "i_2:A*0.4"}`.
        largest: bytes, as of `read_recording`.

    Raises:
        RecordingError: as `read_recording`, and if columns of joints are missing, or are of other joints.
    """
    look = preview(path, largest)
    told = _told(path, look.headers, joints, held, dict(columns or {}))
    single = []
    for joint in joints:
        own = {quantity: told[f"{quantity}_{joint}"] for quantity in QUANTITIES}
        own |= {"time": told["time"]} if "time" in told else {}
        unused = {"velocity": UNUSED, "reference": UNUSED}
        try:
            read = read_recording(path, unwrap=unwrap, columns=own | unused, largest=largest)
            single.append(replace(read, notes=tuple(_of_joint(joint, note) for note in read.notes)))
        except RecordingError as error:
            text = _of_joint(joint, str(error).removeprefix(f"{path}: "))
            raise RecordingError(f"{path}: joint '{joint}': {text}") from None
        if single[-1].torque_unit != NEWTON_METRE:
            raise RecordingError(
                f"{path}: joint '{joint}': torque is in {single[-1].torque_unit}, and no known load tells the gain of "
                f"an arm: give it, --columns torque_{joint}=NAME:{single[-1].torque_unit}*0.4, for one"
            )
    name = single[0].name
    columns_of = {joint: told.get(f"position_{joint}", UNUSED) for joint in held}
    still = {joint: _still(path, look, column) for joint, column in columns_of.items() if column != UNUSED}
    return ArmRecording(name, tuple(joints), tuple(replace(own, name=name) for own in single), still)


def _still(path: str | os.PathLike[str], look: Preview, text: str) -> Array:
    """Positions (M,) of a joint that is held, as a column has them."""
    try:
        column = named_column("position", text, look.headers)
    except ColumnError as error:
        raise ColumnError(f"{path}: {error}") from None
    values = look.values[column.index]
    if values is None or not np.isfinite(values).any():
        raise ColumnError(f"{path}: column {column.header!r} has no numbers: say --columns position_JOINT={UNUSED}")
    return np.asarray(column.scale * values[np.isfinite(values)] + column.offset)


def _of_joint(joint: str, text: str) -> str:
    """What is said of columns of one joint, ready to paste."""
    text = re.sub(",(velocity|reference)=unused", "", text)
    return re.sub("(?<=[ ',])(position|torque)=", lambda found: f"{found[1]}_{joint}=", text)


def read_arm_source(source: Source, joints: Sequence[str], held: Collection[str] = ()) -> ArmRecording:
    """Read a recording of an arm as a study asks for.

    Raises:
        RecordingError: as `read_arm_recording`, if there is too little within the range, or if a load is told: an arm
            carries it in its links' parameters.
    """
    if source.load is not None:
        raise RecordingError(f"{source.file}: a load is of one joint: leave it out, an arm's last link carries it")
    return source.within_range(_of_arm, tuple(joints), tuple(held))


def _of_arm(source: Source, joints: Sequence[str], held: Collection[str]) -> ArmRecording:
    return read_arm_recording(
        source.file, joints, held=held, unwrap=source.unwrap, columns=source.columns, largest=source.largest
    )


def _told(
    path: str | os.PathLike[str],
    headers: Sequence[str],
    joints: Sequence[str],
    held: Collection[str],
    given: dict[str, str],
) -> dict[str, str]:
    """The column of `position_<joint>` and `torque_<joint>` of every joint, as the user or its name tells."""
    wanted = [f"{quantity}_{joint}" for quantity in QUANTITIES for joint in (*joints, *held)]
    for name in given:
        try:
            find("column of the arm", name, dict.fromkeys(["time", *wanted]))
        except ValueError as error:
            raise ColumnError(f"{path}: {error}") from None
    plain = {re.split(r"[\[(]", header)[0].strip(): header for header in headers}  # without units
    found = {name: plain[name] for name in wanted if name in plain} | given
    for quantity in QUANTITIES:
        numbered = sorted(
            (header for header in plain if re.fullmatch(rf"{quantity}_?\d+", header)),
            key=lambda header: int(re.sub(r"\D", "", header)),
        )
        missing = [joint for joint in joints if f"{quantity}_{joint}" not in found]
        if len(missing) == len(joints) == len(numbered):
            found |= {f"{quantity}_{joint}": plain[name] for joint, name in zip(joints, numbered, strict=True)}
        elif missing:
            raise RecordingError(
                f"{path}: {len(joints)} joints need as many columns of {quantity}, there is none for "
                f"{', '.join(missing)}: name them {quantity}_{missing[0]} and so on, say which with --columns, or hold "
                "joints by naming those that move, --joints A,B,C (joints=)"
            )
        for header in plain:
            if header.startswith(f"{quantity}_") and header not in wanted and plain[header] not in found.values():
                raise RecordingError(
                    f"{path}: column '{header}' is of no joint of the robot, which has {', '.join((*joints, *held))}"
                )
    return found


def write_arm_recording(recording: ArmRecording, path: str | os.PathLike[str]) -> None:
    """Write columns time, `position_<joint>` and `torque_<joint>`, as `write_recording` does.

    Raises:
        RecordingError: if the ending is unknown or the file cannot be written.
    """
    columns = {"time": recording.time}
    for quantity in QUANTITIES:
        pairs = zip(recording.names, recording.joints, strict=True)
        columns |= {f"{quantity}_{name}": getattr(joint, quantity) for name, joint in pairs}
    if len(recording.joints[0].starts) > 1:
        columns["segment"] = segment_numbers(recording.joints[0])
    write_columns(columns, path)
