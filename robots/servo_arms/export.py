"""Export of an arm of servos: its links, joints and drives for MuJoCo, and the joints for other programs."""

from collections.abc import Sequence

import numpy as np

from estimators.comparison import compare
from estimators.decisions.criterion import Criterion
from pendulum_env.backends.constrained_body import import_mujoco
from pendulum_env.export import feedforward, snippet
from pendulum_env.export.exporter import CheckResult, Exporter
from pendulum_env.export.mjcf import add_actuator
from pendulum_env.export.request import Exported, ExportError, Request
from pendulum_env.export.sizes import SPEEDS
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from robots.arms.export import LINKS, JointExport, build_arm, write_specification
from robots.servo_arms.model import ServoArmModel
from robots.servo_arms.whole import WholeArm, find_typical_loads, join_links
from robots.servos.exported_servo import Servo
from robots.servos.torque import follow_goals

SLOW = np.geomspace(0.02, SPEEDS[-1], len(SPEEDS))  # [rad/s], speeds of servos, mostly slow


class ServoArmExporter(Exporter):
    """Export of an arm of servos."""

    def accepts(self, model: Model, request: Request) -> bool:
        """Return whether the model is that of an arm of servos."""
        return isinstance(model, ServoArmModel)

    def export(self, model: Model, format: str, request: Request) -> Exported:
        """Write an arm for MuJoCo, or its joints for other programs; raises ExportError for other formats."""
        assert isinstance(model, ServoArmModel)
        if format in ("python", "c"):
            raise ExportError(f"an arm is exported to mjcf, snippet or feedforward, not to {format}")
        arm = join_links(model, request)
        if format == "mjcf":
            return export_arm(arm, request)
        if format == "feedforward":
            return feedforward.export([*arm.joints.items()], request.language)
        armatures = arm.standard[-len(arm.joints) :].tolist()
        parts = zip(arm.joints.items(), armatures, strict=True)
        return snippet.write_joints(
            [
                snippet.JointParameters(at, joint, armature, servo.gains, (*servo.missing, LINKS))
                for (at, joint), armature in parts
                for servo in [Servo(arm.drives[at])]
            ]
        )

    def check(
        self,
        model: Model,
        exported: Exported,
        request: Request,
        recordings: Sequence[Recording],
        criterion: Criterion = Criterion(),
    ) -> CheckResult:
        """Play the goals of recordings of the arm in MuJoCo, beside this project's simulation joint by joint."""
        assert isinstance(model, ServoArmModel)
        own = compare(model, recordings, criterion=criterion).joint.errors
        joints = model.mechanism.joints
        differences = np.concatenate([play_goals(exported, joints, one) for one in recordings])
        measured = np.concatenate([recording.position for recording in recordings])
        errors, motions = dict[str, float](), dict[str, float]()
        for k, at in enumerate(joints):
            for name, error in (("this project's simulation", own.joints[at]), ("MuJoCo", differences[:, k].mean())):
                errors[f"{at}, {name}"] = float(error)
                motions[f"{at}, {name}"] = float(np.mean(np.abs(measured[:, k] - measured[:, k].mean())))
        return CheckResult("Whole recordings from their goals alone, mean error", errors, motions)


def export_arm(arm: WholeArm, request: Request) -> Exported:
    """Write an arm for MuJoCo, with the drive of each joint; raises as `build_arm`."""
    servos = {at: Servo(drive) for at, drive in arm.drives.items()}
    loads = find_typical_loads(arm)
    joints = {
        at: JointExport(model, servos[at], servos[at].missing, SLOW, loads[at]) for at, model in arm.joints.items()
    }
    spec, notes = build_arm(arm.body, arm.standard, joints, (), request)
    for at, servo in servos.items():
        add_actuator(spec, at, at, servo, arm.joints[at])
    return write_specification(spec, arm.body, (*notes, *_describe_scale(arm)))


def _describe_scale(arm: WholeArm) -> tuple[str, ...]:
    if arm.scale is None:
        return ()
    return (f"torque is in N m by the masses of the robot file: a unit of the drives is {arm.scale:.3g} N m",)


def play_goals(exported: Exported, joints: Sequence[str], recording: Recording) -> np.ndarray:
    """Return the distances of the positions in MuJoCo from those of an arm's recording (N, n) [rad].

    The simulation starts from the measured state. Goals act as the drives read them.
    """
    mujoco = import_mujoco()
    world, parts = mujoco.MjModel.from_xml_string(exported.content), []
    place = [int(world.joint(at).qposadr[0]) for at in joints]
    for segment in recording.segments:
        count = max(1, round(1.0 / (segment.rate * world.opt.timestep)))
        world.opt.timestep = 1.0 / (segment.rate * count)
        data, goals = mujoco.MjData(world), segment.reference
        assert goals is not None  # recordings with drives have goals
        is_ramp = np.array([drive.goal == "ramp" for drive in getattr(segment, "drives", ())])
        data.qpos[place], path = segment.position[0], np.empty_like(segment.position)
        steps = np.arange(count * len(goals)) / count  # [rows]
        followed = np.column_stack([follow_goals(of_joint, steps) for of_joint in goals.T])
        followed = np.where(is_ramp, followed, np.repeat(goals, count, axis=0)).reshape(len(goals), count, -1)
        for k, of_row in enumerate(followed):
            path[k] = data.qpos[place]
            for goal in of_row:
                data.ctrl[:] = goal
                mujoco.mj_step(world, data)
        parts.append(np.abs(path - segment.position)[1:])
    return np.concatenate(parts)


EXPORTER = ServoArmExporter()
