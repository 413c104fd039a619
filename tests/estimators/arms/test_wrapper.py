import gymnasium as gym
import numpy as np
import pytest

from benchmarks import six_joint
from benchmarks.two_link import Multisine
from estimators.arms import identify_arm
from estimators.wrappers import DiagnoseOnline, EstimateArmParameters, EstimateParameters, WatchModel
from pendulum_env import ARM, PENDULUM
from pendulum_env.arms import read_body
from pendulum_env.arms.planar import TWO_LINK
from pendulum_env.arms.recording import ArmRecording

RATE = 500.0


def run(env, steps, seed=0):
    signal, samples = Multisine.paper(seed, (5.0, 2.5)), []
    _, info = env.reset(seed=seed)
    for k in range(steps):
        time, position = info["time"], info["position"]
        info = env.step(signal(k / RATE))[4]
        samples.append((time, position, info["torque"]))
    return info, [np.array(series) for series in zip(*samples, strict=True)]


@pytest.fixture(scope="module")
def env():
    arm = gym.make(ARM, max_episode_steps=-1, rate=RATE, substeps=2, torque_noise=0.01)
    return EstimateArmParameters(arm, ["filtered_dynamic", "energy"])


def test_an_arm_is_known_after_a_few_seconds_as_well_as_from_its_recording(env, tmp_path):
    info, samples = run(env, 3000)
    (tmp_path / "arm.urdf").write_text(env.unwrapped.urdf)
    body = read_body(tmp_path / "arm.urdf")
    offline = identify_arm(ArmRecording.of("run", body.joints, *samples), body)
    friction = [value for link in TWO_LINK for value in (link.viscous, link.coulomb)]
    for scheme, found in info["estimates"].items():
        assert found["P"].shape == (10, 10) and info["parameters"] == tuple(offline[scheme].model.estimates)
        assert np.allclose(found["theta"], offline[scheme].model.theta, rtol=0.02, atol=5e-3)
        assert np.allclose(found["theta"], [*body.values, *friction], rtol=0.03, atol=0.01)


def test_reset_starts_estimation_anew(env):
    assert any(run(env, 600)[0]["estimates"]["energy"]["theta"])
    assert not env.reset()[1]["estimates"]["energy"]["theta"].any()


def test_spec_rebuilds_it_and_the_picture_shows_what_is_known():
    env = EstimateArmParameters(gym.make(ARM, rate=RATE, render_mode="rgb_array"), "dynamic")
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    a, b = (run(one, 400)[0]["estimates"]["dynamic"]["theta"] for one in (env, again))
    np.testing.assert_array_equal(a, b)
    shown = env.render()
    env.unwrapped.overlay = tuple
    assert (shown != env.render()).sum() > 500


def test_an_environment_without_links_is_refused():
    with pytest.raises(ValueError, match="does not tell its links: pass robot="):
        EstimateArmParameters(gym.make(PENDULUM))
    with pytest.raises(ValueError, match="wrap it, or each one of a vector, in EstimateArmParameters"):
        EstimateParameters(gym.make(ARM))


def test_a_file_of_another_arm_is_refused(tmp_path):
    (tmp_path / "six.urdf").write_text(six_joint.urdf())
    with pytest.raises(ValueError, match=r"joints shoulder, elbow, and .*six\.urdf base, shoulder"):
        EstimateArmParameters(gym.make(ARM), robot=str(tmp_path / "six.urdf"))


@pytest.mark.parametrize("wrapper", [EstimateArmParameters, WatchModel, DiagnoseOnline])
def test_all_wrappers_take_terms_of_joints_by_name(wrapper):
    names = ["viscous@shoulder", "viscous@elbow", "coulomb@elbow"]
    wrapper(gym.make(ARM, rate=RATE), terms=names).reset(seed=0)
    with pytest.raises(ValueError, match="viscos"):
        wrapper(gym.make(ARM), terms=["viscos@elbow"])
    with pytest.raises(ValueError, match="coulomb@knee is at none of the joints shoulder, elbow"):
        wrapper(gym.make(ARM), terms=["coulomb@knee"])
