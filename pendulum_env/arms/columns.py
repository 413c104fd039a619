"""Column names of the joints of an arm, in files and in messages."""

import re
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.errors import ColumnError
from pendulum_env.lookup import find
from pendulum_env.recording.columns import NONE, add_si_unit, find_labelled_columns, parse_column, strip_units
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.preview import Preview
from pendulum_env.recording.vocabulary import find_label
from pendulum_env.settings import Blank, format_setting

QUANTITIES = ("position", "torque")
OF_JOINTS = (*QUANTITIES, "temperature")  # temperature is optional


def find_joint_columns(
    label: str, headers: Sequence[str], joints: Sequence[str], held: Collection[str], given: dict[str, str]
) -> dict[str, str]:
    """Find the columns of all joints by quantity, `position_<joint>`; columns `given` by the user take precedence."""
    wanted = [f"{quantity}_{joint}" for quantity in OF_JOINTS for joint in (*joints, *held)]
    for name in given:
        try:
            find("column of the arm", name, dict.fromkeys(["time", *wanted]))
        except ValueError as error:
            raise ColumnError(f"{label}: {error}") from None
    plain, found = strip_units(headers), match_joints(headers, (*joints, *held)) | given
    for quantity in OF_JOINTS:
        labelled = find_labelled_columns(quantity, headers)
        numbered = sorted((int(*label), text) for label, text in labelled.items() if "".join(label).isdecimal())
        missing = [joint for joint in joints if f"{quantity}_{joint}" not in found]
        if len(missing) == len(joints) == len(numbered):
            found |= {f"{quantity}_{joint}": text for joint, (_, text) in zip(joints, numbered, strict=True)}
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


def match_joints(headers: Sequence[str], joints: Sequence[str]) -> dict[str, str]:
    """Find the columns of joints by quantity, `position_<joint>`, of this name or labelled: `q_elbow`, `elbow/tau`."""
    plain, found = strip_units(headers), dict[str, str]()
    for quantity in OF_JOINTS:
        exact = {name: plain[name] for joint in joints if (name := f"{quantity}_{joint}") in plain}
        found |= {name: add_si_unit(quantity, header) if header == name else header for name, header in exact.items()}
        labelled = find_labelled_columns(quantity, [header for header in headers if header not in exact.values()])
        by_label = {f"{quantity}_{joint}": labelled.get(find_label(joint)) for joint in joints}
        found |= {name: text for name, text in by_label.items() if text is not None and name not in exact}
    return found


def read_held_position(label: str, look: Preview, text: str) -> Array:
    """Read the finite positions (M,) [rad] or [m] of a held joint."""
    try:
        column = parse_column("position", text, look.headers)
    except ColumnError as error:
        raise ColumnError(f"{label}: {error}") from None
    values = look.values[column.index]
    if values is None or not np.isfinite(values).any():
        option = format_setting("columns", {"position_JOINT": NONE})
        raise ColumnError(f"{label}: column {column.header!r} has no numbers: leave it out, {option}")
    return np.asarray(column.scale * values[np.isfinite(values)] + column.offset)


def note_joint(joint: str, note: Note) -> Note:
    """Return a note on one joint with the column names of the arm's file."""
    quantities = (f"{quantity}_{joint}" if quantity in OF_JOINTS else quantity for quantity in note.quantities)
    named = {q: text for q, text in note.columns.items() if text != NONE}
    columns = {f"{q}_{joint}" if q in OF_JOINTS else q: text for q, text in named.items()}
    text = name_joint(joint, note.text) if note.kind is NoteKind.IMPLAUSIBLE else note.text
    return replace(note, quantities=tuple(quantities), columns=columns, text=text)


def name_joint(joint: str, text: str) -> str:
    """Add the joint to the column names in a text."""
    text = re.sub(",(velocity|reference)=none|, '(velocity|reference)': 'none'", "", text)
    text = re.sub(f"^({'|'.join(OF_JOINTS)}) is", lambda found: f"{found[1]}_{joint} is", text)
    return re.sub(f"(?<=[ ',])({'|'.join(OF_JOINTS)})(=|': )", lambda found: f"{found[1]}_{joint}{found[2]}", text)
