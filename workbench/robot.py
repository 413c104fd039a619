"""A robot as a user names it: its file, which joints move, and where recordings have the others."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path
from typing import Self

import numpy as np

from estimators.arms.gains import Torques, in_torque, without_loads
from estimators.arms.meaning import shares
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.recording import ArmRecording, read_arm_source
from pendulum_env.arms.robot import pinocchio
from pendulum_env.recording import Source
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.recording.study import read_sources
from pendulum_env.words import listing

FORMATS = (".urdf", ".xml", ".mjcf")


@dataclass(frozen=True)
class RobotFile:
    """How a robot is to be read."""

    file: Path  # URDF or MJCF
    joints: tuple[str, ...] | None = None  # that move; None: all that can
    bolted: bool = False  # whether a base that floats is bolted down
    rotors: bool | None = None  # whether motors have inertia of their own; None: as the file has it
    weightless: bool = False  # whether the driver takes gravity's torque off what it logs

    def body(self, held: Mapping[str, float] | None = None) -> Body:
        """Its links, other joints held at the given places, or at zero; raises BodyError as `read_body`."""
        pinocchio()
        status = self.file.stat() if self.file.exists() else None
        changed = (status.st_mtime_ns, status.st_size) if status else None
        return _body(self, tuple((held or {}).items()), changed)

    def read(self, source: Source) -> ArmRecording:
        """A recording of it; raises RecordingError as `read_arm_source`."""
        body = self.body()
        return read_arm_source(source, body.joints, [at for at in (*body.held, *body.links) if at not in body.joints])

    def read_study(self, path: str | Path) -> tuple[Body, list[ArmRecording], list[ArmRecording]]:
        """Its links, and recordings of a study to fit and to hold out: in N m, and without known loads.

        Raises RecordingError if one cannot be read, or two say that the current of a joint is in two units, and
        IdentificationError if all that are fitted, or held out, have a known load.
        """
        sources = read_sources(path)
        recordings = [self.read(source) for source in sources]
        body = self.holding(recordings)
        logs = Logs.of(recordings, [source.role == "holdout" for source in sources], body)
        return body, *logs.bare

    def holding(self, recordings: Sequence[ArmRecording]) -> Body:
        """Its links, other joints held where recordings have them on average."""
        body = self.body()
        seen = {joint: [np.mean(one.still[joint]) for one in recordings if joint in one.still] for joint in body.held}
        return self.body({joint: float(np.mean(places)) for joint, places in seen.items() if places})


@dataclass(frozen=True, eq=False)
class Logs:
    """Recordings of a robot in N m, as far as anything tells the gains of currents."""

    body: Body
    torques: Torques  # all recordings in the order given, and the gains
    held_out: tuple[bool, ...]  # whether each is kept for checking

    @classmethod
    def of(
        cls, recordings: Sequence[ArmRecording], held_out: Sequence[bool], body: Body, unit: str | None = None
    ) -> Self:
        """Turn currents into torques, in the unit of a model if there is one; raises RecordingError as `in_torque`."""
        return cls(body, in_torque(recordings, body, unit), tuple(held_out))

    @cached_property
    def bare(self) -> tuple[list[ArmRecording], list[ArmRecording]]:
        """Those to fit and to hold out, without known loads; raises IdentificationError as `without_loads`."""
        both = list(zip(self.torques.recordings, self.held_out, strict=True))
        return without_loads(*([own for own, is_out in both if is_out == held] for held in (False, True)))

    @property
    def texts(self) -> list[str]:
        """The gains, and which recordings are left out, a sentence each."""
        left = [one.name for one in self.torques.recordings if not any(one in part for part in self.bare)]
        loaded = [f"left out, as a known load is no part of the arm: {listing(left)}"] if left else []
        return [*self.torques.texts(self.body), *loaded]


@lru_cache(maxsize=8)
def _body(robot: RobotFile, held: tuple[tuple[str, float], ...], changed: Hashable) -> Body:
    """Links of a file of that time and size; the last ones are kept."""
    body = read_body(robot.file, joints=robot.joints, held=dict(held), bolted=robot.bolted, rotors=robot.rotors)
    return body.weightless if robot.weightless else body


def meaning(recordings: Sequence[ArmRecording], body: Body, off: str = "say --no-gravity") -> list[str]:
    """What the torques of recordings seem to be, where they are not those that the joints need, a question each.

    Nothing is asked of currents; `off` is what to do where gravity is taken off.
    """
    known = all(one.torque_unit == NEWTON_METRE and not one.currents for one in recordings)
    found = shares(recordings, body) if known else []
    weightless = [one.joint for one in found if one.kind == "weightless"]
    texts = []
    if weightless:
        joints = f"joint{'s' * (len(weightless) > 1)} {listing(weightless)}"
        texts.append(f"no gravity in the torque of {joints}: does the driver take it off? Then {off}")
    for one in found:
        if one.kind == "geared":
            texts.append(
                f"the torque of joint {one.joint} is about {one.weight:.1g} times what the links of the file need: is "
                f"it the motor's, before its gear? Then say --columns torque_{one.joint}=NAME*RATIO"
            )
        elif one.kind == "reversed":
            texts.append(
                f"joint {one.joint} seems to carry the weight of its links upwards: does its torque, or its position, "
                f"count the other way? Then say --columns torque_{one.joint}=-NAME, for one"
            )
    return texts


def held_text(body: Body) -> str:
    """Which joints are held where; empty if all move."""
    units = {joint: body.worded(joint, "rad") for joint in body.held}
    places = [f"{joint} at {f'{q:.4g} {units[joint]}' if q else 'zero'}" for joint, q in body.held.items()]
    return f"held: {', '.join(places)}" if places else ""


def straying(body: Body, recordings: Sequence[ArmRecording]) -> list[str]:
    """Joints that are held and that recordings have elsewhere, a sentence each."""
    found = []
    for recording, (joint, q) in product(recordings, body.held.items()):
        # [rad] or [m], beyond which there is a warning
        if (off := np.max(np.abs(recording.still.get(joint, q) - q))) > 0.01:
            away = f"{joint} gets {off:.2g} {body.worded(joint, 'rad')} away from there in {recording.name}"
            found.append(f"{away}: name it in --joints if it moves")
    return found
