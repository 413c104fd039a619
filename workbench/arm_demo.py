"""The demo of an arm: a hidden effect found at its joint, end to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from estimators.arms.diagnosis import diagnose_arm
from estimators.arms.excitation import design_excitation
from estimators.arms.following import follow
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.joints import effect_at, joint_effects
from pendulum_env.arms.planar import TWO_LINK, Link, joint_names, urdf
from pendulum_env.arms.recording import ArmRecording, write_arm_recording
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import Estimate
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.plant import draw_effect
from workbench.arms import story
from workbench.commands.demo import reveal
from workbench.inputs import check_outputs, wrote
from workbench.terminal import Terminal

SPREAD = 0.25  # of what nobody told, to either side


def run(
    report: Path, files: Sequence[Path], seconds: float, seed: int, terminal: Terminal, verbose: bool = False
) -> None:
    """Hide an effect at a joint, record, diagnose, report, reveal."""
    from workbench.report.arm import write_arm_report  # plotly takes a while to import

    robot, truth = (report.with_name(f"{report.stem}.{part}.urdf") for part in ("robot", "truth"))
    written = [robot, *files]
    check_outputs([str(path) for path in (report, truth, *written)])
    rng = np.random.default_rng(seed)
    joints = joint_names(len(TWO_LINK))
    links, hidden = draw_links(rng), hide_somewhere(rng, joints)
    write_whole(robot, urdf(TWO_LINK, joints))  # of the right lengths, with masses and inertias as somebody drew them
    write_whole(truth, urdf(links, joints))
    body = read_body(robot)
    arm = PlanarArm(
        links, joints=joints, effects=hidden, max_torque=MOST_TORQUE, torque_noise=TORQUE_NOISE, velocity="ideal"
    )
    terminal.heading(
        "An arm of two links, of which a file tells the lengths, with one effect at a joint that nobody told"
    )
    recordings = [record(arm, body, round(seconds * arm.rate), rng, file, terminal) for file in files]
    train, holdout = recordings
    terminal.say(f"recorded twice for {seconds:g} s: once to learn from, once to check on")
    with terminal.progress("diagnosing") as progress:
        found = diagnose_arm(train, body, [holdout], progress)
    story(found).tell(terminal, verbose, more=False)
    with terminal.progress("writing the report"):
        write_arm_report(report, [train], [holdout], found)
    at = hidden.partition(":")[0]
    reveal([at], effect_at(at, joints)[0].law, true_parameters(arm, read_body(truth)), found, terminal)
    wrote([report, truth, *written], terminal)
    terminal.say(f"another arm: pendulum-ident demo --robot two-link --seed {seed + 1}")


def draw_links(rng: np.random.Generator) -> tuple[Link, ...]:
    """Links as long as those of the file, all else about as there."""
    drawn = []
    for link in TWO_LINK:
        names = ("mass", "center", "inertia", "viscous", "coulomb")
        factors = rng.uniform(1 - SPREAD, 1 + SPREAD, len(names))
        values = {name: getattr(link, name) * factor for name, factor in zip(names, factors.tolist(), strict=True)}
        drawn.append(replace(link, **values))
    return tuple(drawn)


def hide_somewhere(rng: np.random.Generator, joints: Sequence[str]) -> str:
    """One effect of the library at one of the joints, as text: `stribeck@elbow:stribeck=0.4,stribeck_velocity=0.3`."""
    known = [kind for kind in BUILT_IN if kind.id in joint_effects()]
    kind = known[rng.integers(len(known))]
    joint = joints[int(rng.integers(len(joints)))]
    parameters = ",".join(f"{name}={value:.4g}" for name, value in draw_effect(kind, rng).items())
    return f"{kind.id}@{joint}:{parameters}"


def record(
    arm: PlanarArm, body: Body, samples: int, rng: np.random.Generator, file: Path, terminal: Terminal
) -> ArmRecording:
    """One recording of a motion designed for it, written to a file."""
    motion = design_excitation(body, max_torque=MAX_TORQUE, rng=rng)  # no motor has all the torque that one may ask for
    with terminal.progress(f"recording {file.name}") as progress:
        recording = follow(arm, motion, samples, MAX_TORQUE, rng=rng, name=file.stem, progress=progress)
    write_arm_recording(recording, file)
    return recording


def true_parameters(arm: PlanarArm, body: Body) -> dict[str, Estimate]:
    """Base parameters of the links, and those of what acts at the joints."""
    links = {
        one.name: Estimate(value, 0.0, one.unit) for one, value in zip(body.base, body.values.tolist(), strict=True)
    }
    joints = zip(arm.joints, arm.models, strict=True)
    return links | {f"{name}@{at}": own for at, model in joints for name, own in model.estimates.items()}
