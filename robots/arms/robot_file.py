"""Robot file of an arm with its settings: moving joints, held joints, and their positions in recordings."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Self

import numpy as np

from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.recording import Recording, Source
from pendulum_env.robot_file import HeldJointMotion, LinkReader, RobotFile
from robots.arms.body import Body, parse_body, read_body
from robots.arms.reading import HELD_RANGE, find_logged_joints, read_arm_source
from robots.arms.recording import ArmRecording
from robots.arms.robot import find_movable_joints, import_pinocchio


@dataclass(frozen=True)
class ArmFile(RobotFile):
    """Robot file of an arm."""

    def body(self, held: Mapping[str, float] | None = None) -> Body:
        """Return the links, with other joints held at the given positions or zero; raises BodyError as `read_body`."""
        import_pinocchio()
        status = self.file.stat() if self.file.exists() else None
        changed = (status.st_mtime_ns, status.st_size) if status else None
        return _read_body(self, tuple((held or {}).items()), changed)

    def keep_logged_joints(self, sources: Sequence[Source]) -> Self:
        """Return a copy that holds joints without columns in the sources, unless `joints` is set."""
        if self.joints is not None or not sources:
            return self
        all_joints = find_movable_joints(self.file, bolted=True)
        logged = [
            find_logged_joints(
                source.file, all_joints, source.columns, "torque" if source.drive is None else "reference"
            )
            for source in sources
        ]
        moving = tuple(joint for joint in all_joints if all(joint in joints for joints in logged))
        return replace(self, joints=moving) if moving and moving != all_joints else self

    def read(self, source: Source) -> ArmRecording:
        """Read a recording of the robot; raises RecordingError as `read_arm_source`."""
        body = self.body()
        return read_arm_source(source, body.joints, [at for at in (*body.held, *body.links) if at not in body.joints])

    def hold_joints(self, recordings: Sequence[Recording]) -> Body:
        """Return the links, with other joints held at their mean position in the recordings."""
        body, arms = self.body(), [recording for recording in recordings if isinstance(recording, ArmRecording)]
        positions = {joint: [np.mean(one.still[joint]) for one in arms if joint in one.still] for joint in body.held}
        return self.body({joint: float(np.mean(places)) for joint, places in positions.items() if places})

    def find_held_joint_motion(self, body: LinkedMechanism, recordings: Sequence[Recording]) -> list[HeldJointMotion]:
        """Find held joints that leave their position in recordings by more than `HELD_RANGE`."""
        motion = []
        for recording, (joint, q) in product(recordings, body.held.items()):
            places = recording.still.get(joint, q) if isinstance(recording, ArmRecording) else q
            if (off := float(np.max(np.abs(places - q)))) > HELD_RANGE:
                motion.append(HeldJointMotion(joint, off, recording.name))
        return motion


@lru_cache(maxsize=8)
def _read_body(robot: ArmFile, held: tuple[tuple[str, float], ...], changed: Hashable) -> Body:
    """Read the links of a file, cached; `changed` holds the time and size of the file."""
    body = read_body(robot.file, joints=robot.joints, held=dict(held), bolted=True, rotors=robot.rotors)
    return body.weightless if robot.weightless else body


READER = LinkReader(read_body, parse_body, ArmFile)
