"""The demo of an arm: links of which a file tells the lengths, with an effect hidden at a joint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from estimators.arms.excitation import design_excitation
from estimators.arms.following import follow
from estimators.progress import Progress
from pendulum_env.arms.body import read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.joints import arm_base, effect_at, joint_effects
from pendulum_env.arms.planar import TWO_LINK, Link, joint_names, urdf
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import Estimate
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.plant import draw_effect
from pendulum_env.recording import Recording
from workbench.runs import Hidden

SPREAD = 0.25  # of what nobody told, to either side
JOINTS = joint_names(len(TWO_LINK))


def hidden_arm(robot: Path, truth: Path, rng: np.random.Generator, seconds: float) -> Hidden:
    """An arm like that of a file with one effect hidden in it; writes the file, and another one of the true arm."""
    links, hidden = tuple(draw_link(link, rng) for link in TWO_LINK), hide_somewhere(rng)
    write_whole(robot, urdf(TWO_LINK, JOINTS))  # of the right lengths, with masses and inertias as somebody drew them
    write_whole(truth, urdf(links, JOINTS))
    body, true = read_body(robot), read_body(truth)
    arm = PlanarArm(links, effects=hidden, max_torque=MOST_TORQUE, torque_noise=TORQUE_NOISE, velocity="ideal")

    def record(name: str, progress: Progress) -> Recording:
        motion = design_excitation(body, max_torque=MAX_TORQUE, rng=rng)  # less than may be asked for, as of a motor
        return follow(arm, motion, round(seconds * arm.rate), MAX_TORQUE, rng=rng, name=name, progress=progress)

    at = hidden.partition(":")[0]
    parameters = {
        one.name: Estimate(value, 0.0, one.unit) for one, value in zip(true.base, true.values.tolist(), strict=True)
    }
    for joint, model in zip(JOINTS, arm.models, strict=True):
        parameters |= {f"{name}@{joint}": own for name, own in model.estimates.items()}
    return Hidden(
        "An arm of two links, of which a file tells the lengths, with one effect at a joint that nobody told",
        at,
        effect_at(at, JOINTS)[0].law,
        parameters,
        arm_base(body),
        record,
    )


def draw_link(link: Link, rng: np.random.Generator) -> Link:
    """A link as long as that of the file, all else about as there."""
    names = ("mass", "center", "inertia", "viscous", "coulomb")
    factors = rng.uniform(1 - SPREAD, 1 + SPREAD, len(names)).tolist()
    return replace(link, **{name: getattr(link, name) * factor for name, factor in zip(names, factors, strict=True)})


def hide_somewhere(rng: np.random.Generator) -> str:
    """One effect of the library at one of the joints, as text: `stribeck@elbow:stribeck=0.4,stribeck_velocity=0.3`."""
    known = [kind for kind in BUILT_IN if kind.id in joint_effects()]
    kind, joint = known[rng.integers(len(known))], JOINTS[int(rng.integers(len(JOINTS)))]
    parameters = ",".join(f"{name}={value:.4g}" for name, value in draw_effect(kind, rng).items())
    return f"{kind.id}@{joint}:{parameters}"
