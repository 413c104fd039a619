"""Robot files with their settings, read by an installed package."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

from msgspec import Struct, structs

from pendulum_env.errors import FileError
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.plugins import load_plugins, make_missing_error
from pendulum_env.reading import Number, Text, convert, read_json
from pendulum_env.recording import Recording, Source

READERS = "pendulum_ident.links"  # entry points of link readers
ENDINGS = (".urdf", ".xml", ".mjcf")  # of robot files
HINT = "identify or diagnose the arm to have one"  # for a missing model


class RobotOptions(Struct, frozen=True):
    """Options of a model file: moving and held joints, rotors, gravity and log format."""

    joints: tuple[Text, ...] | None = None
    held: dict[str, Number] = {}
    rotors: bool | None = None
    weightless: bool = False
    log_format: dict[str, Any] = {}

    @classmethod
    def read_from_model(cls, path: str | Path | None) -> RobotOptions:
        """Read the options from a model file; empty without one, or if the file is not a model."""
        if not path:
            return cls()
        try:
            options = convert(read_json(path, HINT), cls)
        except FileError:
            return cls()  # `load_model` raises the error
        return options if options.held else structs.replace(options, joints=None)


class HeldJointMotion(NamedTuple):
    """Held joint that leaves its position in a recording."""

    joint: str
    deviation: float  # largest one [rad] or [m]
    recording: str  # its name


@dataclass(frozen=True)
class RobotFile(ABC):
    """Robot file and its settings.

    Attributes:
        file: path of the file, URDF or MJCF.
        joints: names of the moving joints; None: all movable ones.
        rotors: whether rotor inertia is identified; None: if the file has it.
        weightless: whether the driver subtracts gravity from the logged torque.
    """

    file: Path
    joints: tuple[str, ...] | None = None
    rotors: bool | None = None
    weightless: bool = False

    @abstractmethod
    def body(self, held: Mapping[str, float] | None = None) -> LinkedMechanism:
        """Return the links, with other joints held at the given positions or zero.

        Raises:
            UserError: if the file cannot be used.
        """

    @abstractmethod
    def keep_logged_joints(self, sources: Sequence[Source]) -> Self:
        """Return a copy that holds joints without columns in the sources, unless `joints` is set."""

    @abstractmethod
    def read(self, source: Source) -> Recording:
        """Read a recording of the robot; raises RecordingError."""

    @abstractmethod
    def hold_joints(self, recordings: Sequence[Recording]) -> LinkedMechanism:
        """Return the links, with other joints held at their mean position in the recordings."""

    @abstractmethod
    def find_held_joint_motion(self, body: LinkedMechanism, recordings: Sequence[Recording]) -> list[HeldJointMotion]:
        """Find held joints that leave their position in recordings."""


class LinkReader(NamedTuple):
    """Reader of links of an installed package: of a file, of the text of a URDF file, and of a file with settings."""

    read: Callable[[str | Path], LinkedMechanism]
    parse: Callable[[str], LinkedMechanism]
    open: type[RobotFile]


def find_link_reader() -> LinkReader:
    """Return the reader of an installed package, the first by the name of its entry point."""
    readers = [reader for reader in load_plugins(READERS).values() if isinstance(reader, LinkReader)]
    if not readers:
        raise make_missing_error(READERS, "reads links")
    return readers[0]
