"""An arm while it runs: estimated, diagnosed and watched, in motion of SciPy's integrator and of the environment."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import six_joint
from benchmarks.two_link import Multisine, TwoLink
from estimators import identify
from estimators.arms.online import ArmBinner, ArmEstimator
from estimators.online import Diagnoser, Watch
from estimators.schemes import six
from estimators.schemes.balance import for_arms
from estimators.schemes.six import SCHEMES, Integral
from estimators.signals.measurements import Smoothing
from estimators.wrappers import (
    DiagnoseOnline,
    EstimateParameters,
    EstimateParametersVector,
    WatchModel,
    WatchModelVector,
)
from pendulum_env import ARM, PENDULUM
from pendulum_env.arms.body import read_body
from pendulum_env.arms.joints import arm_base, at_joint
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.planar import TWO_LINK
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import BASE, Model, effects
from tests.two_link import recorded

RATE, COUNTS, CHANGE = 500.0, 65_536, 7.0
TWO = TwoLink()
LIVELY = (5.0, 2.5)


@pytest.fixture(scope="module")
def recording():
    return recorded(seconds=5.0, rate=RATE, scale=LIVELY, noise=0.01)


@pytest.fixture
def links(body):
    return arm_base(body)


def fed(estimator, recording):
    for sample in zip(recording.time, recording.position, recording.torque, strict=True):
        estimator.update(*sample)
    return estimator


def taken(monitor, time, position, held):
    """What a monitor says in the end of samples (N,) and of the torque held over the period before each."""
    for t, q, u in zip(time, position, held, strict=True):
        (said,) = monitor.take(np.array([t]), q[None], u[None])
        yield t, said


@pytest.mark.parametrize("scheme", for_arms(SCHEMES), ids=lambda scheme: scheme.id)
def test_online_and_offline_agree(body, recording, scheme):
    online = fed(ArmEstimator(body, RATE, scheme=scheme), recording)
    truth = np.concatenate([body.values, np.ravel(np.column_stack([TWO.viscous, TWO.coulomb]))])
    some = np.abs(truth) > 1e-9
    assert np.abs(online.state.theta[some] / truth[some] - 1).max() < 0.02
    offline = identify(recording, arm_base(body), [scheme])[scheme.id].model.theta
    assert np.allclose(online.state.theta, offline, rtol=0.02, atol=2e-3)
    assert online.model.estimates["coulomb@elbow"].value == pytest.approx(TWO.coulomb[1], rel=0.02)


def test_each_row_is_used_once_but_for_those_of_the_first_and_last_moments(body, recording):
    online = fed(ArmEstimator(body, RATE, scheme=six.scheme("hamiltonian")), recording)
    offline = identify(recording, arm_base(body), [six.scheme("hamiltonian")])["hamiltonian"]
    information = np.diag(np.linalg.inv(online.state.P))
    rows = information[[7, 9]].sum()  # a Coulomb column is +-1 on each row of its joint
    assert 0.9 * offline.used[0] < rows < 1.001 * offline.used[0]


def test_nothing_is_told_across_a_gap_or_a_sample_that_is_no_number(body, recording):
    nan, kept = np.array(recording.torque), np.arange(len(recording)) != 1250
    nan[1250, 0] = np.nan
    whole, cut, apart = (ArmEstimator(body, RATE) for _ in range(3))
    fed(whole, recording)
    for estimator, torque, use in ((cut, nan, slice(None)), (apart, recording.torque, kept)):
        for sample in zip(recording.time[use], recording.position[use], torque[use], strict=True):
            estimator.update(*sample)
    assert np.array_equal(cut.state.theta, apart.state.theta)
    assert not np.array_equal(cut.state.theta, whole.state.theta)
    assert np.allclose(cut.state.theta, whole.state.theta, rtol=0.02, atol=2e-3)


def test_samples_and_schemes_that_make_no_sense_are_refused_at_once(body):
    online = ArmEstimator(body, RATE)
    online.update(0.0, np.zeros(2), np.zeros(2))
    for time, count, told in (
        (0.002, 3, r"2 joints has as many positions and torques, not those of shapes \(3,\)"),
        (0.0, 2, "a sample of 0 s comes after one of 0 s: reset where time begins anew"),
        (0.004, 2, r"samples come every 0.004 s, not at 500 Hz: pass rate="),
    ):
        with pytest.raises(ValueError, match=told):
            online.update(time, np.zeros(count), np.zeros(2))
    for time in (0.002, 0.004, 0.1, 0.102):  # what was refused has not moved the clock; once it is known, 0.1 is a gap
        online.update(time, np.zeros(2), np.zeros(2))
    for scheme in (six.scheme("hamiltonian", borrows="dynamic"), six.scheme("energy", operator=Integral(None))):
        with pytest.raises(ValueError, match="cannot run on an arm"):
            ArmEstimator(body, RATE, scheme=scheme)


@pytest.mark.parametrize(
    ("plant", "group"),
    [
        (TwoLink(), ()),
        (TwoLink(drag=(0.0, 0.05)), ("quadratic_drag@elbow",)),
        (TwoLink(cogging=(0.4, 0.0)), ("cogging@shoulder",)),
    ],
    ids=["none", "drag", "cogging"],
)
def test_what_is_missing_is_told_with_its_joint(links, plant, group):
    run = recorded(plant, seconds=9.0, rate=RATE, scale=LIVELY, counts=COUNTS)
    binner = ArmBinner(links[:1], Smoothing.of_encoder(COUNTS, RATE), RATE)
    names = ("quadratic_drag", "cogging", "stribeck", "torque_offset")
    library = {f"{id}@{joint}": at_joint(effects()[id], joint) for id in names for joint in run.names}
    diagnoser = Diagnoser(RATE, links, library=library, binner=binner)
    *_, (_, said) = taken(diagnoser, run.time[1:], run.position[1:], run.torque[:-1])
    assert said.group == group and said.kind == ("missing" if group else "nothing")
    if group == ("quadratic_drag@elbow",):
        (found,) = (one for one in said.ranking if one.effect in group)
        assert found.theta["quadratic_drag@elbow"] == pytest.approx(0.05, rel=0.15)


@pytest.fixture(scope="module")
def before():
    """An arm up to the change, and where it is then."""
    time, signal = np.arange(0.0, CHANGE + 1e-9, 1 / RATE), Multisine.paper(0, LIVELY)
    return time, signal, *TWO.simulate(signal, time)


@pytest.mark.parametrize(
    ("after", "kind"),
    [
        (TWO, "predicts"),
        (replace(TWO, viscous=(0.3638, 0.5)), "value"),
        (TwoLink(cogging=(0.0, 0.3)), "structure"),
    ],
    ids=["none", "value", "structure"],
)
def test_what_changes_in_an_arm_is_told_with_its_joint(links, before, after, kind):
    time, signal, position, velocity = before
    later = np.arange(time[-1], 12.0, 1 / RATE)
    then, _ = after.simulate(signal, later, tuple(position[-1]), tuple(velocity[-1]))
    time, position = np.r_[time, later[1:]], np.r_[position, then[1:]]
    torque = signal.held(time - 1 / RATE, 1 / RATE) + 0.02 * np.random.default_rng(0).normal(size=position.shape)
    step = 2 * np.pi / COUNTS
    watch = Watch(RATE, links, calibrate=4.0, binner=ArmBinner(links, Smoothing.of_encoder(COUNTS, RATE), RATE))
    for t, said in taken(watch, time, step * np.round(position / step), torque):
        assert t > CHANGE or not said.alarms
    assert said.kind == kind
    if kind == "predicts":
        assert said.alarms == 0
    elif kind == "value":
        assert list(said.changes) == ["viscous@elbow"] and said.since == pytest.approx(CHANGE, abs=0.3)
        assert said.changes["viscous@elbow"][0] == pytest.approx(0.1362, rel=0.05)
    else:
        assert said.where and all(place.endswith("@elbow") for place in said.where)


# ------------------------------------------------------------------------------------------------------- wrappers


def driven(env, steps, seed=0):
    """Info after some steps under a multisine, and time, positions and torques of all."""
    signal, samples = Multisine.paper(seed, LIVELY), []
    _, info = env.reset(seed=seed)
    for k in range(steps):
        time, position = info["time"], info["position"]
        info = env.step(signal(k / RATE))[4]
        samples.append((time, position, info["torque"]))
    return info, [np.array(series) for series in zip(*samples, strict=True)]


@pytest.fixture
def file(tmp_path):
    (tmp_path / "arm.urdf").write_text(gym.make(ARM).unwrapped.urdf)
    return tmp_path / "arm.urdf"


def test_an_arm_is_known_after_a_few_seconds_as_well_as_from_its_recording(file):
    arm = gym.make(ARM, max_episode_steps=-1, rate=RATE, substeps=2, torque_noise=0.01)
    env, body = EstimateParameters(arm, ["filtered_dynamic", "energy"]), read_body(file)
    info, samples = driven(env, 3000)
    offline = identify(ArmRecording.of("run", body.joints, *samples), arm_base(body))
    friction = [value for link in TWO_LINK for value in (link.viscous, link.coulomb)]
    for scheme, found in info["estimates"].items():
        assert len(found) == len(list(found)) and "theta" in repr(found)
        assert found["P"].shape == (10, 10) and info["parameters"] == tuple(offline[scheme].model.estimates)
        assert np.allclose(found["theta"], offline[scheme].model.theta, rtol=0.02, atol=5e-3)
        assert np.allclose(found["theta"], [*body.values, *friction], rtol=0.03, atol=0.01)
    assert not env.reset()[1]["estimates"]["energy"]["theta"].any()


def test_spec_rebuilds_it_and_the_picture_shows_what_is_known():
    env = EstimateParameters(gym.make(ARM, rate=RATE, render_mode="rgb_array"), "dynamic")
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    a, b = (driven(one, 400)[0]["estimates"]["dynamic"]["theta"] for one in (env, again))
    np.testing.assert_array_equal(a, b)
    shown = env.render()
    env.unwrapped.overlay = tuple
    assert (shown != env.render()).sum() > 500


def test_a_diagnosis_knows_the_arms_effects_and_takes_one_in():
    env = gym.make(ARM, rate=500, effects="cogging@elbow=12,0.4")
    env = DiagnoseOnline(env, candidates=["cogging", "quadratic_drag@elbow"])
    assert driven(env, 3000)[0]["diagnosis"].group == ("cogging@elbow",)
    assert env.add("cogging@elbow").id == "cogging@elbow" and env.diagnoser.said.added == ("cogging@elbow",)
    with pytest.raises(ValueError, match="unknown effect of joints 'stribek': did you mean stribeck"):
        DiagnoseOnline(gym.make(ARM), candidates="stribek")


def test_an_arm_is_watched_by_a_model_of_the_same_arm(links, body, tmp_path):
    assert driven(WatchModel(gym.make(ARM, rate=500), calibrate=1.0), 1200)[0]["watch"].kind == "predicts"
    arm, model = gym.make(ARM, rate=500), ArmModel.build(links, np.ones(10))
    assert WatchModel(arm, model).reset(seed=0)[1]["watch"].kind == "calibrating"
    Model.build(BASE, np.ones(4)).save(tmp_path / "pendulum.json")
    for watched, options, told in (
        (arm, {"model": tmp_path / "pendulum.json"}, "no model of an arm"),
        (gym.make(PENDULUM), {"model": model}, "what is watched is a pendulum"),
        (arm, {"terms": ["viscous"]}, "viscous is at none of the joints"),
        (arm, {"robot": "no-such.urdf"}, "no-such"),
    ):
        with pytest.raises(ValueError, match=told):
            WatchModel(watched, **options)
    with pytest.raises(ValueError, match="one by one"):
        WatchModelVector(gym.make_vec(ARM, num_envs=2))


def test_environments_and_files_of_other_plants_are_refused(tmp_path):
    (tmp_path / "six.urdf").write_text(six_joint.urdf())
    with pytest.raises(ValueError, match=r"joints shoulder, elbow, and .*six\.urdf base, shoulder"):
        EstimateParameters(gym.make(ARM), robot=str(tmp_path / "six.urdf"))
    with pytest.raises(ValueError, match="one by one"):
        EstimateParametersVector(gym.make_vec(ARM, num_envs=2))
    with pytest.raises(ValueError, match="forgetting: is of a pendulum"):
        EstimateParameters(gym.make(ARM), forgetting=0.99)


@pytest.mark.parametrize("wrapper", [EstimateParameters, WatchModel, DiagnoseOnline])
def test_all_wrappers_take_terms_of_joints_by_name(wrapper):
    names = ["viscous@shoulder", "viscous@elbow", "coulomb@elbow"]
    wrapper(gym.make(ARM, rate=RATE), terms=names).reset(seed=0)
    for term, told in (("viscos@elbow", "viscos"), ("coulomb@knee", "is at none of the joints shoulder, elbow")):
        with pytest.raises(ValueError, match=told):
            wrapper(gym.make(ARM), terms=[term])
