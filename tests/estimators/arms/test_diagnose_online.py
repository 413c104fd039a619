"""An arm is diagnosed while it runs: an effect is named with its joint. Its motion is that of SciPy's integrator."""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.two_link import Multisine, TwoLink
from estimators.arms.online import ArmBinner
from estimators.online import Diagnoser
from estimators.signals.measurements import Smoothing
from estimators.wrappers import DiagnoseOnline
from pendulum_env.arms.joints import Links, at_joint, friction
from pendulum_env.physics import effects
from pendulum_env.registration import ARM

RATE, COUNTS = 500.0, 65_536


@dataclass(frozen=True)
class Hidden(TwoLink):
    """With a torque at one joint."""

    joint: int = 0
    drag: float = 0.0
    cogging: float = 0.0

    def bias(self, q, v):
        own = np.zeros(2)
        own[self.joint] = self.drag * abs(v[self.joint]) * v[self.joint] + self.cogging * np.sin(12 * q[self.joint])
        return super().bias(q, v) + own


@pytest.mark.parametrize(
    ("plant", "group"),
    [
        (TwoLink(), ()),
        (Hidden(joint=1, drag=0.05), ("quadratic_drag@elbow",)),
        (Hidden(joint=0, cogging=0.4), ("cogging@shoulder",)),
    ],
    ids=["none", "drag", "cogging"],
)
def test_what_is_missing_is_told_with_its_joint(body, plant, group):
    time, signal = np.arange(0.0, 9.0, 1 / RATE), Multisine.paper(0, (5.0, 2.5))
    position, _ = plant.simulate(signal, time)
    torque = signal.held(time - 1 / RATE, 1 / RATE) + 0.02 * np.random.default_rng(0).normal(size=position.shape)
    step = 2 * np.pi / COUNTS
    links = Links(body)
    binner = ArmBinner((links,), Smoothing.of_encoder(COUNTS, RATE), RATE)
    names = ("quadratic_drag", "cogging", "stribeck", "torque_offset")
    library = {f"{id}@{joint}": at_joint(effects()[id], joint) for id in names for joint in body.joints}
    diagnoser = Diagnoser(RATE, (links, *friction(body)), library=library, binner=binner)
    for k, t in enumerate(time):
        (said,) = diagnoser.take(np.array([t]), step * np.round(position[k : k + 1] / step), torque[k : k + 1])
    assert said.group == group and said.kind == ("missing" if group else "nothing")
    if group == ("quadratic_drag@elbow",):
        (found,) = (one for one in said.ranking if one.effect in group)
        assert found.theta["quadratic_drag@elbow"] == pytest.approx(0.05, rel=0.15)


def test_the_wrapper_knows_the_arms_effects_and_takes_one_in():
    env = DiagnoseOnline(
        gym.make(ARM, rate=500, effects="cogging@elbow=12,0.4"), candidates=["cogging", "quadratic_drag@elbow"]
    )
    env.reset(seed=0)
    for k in range(3000):
        *_, info = env.step(np.array([5 * np.sin(k / 40) + 3 * np.sin(k / 220), 2.5 * np.sin(k / 35)]))
    assert info["diagnosis"].group == ("cogging@elbow",)
    assert env.add("cogging@elbow").id == "cogging@elbow" and env.diagnoser.said.added == ("cogging@elbow",)
    with pytest.raises(ValueError, match="unknown effect 'stribek': did you mean stribeck"):
        DiagnoseOnline(gym.make(ARM), candidates="stribek")
