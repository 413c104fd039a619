"""Recordings of an arm: as those of a pendulum, with one column per joint."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.arms.body import Body, LinkLoad
from pendulum_env.errors import ColumnError
from pendulum_env.lookup import find
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.physics.term import ROOM
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.recording.columns import NONE, check_named, parse_column
from pendulum_env.recording.formats import Readable, get_label
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.preview import Preview, read_preview
from pendulum_env.recording.storage import describe_reading
from pendulum_env.recording.study import Source
from pendulum_env.settings import Blank, format_setting

QUANTITIES = ("position", "torque")
OF_JOINTS = (*QUANTITIES, "temperature")  # the last where there are any
STILL = 0.01  # [rad] or [m], within which a joint is held


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
    def from_arrays(cls, name: str, names: Sequence[str], time: Array, position: Array, torque: Array) -> ArmRecording:
        """Create a recording of time (N,) [s], positions (N, n) [rad], torques (N, n) [N m]; raises as `Recording`."""
        return cls(time, position, torque, name=name, names=tuple(names))

    of = from_arrays  # its name in earlier releases, kept for one more

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
            {name: np.ascontiguousarray(own[:, k]) for name, own in series.items()} for k in range(len(self.names))
        ]
        return tuple(
            Recording(self.time, name=self.name, starts=self.starts, is_checked=True, **own) for own in of_each
        )

    @property
    def is_free(self) -> bool:
        """Return False: the mass of links is not scaled by one inertia."""
        return False

    @property
    def columns(self) -> dict[str, Array]:
        """Return time, and `position_<joint>` and so on where recorded, (N,) each."""
        own = {
            f"{what}_{at}": getattr(one, what)
            for what in OF_JOINTS
            if getattr(self, what) is not None
            for at, one in zip(self.names, self.joints, strict=True)
        }
        return {"time": self.time, **own}

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


def read_arm_recording(
    source: Readable,
    joints: Sequence[str],
    *,
    held: Collection[str] = (),
    unwrap: bool = False,
    columns: Mapping[str, str] | None = None,
    name: str | None = None,
) -> ArmRecording:
    """Read a file or table with columns time, and for each joint `position_<joint>` and `torque_<joint>`.

    Instead of the joints' names, columns may bear numbers, as many as there are joints: `position_1`, ... Columns
    `temperature_<joint>` [deg C] may be there, too; joints without one are taken to be at 25 deg C.

    Args:
        source: a file or a table in memory that `read_recording` reads.
        joints: names, in the robot's order.
        held: names of joints that do not move; columns of their positions tell where they are.
        unwrap: undo jumps of 2 pi in positions.
        columns: columns by `time`, `position_<joint>` or `torque_<joint>` where their names do not tell, with unit and
            gain as for one joint: `{"torque_elbow": "i_2:A*0.4"}`.
        name: of the recording; by default that of the file, or `recording`.

    Raises:
        RecordingError: as `read_recording`, and if columns of joints are missing, are of other joints, or are currents
            without a torque constant.
    """
    check_named(columns)
    look = read_preview(source, most=500)  # columns: four of 64 joints, and what else a robot logs
    named = _name_columns(get_label(source), look.headers, joints, held, dict(columns or {}))
    single = [_read_joint(source, look, joint, named, unwrap) for joint in joints]
    _refuse_twice(get_label(source), joints, single)
    _refuse_other_instants(joints, single)
    first = single[0]
    measured = [own.temperature for own in single]
    warm = np.column_stack([np.full(len(first), ROOM) if own is None else own for own in measured])
    notes = [_note_of_joint(joint, note) for joint, own in zip(joints, single, strict=True) for note in own.notes]
    columns_of = {joint: named.get(f"position_{joint}", NONE) for joint in held}
    return ArmRecording(
        first.time,
        np.column_stack([own.position for own in single]),
        np.column_stack([own.torque for own in single]),
        name=name or first.name,
        notes=tuple(note for k, note in enumerate(notes) if note not in notes[:k]),
        temperature=None if all(own is None for own in measured) else warm,
        starts=first.starts,
        start_date=first.start_date,
        log_format=describe_reading(columns or {}, unwrap),
        names=tuple(joints),
        still={
            joint: _read_held_position(get_label(source), look, column)
            for joint, column in columns_of.items()
            if column != NONE
        },
    )


def read_logged(body: Mechanism, source: Readable, format: Source, name: str | None = None) -> Recording:
    """Read a recording of a pendulum or of an arm in the format of a log; raises as the functions that read either."""
    if not isinstance(body, Body):
        return replace(read_recording(source, name=name, **format.reading), load=format.load)
    still = [joint for joint in (*body.held, *body.links) if joint not in body.joints]
    return read_arm_recording(
        source, body.joints, held=still, name=name, columns=format.columns or None, unwrap=format.unwrap
    )


def find_logged_joints(
    source: Readable, joints: Sequence[str], columns: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """Find the joints with columns in a file or table; all joints if columns bear numbers.

    A joint without a column of torque whose position stays within `STILL` is no such joint either.
    """
    look = read_preview(source, most=500)
    named = {name: text for name, text in (columns or {}).items() if text.strip() != NONE}
    named = strip_units(look.headers) | named

    def is_logged(joint: str) -> bool:
        position = named.get(f"position_{joint}")
        if f"torque_{joint}" in named or position is None:
            return f"torque_{joint}" in named
        return bool(np.ptp(_read_held_position(joint, look, position)) > STILL)

    return tuple(filter(is_logged, joints)) or tuple(joints)


def _refuse_other_instants(joints: Sequence[str], single: Sequence[Recording]) -> None:
    first = single[0]
    for joint, other in zip(joints, single, strict=True):
        same = len(other) == len(first) and other.starts == first.starts
        if not (same and np.allclose(other.time, first.time, rtol=0, atol=0.1 / first.rate)):
            raise RecordingError(
                f"{first.name}: joint '{joint}' has other instants than joint '{joints[0]}': sample all joints at "
                "once, and leave rows out in which one has no number"
            )


def _refuse_twice(label: str, joints: Sequence[str], single: Sequence[Recording]) -> None:
    """Refuse a column that two quantities of joints were read from."""
    taken: dict[str, str] = {}
    for joint, own in zip(joints, single, strict=True):
        for quantity in QUANTITIES:
            if own.origin is not None and (column := own.origin.columns.get(quantity)) is not None:
                name = f"{quantity}_{joint}"
                if (other := taken.setdefault(column.header, name)) != name:
                    raise ColumnError(
                        f"{label}: column '{column.header}' is given for {other} and for {name}: which is it?"
                    )


def _read_joint(source: Readable, look: Preview, joint: str, named: Mapping[str, str], unwrap: bool) -> Recording:
    """Read the columns of one joint, by the columns of quantities of all joints."""
    own = {quantity: named.get(f"{quantity}_{joint}", NONE) for quantity in OF_JOINTS}
    own |= {"time": named["time"]} if "time" in named else {}
    label = get_label(source)
    unused = {"velocity": NONE, "reference": NONE}
    try:
        if own["torque"] == NONE:
            raise ColumnError("an arm needs the torque of every joint: name its column")
        parse_column("torque", own["torque"], look.headers, can_find_gain=False)
        read = read_recording(source, unwrap=unwrap, columns=own | unused)
    except RecordingError as error:
        text = _replace_joint_names(joint, str(error).removeprefix(f"{label}: "))
        raise RecordingError(f"{label}: joint '{joint}': {text}") from None
    if read.torque_unit != NEWTON_METRE:
        columns = {f"torque_{joint}": own["torque"].replace("*?", "*0.4")}
        raise ColumnError(
            f"{label}: joint '{joint}' has no torque constant: give it, as in {format_setting('columns', columns)}"
        )
    return read


def _note_of_joint(joint: str, note: Note) -> Note:
    """Return a note on columns of one joint, by their names in the file."""
    quantities = (f"{own}_{joint}" if own in OF_JOINTS else own for own in note.quantities)
    named = {q: text for q, text in note.columns.items() if text != NONE}
    columns = {f"{q}_{joint}" if q in OF_JOINTS else q: text for q, text in named.items()}
    text = _replace_joint_names(joint, note.text) if note.kind is NoteKind.IMPLAUSIBLE else note.text
    return replace(note, quantities=tuple(quantities), columns=columns, text=text)


def _read_held_position(label: str, look: Preview, text: str) -> Array:
    """Read the positions (M,) of a joint that is held from its column."""
    try:
        column = parse_column("position", text, look.headers)
    except ColumnError as error:
        raise ColumnError(f"{label}: {error}") from None
    values = look.values[column.index]
    if values is None or not np.isfinite(values).any():
        option = format_setting("columns", {"position_JOINT": NONE})
        raise ColumnError(f"{label}: column {column.header!r} has no numbers: leave it out, {option}")
    return np.asarray(column.scale * values[np.isfinite(values)] + column.offset)


def _replace_joint_names(joint: str, text: str) -> str:
    """Write a text about columns of one joint, ready to paste."""
    text = re.sub(",(velocity|reference)=none|, '(velocity|reference)': 'none'", "", text)
    text = re.sub(f"^({'|'.join(OF_JOINTS)}) is", lambda found: f"{found[1]}_{joint} is", text)
    return re.sub(f"(?<=[ ',])({'|'.join(OF_JOINTS)})(=|': )", lambda found: f"{found[1]}_{joint}{found[2]}", text)


def read_arm_source(source: Source, joints: Sequence[str], held: Collection[str] = ()) -> ArmRecording:
    """Read a recording of an arm as a study asks for."""
    if source.load is not None:
        raise RecordingError(
            f"{source.file}: `load` is of one joint: leave it out; what an arm carries is identified as its payload"
        )
    read = read_arm_recording(source.file, joints, held=held, unwrap=source.unwrap, columns=source.columns)
    return source.select_range(read)


def _name_columns(
    label: str,
    headers: Sequence[str],
    joints: Sequence[str],
    held: Collection[str],
    given: dict[str, str],
) -> dict[str, str]:
    """Name the column of `position_<joint>` and `torque_<joint>` of every joint, from the user or from its name."""
    wanted = [f"{quantity}_{joint}" for quantity in OF_JOINTS for joint in (*joints, *held)]
    for name in given:
        try:
            find("column of the arm", name, dict.fromkeys(["time", *wanted]))
        except ValueError as error:
            raise ColumnError(f"{label}: {error}") from None
    plain = strip_units(headers)
    found = {name: plain[name] for name in wanted if name in plain} | given
    for quantity in OF_JOINTS:
        numbered = sorted(
            (header for header in plain if re.fullmatch(rf"{quantity}_?\d+", header)),
            key=lambda header: int(re.sub(r"\D", "", header)),
        )
        missing = [joint for joint in joints if f"{quantity}_{joint}" not in found]
        if len(missing) == len(joints) == len(numbered):
            found |= {f"{quantity}_{joint}": plain[name] for joint, name in zip(joints, numbered, strict=True)}
        elif missing and quantity in QUANTITIES:
            need = "joints need as many columns" if len(joints) > 1 else "joint needs a column"
            first = f"{quantity}_{missing[0]}"
            option = format_setting("columns", {first: "NAME:A*0.4" if quantity == "torque" else "NAME"})
            current = " (a current, by its torque constant)" if quantity == "torque" else ""
            raise ColumnError(
                f"{label}: {len(joints)} {need} of {quantity}, there is none for {', '.join(missing)} among "
                f"{', '.join([*plain][:12])}: name them {first} and so on, say which with "
                f"{option}{current}, or hold joints by naming those that move, "
                f"{format_setting('joints', Blank('A,B,C'))}"
            )
        for header in plain:
            if header.startswith(f"{quantity}_") and header not in wanted and plain[header] not in found.values():
                raise ColumnError(
                    f"{label}: column '{header}' is of no joint of the robot, which has {', '.join((*joints, *held))}"
                )
    return found


def strip_units(headers: Sequence[str]) -> dict[str, str]:
    """Strip the units from headers: `position_lift` of `position_lift [mm]`."""
    return {re.split(r"[\[(]", header)[0].strip(): header for header in headers}
