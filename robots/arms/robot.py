"""Read robots from URDF or MJCF, with moving, held and mimic joints.

Held joints are removed, and their links merged with the previous ones. Mimic joints, such as those of a gripper, keep
their links: with independent joints at q, the joints of all links are at R q + r.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pendulum_env._typing import JSON
from pendulum_env.errors import UserError, shorten_error
from pendulum_env.lookup import find
from pendulum_env.reading import MAX_NUMBER, check_size, quote_value
from pendulum_env.settings import Blank, format_setting

REVOLUTE, PRISMATIC = "Revolute", "Prismatic"  # names in Pinocchio
ENDLESS = "1e30"  # limit in a file for "unlimited"


class BodyError(UserError):
    """Invalid robot; the message has the file, the fault and the remedy."""


def read_robot(path: str | Path, joints: Sequence[str] | None, held: Mapping[str, float], bolted: bool) -> JSON:
    """Read the fields of a `Body` from a file; arguments and errors are those of `read_body`."""
    with _name_file(path):
        return _read_fields(Path(path), joints, held, bolted)


def find_movable_joints(path: str | Path, bolted: bool = False) -> tuple[str, ...]:
    """Find the independent joints of a file, in its order; arguments and errors are those of `read_body`."""
    with _name_file(path):
        return tuple(_parse(Path(path)).find_independent_joints(bolted, {}))


@contextmanager
def _name_file(path: str | Path) -> Iterator[None]:
    """Refuse a missing or too large file, and prepend the path to errors."""
    try:
        check_size(path)
        yield
    except UserError as error:
        raise BodyError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


@dataclass(frozen=True)
class _RobotFile:
    """Content of a file: XML, Pinocchio model, robot name, and the leader of each joint."""

    tree: ElementTree.Element
    model: Any
    name: str
    leaders: Mapping[str, _Mimic]

    def find_independent_joints(self, bolted: bool, held: Container[str]) -> list[str]:
        """Find joints that neither mimic nor belong to the base; refuse a floating base that is not fixed."""
        independent = [joint for joint, mimic in self.leaders.items() if mimic.joint == joint]
        bases = [joint for joint in independent if _find_joint_kind(self.model, joint) == "FreeFlyer"]
        for joint in bases:
            if not (bolted or joint in held):
                raise BodyError(
                    f"joint '{joint}' lets the base float: give {format_setting('bolted', True)} if it is bolted down"
                )
        return [joint for joint in independent if joint not in bases]


def _parse(path: Path) -> _RobotFile:
    pin = import_pinocchio()
    try:
        tree = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # also unknown encodings
        raise BodyError(f"is no XML ({shorten_error(error)}): a robot is read from URDF or MJCF") from None
    if tree.tag not in ("robot", "mujoco"):
        raise BodyError(f"holds <{tree.tag}>, neither <robot> (URDF) nor <mujoco> (MJCF)")
    for tag in ("include", "worldbody//frame[body]", "worldbody//replicate[body]", "worldbody//attach"):
        if (element := tree.find(f".//{tag}")) is not None:
            raise BodyError(
                f"has <{element.tag}>, which is not followed: write all of it into one file, as MuJoCo's compile does"
            )
    mimics = _read_mimics(tree)
    _replace_continuous_joints(tree)
    try:
        with _silence_output():
            model = (
                pin.buildModelFromXML(ElementTree.tostring(tree, encoding="unicode"))
                if tree.tag == "robot"
                else pin.buildModelFromMJCF(str(path))
            )
    except Exception as error:  # parsers of Pinocchio raise several types
        message = str(error).rpartition("message:")[2]  # without file, function and line
        raise BodyError(f"Pinocchio cannot read it: {shorten_error(message or error)}") from None
    name, robot = tree.get("name") or tree.get("model") or path.stem, list(model.names)[1:]
    return _RobotFile(tree, model, name, {joint: _find_leader(joint, mimics, robot) for joint in robot})


def _read_fields(path: Path, joints: Sequence[str] | None, held: Mapping[str, float], bolted: bool) -> JSON:
    file = _parse(path)
    model, leaders, movable = file.model, file.leaders, file.find_independent_joints(bolted, held)
    for joint in joints or ():
        if (leader := leaders[joint].joint if joint in leaders else joint) != joint:
            raise BodyError(f"joint '{joint}' mimics '{leader}': name that one, which it follows")
        find("joint", joint, {joint: mimic for joint, mimic in leaders.items() if mimic.joint == joint})
    chosen = movable if joints is None else joints
    moving = [joint for joint, mimic in leaders.items() if mimic.joint == joint and joint in chosen]
    held_positions = {
        joint: mimic.compute_position(float(held.get(mimic.joint, 0.0)))
        for joint, mimic in leaders.items()
        if mimic.joint not in moving
    }
    links = [joint for joint in leaders if joint not in held_positions]
    prismatic_joints = [joint for joint in leaders if _find_joint_kind(model, joint) == PRISMATIC]
    model = _lock_joints(model, held_positions)
    _refuse_unusable_joints(model)
    if (option := file.tree.find("option[@gravity]")) is not None:  # Pinocchio ignores this option
        model.gravity.linear = np.array(_parse_numbers(option.get("gravity", ""), "gravity of <option>", 3))
    for limit in ("lowerPositionLimit", "upperPositionLimit", "upperEffortLimit", "upperVelocityLimit"):
        values = np.array(getattr(model, limit))
        setattr(model, limit, np.where(np.abs(values) < float(ENDLESS), values, np.copysign(np.inf, values)))
    ratios = np.array([[leaders[link].ratio * (leaders[link].joint == joint) for joint in moving] for link in links])
    offsets = np.array([leaders[link].offset for link in links])
    axes = [np.linalg.norm(np.ravel(kind.createData().S)) for kind in list(model.joints)[1:]]
    places = [place.homogeneous for place in list(model.jointPlacements)[1:]]
    solids = [link.toDynamicParameters() for link in list(model.inertias)[1:]]
    numbers = (*places, *solids, model.armature, model.damping, model.upperDryFrictionLimit, model.gravity.linear)
    if not all((np.abs(values) <= MAX_NUMBER).all() for values in (*numbers, ratios, offsets)):  # also refuses NaN
        raise BodyError(f"holds a number beyond {MAX_NUMBER:g}: give lengths in m and masses in kg")
    if not np.allclose(axes, 1.0):
        raise BodyError("has a joint without an axis: give it one, of length 1")
    return {
        "name": file.name,
        "joints": tuple(moving),
        "held": held_positions,
        "links": tuple(links),
        "prismatic_joints": frozenset(prismatic_joints),
        "model": model,
        "ratios": ratios,
        "offsets": offsets,
    }


@contextmanager
def _silence_output() -> Iterator[None]:
    """Discard the output of a C++ library to the standard error."""
    error_output = os.dup(2)
    try:
        with open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), 2)
        yield
    finally:
        os.dup2(error_output, 2)
        os.close(error_output)


def _replace_continuous_joints(tree: ElementTree.Element) -> None:
    """Turn continuous joints of URDF into unlimited revolute joints, which Pinocchio describes by one angle."""
    for joint in tree.iterfind("joint[@type='continuous']"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
        ends = {"lower": f"-{ENDLESS}", "upper": ENDLESS}
        limit.attrib |= {"effort": ENDLESS, "velocity": ENDLESS} | limit.attrib | ends


def import_pinocchio() -> ModuleType:
    """Import Pinocchio, or raise a BodyError that names the extra."""
    try:
        import pinocchio
    except ImportError:
        raise BodyError("arms need Pinocchio: pip install 'pendulum-ident[arms]'") from None
    return pinocchio


@dataclass(frozen=True)
class _Mimic:
    """Mimic relation: position = ratio * position of `joint` + offset."""

    joint: str
    ratio: float
    offset: float

    def compute_position(self, position: float) -> float:
        return self.ratio * position + self.offset


def _find_leader(joint: str, mimics: Mapping[str, _Mimic], robot: Sequence[str]) -> _Mimic:
    """Return the relation of a joint to its independent leader, through a chain of mimics; the leader may be itself."""
    mimic, visited = _Mimic(joint, 1.0, 0.0), set[str]()
    while mimic.joint in mimics:
        if mimic.joint in visited:
            raise BodyError(f"joint '{joint}' mimics itself in a loop: let one of the joints mimic none")
        visited.add(mimic.joint)
        next_mimic = mimics[mimic.joint]
        mimic = _Mimic(next_mimic.joint, mimic.ratio * next_mimic.ratio, mimic.compute_position(next_mimic.offset))
    if mimic.joint not in robot:
        raise BodyError(f"joint '{joint}' mimics '{mimic.joint}', which is no joint that moves: mend it, or fix both")
    return mimic


def _lock_joints(model: Any, held: Mapping[str, float]) -> Any:
    """Return the model with held joints fixed and their links merged."""
    pin = import_pinocchio()
    q = pin.neutral(model)
    for joint, position in held.items():
        kind = model.joints[model.getJointId(joint)]
        if kind.nq == 1:  # joints of several coordinates stay at neutral
            q[kind.idx_q] = position
    return pin.buildReducedModel(model, [model.getJointId(joint) for joint in held], q) if held else model


def _find_joint_kind(model: Any, joint: str) -> str:
    """Return the type of a joint: `REVOLUTE`, `PRISMATIC` or Pinocchio's name of another type."""
    kind = str(model.joints[model.getJointId(joint)].shortname()).removeprefix("JointModel")
    for known_kind in (REVOLUTE, PRISMATIC):
        if kind.startswith(known_kind) or kind in (f"{known_kind[0]}{axis}" for axis in "XYZ"):
            return known_kind
    return kind


