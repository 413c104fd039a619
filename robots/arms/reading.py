"""Read recordings of an arm, joint by joint."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pendulum_env._typing import JSON
from pendulum_env.errors import ColumnError
from pendulum_env.lookup import find
from pendulum_env.physics.term import ROOM
from pendulum_env.recording import Recording, RecordingError
from pendulum_env.recording.actuator import Actuator, name_joint_errors
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.recording.columns import NONE, check_columns_option, parse_column
from pendulum_env.recording.formats import Readable, get_label
from pendulum_env.recording.joint_names import OF_JOINTS, name_errors, note_joint
from pendulum_env.recording.logged import read_logged
from pendulum_env.recording.notes import warn_of_notes
from pendulum_env.recording.preview import Preview, read_preview
from pendulum_env.recording.storage import describe_reading, read_joint_rows
from pendulum_env.recording.study import Source
from pendulum_env.settings import format_setting
from robots.arms.body import Body
from robots.arms.columns import (
    OF_DRIVES,
    QUANTITIES,
    find_joint_columns,
    match_joints,
    read_held_position,
)
from robots.arms.recording import ArmRecording

HELD_RANGE = 0.01  # [rad] or [m], largest range of a held joint


def read_arm_recording(
    source: Readable,
    joints: Sequence[str],
    *,
    held: Collection[str] = (),
    unwrap: bool = False,
    columns: Mapping[str, str] | None = None,
    name: str | None = None,
) -> ArmRecording:
    """Read a file or table with columns `time` and, per joint, `position_<joint>` and `torque_<joint>`.

    Other spellings are found with the joint's name, `q_elbow` or `elbow/effort`, or with numbers, `position_1`, ...
    Columns `temperature_<joint>` [deg C] are optional; joints without one get 25 deg C.

    Args:
        source: file or table in memory, as for `read_recording`.
        joints: names of the joints, in the robot's order.
        held: names of fixed joints; their columns of position are read if present.
        unwrap: undo jumps of a turn in positions.
        columns: columns by quantity, `time`, `position_<joint>` or `torque_<joint>`, with unit and gain as for one
            joint: `{"torque_elbow": "i_2:A*0.4"}`.
        name: name of the recording; by default that of the file, or `recording`.

    Raises:
        RecordingError: as `read_recording`, and if columns are missing, belong to other joints, or are currents without
            a torque constant.
    """
    recording = read_joints(source, joints, held, unwrap, columns, name)
    warn_of_notes(get_label(source, name), recording.notes)
    return recording


def read_joints(
    source: Readable,
    joints: Sequence[str],
    held: Collection[str],
    unwrap: bool,
    columns: Mapping[str, str] | None,
    name: str | None = None,
    drive: Actuator | None = None,
) -> ArmRecording:
    """Read a recording as `read_arm_recording`, without warnings; torque is that of a drive, if given."""
    check_columns_option(columns)
    preview = read_preview(source, max_columns=500)  # columns, enough for 64 joints with further signals
    needed = QUANTITIES if drive is None else OF_DRIVES
    named_columns = find_joint_columns(get_label(source), preview.headers, joints, held, dict(columns or {}), needed)
    check_drives(drive, joints)
    if drive is not None:
        named_columns = {
            id: text for id, text in named_columns.items() if not id.startswith("torque_") or id in (columns or {})
        }
    log_format = describe_reading(columns or {}, unwrap, drive)
    recordings = _read_each(source, preview, joints, named_columns, unwrap, log_format, drive)
    _refuse_shared_columns(get_label(source), joints, recordings)
    first = recordings[0]
    measured = [recording.temperature for recording in recordings]
    filled = np.column_stack([np.full(len(first), ROOM) if values is None else values for values in measured])
    notes = [note_joint(joint, note) for joint, part in zip(joints, recordings, strict=True) for note in part.notes]
    columns_of = {joint: named_columns.get(f"position_{joint}", NONE) for joint in held}
    driven: dict[str, Any] = {}
    if drive is not None:
        goals = [recording.reference for recording in recordings if recording.reference is not None]
        driven = {"reference": np.column_stack(goals), "drives": tuple(map(drive.select_joint, joints))}
    return ArmRecording(
        first.time,
        np.column_stack([recording.position for recording in recordings]),
        np.column_stack([recording.torque for recording in recordings]),
        name=name or first.name,
        notes=tuple(note for k, note in enumerate(notes) if note not in notes[:k]),
        temperature=None if all(temperature is None for temperature in measured) else filled,
        starts=first.starts,
        start_date=first.start_date,
        clock_start=first.clock_start,
        log_format=first.log_format,
        names=tuple(joints),
        still={
            joint: read_held_position(get_label(source), preview, column)
            for joint, column in columns_of.items()
            if column != NONE
        },
        origins=tuple(
            replace(recording.origin, named_columns=dict(columns or {}))
            for recording in recordings
            if recording.origin is not None
        ),
        **driven,
    )


def check_drives(drive: Actuator | None, joints: Sequence[str]) -> None:
    """Refuse drives of unknown joints, or of some joints alone."""
    if drive is None:
        return
    for joint in drive.list_joints():
        find("joint of [drive]", joint, dict.fromkeys(joints))
    for joint in joints:
        with name_joint_errors(joint):
            drive.select_joint(joint)


@read_logged.register
def _read_logged(body: Body, source: Readable, log_format: Source, name: str | None = None) -> Recording:
    """Read a recording of an arm in a log format; raises as `read_arm_recording`."""
    held = [joint for joint in (*body.held, *body.links) if joint not in body.joints]
    columns = log_format.columns or None
    return read_arm_recording(source, body.joints, held=held, name=name, columns=columns, unwrap=log_format.unwrap)


def find_logged_joints(
    source: Readable, joints: Sequence[str], columns: Mapping[str, str] | None = None, quantity: str = "torque"
) -> tuple[str, ...]:
    """Find the joints with columns of a quantity in a file or table; all joints if columns have numbers.

    A joint without such a column is omitted if its position stays within `HELD_RANGE`.
    """
    preview = read_preview(source, max_columns=500)
    named_columns = {name: text for name, text in (columns or {}).items() if text.strip() != NONE}
    named_columns = match_joints(preview.headers, joints) | named_columns

    def is_logged(joint: str) -> bool:
        position = named_columns.get(f"position_{joint}")
        if f"{quantity}_{joint}" in named_columns or position is None:
            return f"{quantity}_{joint}" in named_columns
        return bool(np.ptp(read_held_position(joint, preview, position)) > HELD_RANGE)

    return tuple(filter(is_logged, joints)) or tuple(joints)


def _refuse_shared_columns(label: str, joints: Sequence[str], recordings: Sequence[Recording]) -> None:
    """Refuse a column that was read for two quantities or joints."""
    names: dict[str, str] = {}
    for joint, recording in zip(joints, recordings, strict=True):
        for quantity in QUANTITIES:
            if recording.origin is not None and (column := recording.origin.columns.get(quantity)) is not None:
                name = f"{quantity}_{joint}"
                if (other := names.setdefault(column.header, name)) != name:
                    raise ColumnError(
                        f"{label}: column '{column.header}' is given for {other} and for {name}: which is it?"
                    )


def _read_each(
    source: Readable,
    preview: Preview,
    joints: Sequence[str],
    texts: Mapping[str, str],
    unwrap: bool,
    log_format: JSON,
    drive: Actuator | None,
) -> list[Recording]:
    """Read the recording of each joint from the columns of all joints in `texts`."""
    label, unused = get_label(source), {"velocity": NONE}
    columns = dict[str, dict[str, str]]()
    for joint in joints:
        columns[joint] = {quantity: texts.get(f"{quantity}_{joint}", NONE) for quantity in OF_JOINTS} | unused
        columns[joint] |= {"time": texts["time"]} if "time" in texts else {}
        try:
            with name_errors(joint):
                if drive is not None and columns[joint]["torque"] == NONE:
                    del columns[joint]["torque"]
                    continue
                if drive is None:
                    columns[joint]["reference"] = NONE
                if columns[joint]["torque"] == NONE:
                    raise ColumnError("an arm needs the torque of every joint: name its column")
                parse_column("torque", columns[joint]["torque"], preview.headers, can_find_gain=False)
        except RecordingError as error:
            raise RecordingError(f"{label}: {error}") from None
    recordings = read_joint_rows(source, columns, log_format, unwrap=unwrap, controller=drive)
    for joint, recording in recordings.items():
        if drive is None and recording.torque_unit != NEWTON_METRE:
            option = format_setting("columns", {f"torque_{joint}": texts[f"torque_{joint}"].replace("*?", "*0.4")})
            raise ColumnError(f"{label}: joint '{joint}' has no torque constant: give it, as in {option}")
    return [*recordings.values()]


def read_arm_source(source: Source, joints: Sequence[str], held: Collection[str] = ()) -> ArmRecording:
    """Read the recording of an arm from a source of a study."""
    if source.load is not None:
        raise RecordingError(
            f"{source.file}: `load` is of one joint: leave it out; what an arm carries is identified as its payload"
        )
    recording = read_joints(source.file, joints, held, source.unwrap, source.columns, drive=source.drive)
    return source.select_range(recording)
