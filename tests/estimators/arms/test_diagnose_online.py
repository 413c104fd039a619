"""An arm is diagnosed while it runs: an effect is named with its joint. Its motion is that of SciPy's integrator."""

import gymnasium as gym
import numpy as np
import pytest

from estimators.arms.online import ArmBinner
from estimators.online import Diagnoser
from estimators.signals.measurements import Smoothing
from estimators.wrappers import DiagnoseOnline
from pendulum_env.arms.joints import Links, at_joint, friction
from pendulum_env.physics import effects
from pendulum_env.registration import ARM
from tests.two_link import Hidden, recorded

RATE, COUNTS = 500.0, 65_536


@pytest.mark.parametrize(
    ("plant", "group"),
    [
        (Hidden(), ()),
        (Hidden(drag=(0.0, 0.05)), ("quadratic_drag@elbow",)),
        (Hidden(cogging=(0.4, 0.0)), ("cogging@shoulder",)),
    ],
    ids=["none", "drag", "cogging"],
)
def test_what_is_missing_is_told_with_its_joint(body, plant, group):
    run = recorded(plant, seconds=9.0, rate=RATE, scale=(5.0, 2.5), counts=COUNTS)
    torque = np.vstack([run.torque[:1], run.torque[:-1]])  # over the period that ends with the sample
    links = Links(body)
    binner = ArmBinner((links,), Smoothing.of_encoder(COUNTS, RATE), RATE)
    names = ("quadratic_drag", "cogging", "stribeck", "torque_offset")
    library = {f"{id}@{joint}": at_joint(effects()[id], joint) for id in names for joint in body.joints}
    diagnoser = Diagnoser(RATE, (links, *friction(body)), library=library, binner=binner)
    for t, q, u in zip(run.time, run.position, torque, strict=True):
        (said,) = diagnoser.take(np.array([t]), q[None], u[None])
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
