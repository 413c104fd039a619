"""An arm while it runs: estimated and diagnosed, in motion of SciPy's integrator and of the environment."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import six_joint
from benchmarks.two_link import Multisine, TwoLink
from estimators import identify
from estimators.online import Diagnoser, JointState, OnlineEstimator
from estimators.schemes import six
from estimators.schemes.balance import adapt_to_arms
from estimators.schemes.six import SCHEMES, Integral
from estimators.signals.measurements import Smoothing
from estimators.wrappers import (
    DiagnoseOnline,
    DiagnoseOnlineVector,
    EstimateParameters,
    EstimateParametersVector,
)
from pendulum_env import ARM, PENDULUM
from pendulum_env.physics import BASE, Model, effects
from pendulum_env.physics.joints import place_effect
from robots.arms import arm_base
from robots.arms.body import read_body
from robots.arms.model import ArmModel
from robots.arms.planar import TWO_LINK
from tests.two_link import JOINTS, record_arm

RATE, COUNTS, CHANGE = 500.0, 65_536, 7.0
TWO = TwoLink()
LIVELY = (5.0, 2.5)


@pytest.fixture(scope="module")
def recording():
    return record_arm(seconds=5.0, rate=RATE, scale=LIVELY, noise=0.01)


@pytest.fixture
def links(body):
    return arm_base(body)


def taken(learner, time, position, held):
    """What is known after each of some samples (N,), of the torque held over the period before it."""
    for t, q, u in zip(time, position, held, strict=True):
        yield t, learner.take(np.array([t]), q[None], u[None])


def known(links, recording, schemes=(SCHEMES[1],), torque=None, some=slice(None)):
    """What is estimated of a recording in the end, or of some of its samples."""
    learner = OnlineEstimator(RATE, links, schemes, smoothing=Smoothing.from_encoder(0, RATE))
    held = np.vstack([np.zeros((1, 2)), (recording.torque if torque is None else torque)[:-1]])
    *_, (_, now) = taken(learner, recording.time[some], recording.position[some], held[some])
    return now


def test_online_and_offline_agree_and_intervals_hold_the_truth(body, links, recording):
    schemes = adapt_to_arms(SCHEMES)
    now, offline = known(links, recording, schemes), identify(recording, links, schemes)
    truth = np.concatenate([body.values, np.ravel(np.column_stack([TWO.viscous, TWO.coulomb]))])
    some = np.abs(truth) > 1e-9
    for s, scheme in enumerate(schemes):
        theta, std = now.theta[0, s], np.sqrt(np.diag(now.covariance[0, s]))
        assert np.abs(theta[some] / truth[some] - 1).max() < 0.02
        assert np.allclose(theta, offline[scheme.id].model.theta, rtol=0.02, atol=2e-3)
        assert (np.abs(theta - truth) < 4 * std).mean() > 0.8 and (std < 0.05).all()


def test_each_row_is_used_once_but_for_those_of_the_first_and_last_moments(links, recording):
    now, schemes = known(links, recording, [six.scheme("hamiltonian")]), [six.scheme("hamiltonian")]
    information = np.diag(np.linalg.inv(now.P[0, 0]))
    rows = information[[7, 9]].sum()  # a Coulomb column is +-1 on each row of its joint
    used = identify(recording, links, schemes)["hamiltonian"].used[0]
    assert 0.9 * used < rows < 1.001 * used


def test_nothing_is_told_across_a_gap_or_a_sample_that_is_no_number(links, recording):
    nan = np.array(recording.torque)
    nan[1249, 0] = np.nan  # comes with sample 1250
    whole, cut = known(links, recording), known(links, recording, torque=nan)
    apart = known(links, recording, some=np.arange(len(recording)) != 1249)
    assert np.array_equal(cut.theta, apart.theta) and not np.array_equal(cut.theta, whole.theta)
    assert np.allclose(cut.theta, whole.theta, rtol=0.02, atol=2e-3)


def test_samples_and_schemes_that_make_no_sense_are_refused_at_once(links):
    online = OnlineEstimator(RATE, links, SCHEMES[:1])

    def take(time, count=2):
        online.take(np.array([time]), np.zeros((1, count)), np.zeros((1, 2)))

    take(0.0)
    for time, count, told in (
        (0.002, 3, r"shapes \(3,\)"),
        (0.0, 2, "a sample at 0 s follows one at 0 s: call reset"),
        (0.004, 2, r"samples come every 0.004 s, not at 500 Hz: pass rate="),
    ):
        with pytest.raises(ValueError, match=told):
            take(time, count)
    for time in (0.002, 0.004, 0.1, 0.102):  # what was refused has not moved the clock; once it is known, 0.1 is a gap
        take(time)
    for scheme, told in (
        (six.scheme("hamiltonian", borrows="dynamic"), "needs the whole recording of an arm"),
        (six.scheme("energy", operator=Integral(None)), "needs the whole recording of an arm"),
        (JointState(), "use the six schemes for an arm"),
    ):
        with pytest.raises(ValueError, match=told):
            OnlineEstimator(RATE, links, [scheme])


@pytest.mark.parametrize(
    ("plant", "group"),
    [
        (TwoLink(), ()),
        (TwoLink(drag=(0.0, 0.05)), ("quadratic_drag@elbow",)),
    ],
    ids=["none", "drag"],
)
def test_what_is_missing_is_told_with_its_joint(links, plant, group):
    run = record_arm(plant, seconds=9.0, rate=RATE, scale=LIVELY, counts=COUNTS)
    names = ("quadratic_drag", "cogging", "stribeck", "torque_offset")
    library = {f"{id}@{joint}": place_effect(effects()[id], joint) for id in names for joint in run.names}
    diagnoser = Diagnoser(RATE, links, library=library, smoothing=Smoothing.from_encoder(COUNTS, RATE))
    *_, (_, (said,)) = taken(diagnoser, run.time[1:], run.position[1:], run.torque[:-1])
    assert said.group == group and said.kind == ("missing" if group else "nothing")
    if group == ("quadratic_drag@elbow",):
        (found,) = (one for one in said.ranking if one.effect in group)
        assert found.theta["quadratic_drag@elbow"] == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(
    ("after", "kind", "name"),
    [
        (replace(TWO, viscous=(0.3638, 0.5)), "changed", "viscous@elbow"),
        (TwoLink(cogging=(0.0, 0.3)), "missing", "cogging@elbow"),
    ],
    ids=["parameter", "effect"],
)
def test_what_changes_in_an_arm_is_told_with_its_joint(links, after, kind, name):
    time, signal = np.arange(0.0, CHANGE + 1e-9, 1 / RATE), Multisine.paper(0, LIVELY)
    position, velocity = TWO.simulate(signal, time)
    later = np.arange(time[-1], 12.0, 1 / RATE)
    then, _ = after.simulate(signal, later, tuple(position[-1]), tuple(velocity[-1]))
    time, position = np.r_[time, later[1:]], np.r_[position, then[1:]]
    torque = signal.held(time - 1 / RATE, 1 / RATE) + 0.02 * np.random.default_rng(0).normal(size=position.shape)
    step = 2 * np.pi / COUNTS
    library = {
        f"{id}@{joint}": place_effect(effects()[id], joint) for id in ("cogging", "stribeck") for joint in JOINTS
    }
    diagnoser = Diagnoser(RATE, links, library=library, smoothing=Smoothing.from_encoder(COUNTS, RATE))
    for t, (said,) in taken(diagnoser, time, step * np.round(position / step), torque):
        assert t > CHANGE or said.kind in ("calibrating", "nothing")
    assert said.kind == kind and said.since == pytest.approx(CHANGE, abs=0.3)
    assert name in (*said.changed, *said.group)[:1]
    if kind == "changed":
        assert list(said.changed) == ["viscous@elbow"]
        assert said.changed[name][0] == pytest.approx(0.1362, rel=0.05)


# ------------------------------------------------------------------------------------------------------- wrappers


def driven(env, steps, seed=0):
    """Info after some steps under a multisine."""
    signal = Multisine.paper(seed, LIVELY)
    _, info = env.reset(seed=seed)
    for k in range(steps):
        info = env.step(signal(k / RATE))[4]
    return info


@pytest.fixture
def file(tmp_path):
    (tmp_path / "arm.urdf").write_text(gym.make(ARM).unwrapped.urdf)
    return tmp_path / "arm.urdf"


def test_an_arm_is_known_after_a_few_seconds(file):
    arm = gym.make(ARM, max_episode_steps=-1, rate=RATE, substeps=2, torque_noise=0.01)
    env, body = EstimateParameters(arm, ["filtered_dynamic", "energy"]), read_body(file)
    info = driven(env, 3000)
    friction = [value for link in TWO_LINK for value in (link.viscous, link.coulomb)]
    for found in info["estimates"].values():
        assert found["P"].shape == found["covariance"].shape == (10, 10)
        assert np.allclose([*found["theta"].values()], [*body.values, *friction], rtol=0.03, atol=0.01)
    assert 0 < info["time"] - info["estimates_time"] < 0.15
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    a, b = (driven(one, 400)["estimates"]["energy"]["theta"] for one in (env, again))
    assert a == b
    assert not any(env.reset()[1]["estimates"]["energy"]["theta"].values())


def test_a_diagnosis_knows_the_arms_effects_and_takes_one_in():
    env = gym.make(ARM, rate=500, effects="cogging@elbow=12,0.4")
    env = DiagnoseOnline(env, candidates=["cogging", "quadratic_drag@elbow"])
    assert driven(env, 3000)["diagnosis"].group == ("cogging@elbow",)
    assert env.add("cogging@elbow").id == "cogging@elbow" and env.diagnoser.diagnosis.added == ("cogging@elbow",)
    with pytest.raises(ValueError, match="unknown effect of joints 'stribek': did you mean stribeck"):
        DiagnoseOnline(gym.make(ARM), candidates="stribek")


def test_an_arm_is_diagnosed_with_a_model_of_the_same_arm(links, tmp_path):
    arm, model = gym.make(ARM, rate=500), ArmModel.build(links, np.ones(10))
    found = driven(DiagnoseOnline(arm, candidates="stribeck", model=model), 4000)["diagnosis"]
    assert found.kind == "changed" and "viscous@shoulder" in found.changed
    Model.build(BASE, np.ones(4)).save(tmp_path / "pendulum.json")
    for env, options, told in (
        (arm, {"model": tmp_path / "pendulum.json"}, "no model of an arm"),
        (gym.make(PENDULUM), {"model": model}, "the environment has a pendulum"),
        (arm, {"terms": ["viscous"]}, "viscous is at none of the joints"),
        (arm, {"robot": "no-such.urdf"}, "no-such"),
    ):
        with pytest.raises(ValueError, match=told):
            DiagnoseOnline(env, **options)
    with pytest.raises(ValueError, match="a vector of arms"):
        DiagnoseOnlineVector(gym.make_vec(ARM, num_envs=2))


def test_environments_and_files_of_other_plants_are_refused(tmp_path):
    (tmp_path / "six.urdf").write_text(six_joint.urdf())
    with pytest.raises(ValueError, match=r"joints shoulder, elbow, and .*six\.urdf base, shoulder"):
        EstimateParameters(gym.make(ARM), robot=str(tmp_path / "six.urdf"))
    with pytest.raises(ValueError, match="a vector of arms"):
        EstimateParametersVector(gym.make_vec(ARM, num_envs=2))


@pytest.mark.parametrize("wrapper", [EstimateParameters, DiagnoseOnline])
def test_all_wrappers_take_terms_of_joints_by_name(wrapper):
    names = ["viscous@shoulder", "viscous@elbow", "coulomb@elbow"]
    wrapper(gym.make(ARM, rate=RATE), terms=names).reset(seed=0)
    for term, told in (("viscos@elbow", "viscos"), ("coulomb@knee", "is at none of the joints shoulder, elbow")):
        with pytest.raises(ValueError, match=told):
            wrapper(gym.make(ARM), terms=[term])
