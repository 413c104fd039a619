"""Names of joints in columns, notes and errors."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import NONE
from pendulum_env.recording.notes import Note, NoteKind

OF_JOINTS = ("position", "torque", "temperature", "reference")  # quantities with a column for each joint


def note_joint(joint: str, note: Note) -> Note:
    """Return a note on one joint with the column names of a file of several."""
    quantities = (f"{quantity}_{joint}" if quantity in OF_JOINTS else quantity for quantity in note.quantities)
    columns_of_joint = {q: text for q, text in note.columns.items() if text != NONE}
    columns = {f"{q}_{joint}" if q in OF_JOINTS else q: text for q, text in columns_of_joint.items()}
    text = name_joint(joint, note.text) if note.kind is NoteKind.IMPLAUSIBLE else note.text
    return replace(note, quantities=tuple(quantities), columns=columns, text=text)


def name_joint(joint: str, text: str) -> str:
    """Add the joint to the column names in a text."""
    text = re.sub(",(velocity|reference|torque)=none|, '(velocity|reference|torque)': 'none'", "", text)
    text = re.sub(f"^({'|'.join(OF_JOINTS)}) is", lambda match: f"{match[1]}_{joint} is", text)
    return re.sub(f"(?<=[ ',])({'|'.join(OF_JOINTS)})(=|': )", lambda match: f"{match[1]}_{joint}{match[2]}", text)


@contextmanager
def name_errors(joint: str) -> Iterator[None]:
    """Add the joint to recording errors within a block; an empty name leaves them as they are."""
    try:
        yield
    except RecordingError as error:
        if not joint:
            raise
        raise type(error)(f"joint '{joint}': {name_joint(joint, str(error))}") from error.__cause__