def _read_mimics(tree: ElementTree.Element) -> dict[str, _Mimic]:
    """Read the mimic relations by joint; refuse closed loops."""
    children = [child.get("link") for child in tree.iterfind("joint/child")]
    for link, times in Counter(children).items():
        if times > 1:
            raise BodyError(f"link '{link}' hangs on two joints: closed loops cannot be identified, cut one")
    ties = {}
    for joint in tree.iterfind("joint"):
        if (mimic := joint.find("mimic")) is not None:
            name, words = joint.get("name", ""), (mimic.get("multiplier", "1"), mimic.get("offset", "0"))
            ratio, offset = _parse_numbers(" ".join(words), f"joint '{name}' mimics another by", 2)
            ties[name] = _Mimic(mimic.get("joint", ""), ratio, offset)
    if any(link.get("name") is None for link in tree.iterfind("worldbody//body")):
        raise BodyError("a <body> has no name, by which Pinocchio tells them apart: give each one")
    for tie in tree.iterfind("equality/*"):
        name, leader = tie.get("joint1", ""), tie.get("joint2", "")
        numbers = f"{tie.get('polycoef', '0 1')} 0 0"
        offset, ratio, *higher = _parse_numbers(numbers, f"joint '{name}' mimics another by")
        if tie.tag != "joint" or not leader or any(higher):
            raise BodyError(f"<{tie.tag}> of <equality> closes a loop, which cannot be identified: leave it out")
        ties[name] = _Mimic(leader, ratio, offset)
    return ties


def _parse_numbers(text: str, subject: str, count: int | None = None) -> list[float]:
    with suppress(ValueError):
        numbers = [float(word) for word in text.split()]
        if count in (None, len(numbers)):
            return numbers
    raise BodyError(f"{subject} {quote_value(text)}: give {'' if count is None else f'{count} '}numbers")


def _refuse_unusable_joints(model: Any) -> None:
    """Refuse a model without joints, or with joints of other types or ambiguous names."""
    if model.njoints < 2:
        raise BodyError("has no joint that moves")
    for name in list(model.names)[1:]:
        kind = _find_joint_kind(model, name)
        if "," in name or name.startswith("-"):
            raise BodyError(f"joint '{name}': rename it, as a comma or a first minus names a coupling of joints")
        if kind not in (REVOLUTE, PRISMATIC):
            raise BodyError(
                f"joint '{name}' is {kind}: only revolute and prismatic joints, one a link, can be identified: have it "
                f"held by naming those that move, {format_setting('joints', Blank('A,B,C'))}"
            )
