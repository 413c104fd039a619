"""Column names of the joints of an arm, in files and in messages."""

from collections.abc import Collection, Sequence

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.errors import ColumnError
from pendulum_env.lookup import find
from pendulum_env.recording.columns import NONE, add_si_unit, find_labelled_columns, parse_column, strip_units
from pendulum_env.recording.joint_names import OF_JOINTS
from pendulum_env.recording.preview import Preview
from pendulum_env.recording.vocabulary import find_label
from pendulum_env.settings import Blank, format_setting

QUANTITIES = ("position", "torque")  # others are optional
OF_DRIVES = ("position", "reference")  # the same with drives


def find_joint_columns(
    label: str,
    headers: Sequence[str],
    joints: Sequence[str],
    held: Collection[str],
    named_columns: dict[str, str],
    needed: Collection[str] = QUANTITIES,
) -> dict[str, str]:
    """Find the columns of all joints by quantity, `position_<joint>`; those that the user names take precedence.

    Each joint needs a column of each quantity in `needed`.
    """
    known_names = [f"{quantity}_{joint}" for quantity in OF_JOINTS for joint in (*joints, *held)]
    for name in named_columns:
        try:
            find("column of the arm", name, dict.fromkeys(["time", *known_names]))
        except ValueError as error:
            raise ColumnError(f"{label}: {error}") from None
    plain, columns = strip_units(headers), match_joints(headers, (*joints, *held)) | named_columns
    exact = {plain.get(name) for name in known_names}
    for quantity in OF_JOINTS:
        labelled = find_labelled_columns(quantity, [text for text in headers if text not in exact])
        numbered = [labelled[label] for label in sorted(filter(_is_number, labelled), key=lambda label: int(*label))]
        names = [f"{quantity}_{joint}" for joint in joints]
        missing = [joint for joint, name in zip(joints, names, strict=True) if name not in columns]
        is_named = any(name in named_columns or columns[name] not in numbered for name in names if name in columns)
        if missing and not is_named and len(names) == len(numbered):  # numbered in order, not by the joints
            columns = {name: text for name, text in columns.items() if name in named_columns or text not in numbered}
            columns |= dict(zip(names, numbered, strict=True))
        elif missing and quantity in needed:
            reason = "joints need as many columns" if len(joints) > 1 else "joint needs a column"
            example = f"{quantity}_{missing[0]}"
            spelling = f"goal_{missing[0]}" if quantity == "reference" else example
            option = format_setting("columns", {example: "NAME:A*0.4" if quantity == "torque" else "NAME"})
            current = " (a current, by its torque constant)" if quantity == "torque" else ""
            raise ColumnError(
                f"{label}: {len(joints)} {reason} of {quantity}, there is none for {', '.join(missing)} among "
                f"{', '.join([*plain][:12])}: name them {spelling} and so on, say which with "
                f"{option}{current}, or hold joints by naming those that move, "
                f"{format_setting('joints', Blank('A,B,C'))}"
            )
        for header in plain:
            is_unused = header not in known_names and plain[header] not in columns.values()
            if header.startswith(f"{quantity}_") and is_unused:
                raise ColumnError(
                    f"{label}: column '{header}' is of no joint of the robot, which has {', '.join((*joints, *held))}"
                )
    return columns


def match_joints(headers: Sequence[str], joints: Sequence[str]) -> dict[str, str]:
    """Find the columns of joints by quantity, `position_<joint>`, of this name or labelled: `q_elbow`, `elbow/tau`.

    Columns with numbers alone, `q_1`, are those of `joint_1` and so on if all are of joints, or all joints have one.
    """
    plain, columns_of_joints = strip_units(headers), dict[str, str]()
    exact = {plain.get(f"{quantity}_{joint}") for quantity in OF_JOINTS for joint in joints}
    remaining = [header for header in headers if header not in exact]
    labelled = {quantity: find_labelled_columns(quantity, remaining) for quantity in OF_JOINTS}
    numbers = {label for columns in labelled.values() for label in columns if _is_number(label)}
    labels = {joint: find_label(joint) for joint in joints}
    ignored = set() if numbers <= {*labels.values()} or numbers >= {*labels.values()} else numbers
    for quantity in OF_JOINTS:
        for joint, joint_label in labels.items():
            name, other_name = f"{quantity}_{joint}", f"goal_{joint}" if quantity == "reference" else ""
            if header := plain.get(name) or plain.get(other_name):
                columns_of_joints[name] = add_si_unit(quantity, header) if header in (name, other_name) else header
            elif joint_label in labelled[quantity] and joint_label not in ignored:
                columns_of_joints[name] = labelled[quantity][joint_label]
    return columns_of_joints


def _is_number(label: Collection[str]) -> bool:
    return len(label) == 1 and "".join(label).isdecimal()


def read_held_position(label: str, preview: Preview, text: str) -> Array:
    """Read the finite positions (M,) [rad] or [m] of a held joint."""
    try:
        column = parse_column("position", text, preview.headers)
    except ColumnError as error:
        raise ColumnError(f"{label}: {error}") from None
    values = preview.values[column.index]
    if values is None or not np.isfinite(values).any():
        option = format_setting("columns", {"position_JOINT": NONE})
        raise ColumnError(f"{label}: column {column.header!r} has no numbers: leave it out, {option}")
    return np.asarray(column.scale * values[np.isfinite(values)] + column.offset)
