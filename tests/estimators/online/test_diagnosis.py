"""What a model lacks is named while the pendulum runs, and once it is added, the model predicts as the true one does.

So is what changes while it runs. Plants come from the independent integrator; one that changes goes on from where it
was.
"""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import VectorWrapper

from benchmarks.independent_plant import Experiment, Plant, simulate
from benchmarks.online_diagnosis import CHANGE, diagnose_run, simulate_changes
from estimators.decisions.criterion import Criterion
from estimators.findings import Obstacle
from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.online.binning import Bin, PlantBins
from estimators.online.diagnosis import EffectMonitor
from estimators.online.settings import ONLINE
from estimators.signals.measurements import Smoothing
from estimators.wrappers import DiagnoseOnline, DiagnoseOnlineVector, EstimateParameters
from pendulum_env.physics import BASE, Model, effects
from pendulum_env.physics.actuation import ActuatorLag, DeadTime, TorqueOffset
from pendulum_env.physics.friction import QuadraticDrag, Stribeck
from pendulum_env.physics.joints import FRICTION, get_coupling, place_effect, place_term
from pendulum_env.physics.library import effect
from pendulum_env.physics.potential import Cogging
from pendulum_env.plant import PAPER
from pendulum_env.registration import PENDULUM
from pendulum_env.units import JointUnits
from tests import cases, slow
from tests.feeding import feed, play_two_tones

RATE, COUNTS, SECONDS = 250.0, 65_536, 18.0
HIDDEN = {
    "stribeck": ({"strib_d": 0.4, "strib_v": 0.6}, Stribeck(0.6)),
    "cogging": ({"cog_n": 12.0, "cog_s": 0.2, "cog_c": 0.1}, Cogging(12.0)),
    "torque_offset": ({"offset": 0.2}, TorqueOffset()),
    "quadratic_drag": ({"drag": 0.03}, QuadraticDrag()),
    "actuator_lag": ({"lag_T": 0.012}, ActuatorLag(0.012)),
    "dead_time": ({"dead_n": 3.0}, DeadTime(0.012)),
}

SOME = ("load_dependent_friction", "coulomb_asymmetry", "spring", "position_dependent_friction", "viscous_asymmetry")
BACKLASH = {"Jm": 0.04, "bl_gap": 0.02, "bl_k": 300.0, "bl_d": 0.6}
FEW = {id: effect(id) for id in (*HIDDEN, *SOME)}


@cache
def recorded(hidden):
    experiment = Experiment(rate=RATE, seconds=SECONDS, counts=COUNTS, torque_noise=0.05, seed=3)
    return cases.recorded(Plant(effects={hidden: HIDDEN[hidden][0]} if hidden else {}), experiment)[0]


def diagnoser(terms=BASE, **options):
    return Diagnoser(RATE, terms, smoothing=Smoothing.from_encoder(COUNTS, RATE), **options)


def run(one, recording, first=0.0, last=SECONDS):
    """What it says in the end of the samples from `first` to `last` [s]."""
    return feed(one, recording, round(first * RATE), round(last * RATE))[-1][0]


@pytest.mark.parametrize("hidden", slow.but(["cogging"], HIDDEN))
def test_what_is_hidden_comes_first_and_once_added_the_model_predicts_as_the_true_one_does(hidden):
    recording = recorded(hidden)
    found, true = diagnoser(library=FEW), diagnoser((*BASE, HIDDEN[hidden][1]), library={})
    said = run(found, recording, last=10.0)
    assert said.kind == "missing" and hidden in said.group and said.none < 0.01
    before = said.error
    found.each[0].add(hidden)
    after, ideal = run(found, recording, first=10.0), run(true, recording)
    assert after.added == (hidden,) and after.kind == "nothing"
    assert after.error < 0.9 * before
    assert after.error == pytest.approx(ideal.error, rel=0.1)


@pytest.mark.parametrize("hidden", ["actuator_lag", "dead_time"])
def test_a_late_torque_is_named_with_its_time(hidden):
    """The other of the two, with the same time, may predict equally well; no other effect does."""
    said = run(diagnoser(), recorded(hidden))
    assert said.kind == "missing" and hidden in said.group and set(said.group) <= {"actuator_lag", "dead_time"}
    (time,) = next(entry.term for entry in said.ranking if entry.effect == hidden).nonlinear_values.values()
    assert time == pytest.approx(0.012, abs=0.0005)


def test_a_lag_gains_nothing_by_smoothing_noise_of_the_torque():
    experiment = Experiment(rate=RATE, seconds=SECONDS, counts=COUNTS, torque_noise=0.5, seed=3)
    said = run(
        diagnoser(library={id: effect(id) for id in ("actuator_lag", "dead_time")}),
        cases.recorded(Plant(), experiment)[0],
    )
    assert said.kind == "nothing" and max(entry.gain for entry in said.ranking) < 3.0


@pytest.mark.parametrize(
    "hidden",
    slow.but_first([{"backlash": BACKLASH}, {"joint_flexibility": {"Jm": 0.03, "bl_k": 60.0, "bl_d": 0.2}}]),
    ids=lambda hidden: next(iter(hidden)),
)
def test_an_error_that_no_effect_explains_is_unexplained(hidden):
    """Effects with a memory of the motion have no online diagnosis, and no other effect is named in their place."""
    experiment = Experiment(rate=RATE, seconds=SECONDS, counts=COUNTS, torque_noise=0.05, seed=3)
    said = run(diagnoser(), cases.recorded(Plant(effects=hidden), experiment)[0])
    assert said.kind == "unexplained" and not said.group
    assert said.error > 5 * said.floor > 0


def test_one_of_two_effects_is_named_and_something_remains_until_it_is_added():
    experiment = Experiment(rate=RATE, seconds=SECONDS, counts=COUNTS, torque_noise=0.02, seed=3)
    recording = cases.recorded(Plant(effects={id: HIDDEN[id][0] for id in ("quadratic_drag", "cogging")}), experiment)[
        0
    ]
    one = diagnoser(library=FEW)
    said = run(one, recording, last=8.0)
    assert said.kind == "missing" and said.group == ("cogging",) and said.remains
    assert said.ranking[0].residual > 2.5 * said.floor
    one.each[0].add("cogging")
    said = run(one, recording, first=8.0)
    assert said.kind == "missing" and "quadratic_drag" in said.group and not said.remains


def test_the_floor_is_the_error_of_the_true_model():
    said = run(diagnoser(), recorded(""))
    assert said.floor == pytest.approx(said.error, rel=0.25)


@cache
def diagnosed_at_random(hidden, library, **options):
    """Diagnosis with a torque that is drawn anew for each sample, as from `env.action_space.sample()`."""
    experiment = Experiment(rate=RATE, seconds=12.0, counts=COUNTS, torque_noise=0.02, seed=3)
    time = np.arange(experiment.samples) / RATE
    command = np.random.default_rng(0).uniform(-6.0, 6.0, experiment.samples) + 3.0 * np.sin(2.25 * time)
    plant = Plant(effects={hidden: HIDDEN[hidden][0]} if hidden else {})
    (measured,) = simulate([(plant, experiment)], [command])
    return run(diagnoser(library={id: FEW[id] for id in library}, **options), measured, last=12.0)


def test_a_random_torque_is_no_noise():
    said = diagnosed_at_random("", tuple(FEW))
    assert said.kind == "nothing" and 0.5 * said.error < said.floor < 2.0 * said.error
    said = diagnosed_at_random("torque_offset", ("quadratic_drag",))
    assert said.kind == "unexplained" and not said.group and said.floor < 0.4 * said.error
    assert diagnosed_at_random("dead_time", tuple(FEW)).group == ("dead_time",)


def test_the_misfit_of_a_criterion_decides_which_error_is_unexplained():
    said = diagnosed_at_random("torque_offset", ("quadratic_drag",), criterion=Criterion(misfit_ratio=100.0))
    assert said.kind == "nothing" and said.error > 2.5 * said.floor


def test_without_noise_an_effect_is_named_up_to_the_error_of_discretisation():
    experiment = Experiment(rate=RATE, seconds=12.0, counts=0, torque_noise=0.0, seed=3)
    measured = cases.recorded(Plant(effects={"dead_time": HIDDEN["dead_time"][0]}), experiment)[0]
    said = run(diagnoser(library=FEW), measured, last=12.0)
    assert said.kind == "missing" and said.group == ("dead_time",)
    assert said.ranking[0].term.delay == pytest.approx(0.012, abs=0.0005)


def test_effects_that_no_motion_tells_apart_are_one_group_and_say_the_same():
    said = run(diagnoser(library=FEW), recorded("torque_offset"), last=12.0)
    assert {"torque_offset", "coulomb_asymmetry"} <= set(said.group)
    one, other = (next(s for s in said.ranking if s.effect == e) for e in ("torque_offset", "coulomb_asymmetry"))
    assert one.gain == pytest.approx(other.gain, rel=1e-6)
    assert abs(one.theta["torque_offset"]) == pytest.approx(0.2, rel=0.05)


def test_friction_of_a_gear_that_grows_with_the_load_is_named_with_its_size():
    """Its coefficient at the output is zero, a bound, and while the motor drives, the other scales all parameters."""
    plant = Plant(effects={"load_dependent_friction": {"load_mu": 0.08}})
    experiment = Experiment(rate=RATE, seconds=12.0, counts=COUNTS, torque_noise=0.05, seed=4)
    one = diagnoser()
    last = run(one, cases.recorded(plant, experiment)[0], last=12.0)
    assert last.kind == "missing" and last.group == ("load_dependent_friction",)
    theta = last.ranking[0].theta
    assert theta["load_dependent_friction"] == pytest.approx(0.08, rel=0.05)
    assert theta["gravity"] == pytest.approx(plant.gravity, rel=0.01)


def test_where_nothing_is_hidden_nothing_is_missing():
    assert run(diagnoser(), recorded("")).kind == "nothing"


HEAVIER = Plant(inertia=0.12, gravity=2.5)
CHANGED = {
    "viscous": (Plant(viscous=0.42), {"viscous": 0.07}),
    "payload": (HEAVIER, {"inertia": 0.03, "gravity": 0.5}),
}


def sets_in(plant, seconds):
    """Run of a plant that becomes another one at 10 s."""
    experiment = Experiment(rate=RATE, seconds=seconds, counts=COUNTS, torque_noise=0.05, seed=3)
    return simulate_changes({0.0: Plant(), CHANGE: plant}, experiment)


@pytest.mark.parametrize("what", CHANGED)
def test_parameters_that_change_are_reported_with_size_and_time(what):
    plant, changes = CHANGED[what]
    told = diagnose_run(sets_in(plant, 5.0), diagnoser(library=FEW))
    assert {said.kind for t, said in told if t < CHANGE} == {"calibrating", "nothing"}
    last = told[-1][1]
    assert last.kind == "changed" and set(last.changed) == set(changes) and not last.group
    assert last.since == pytest.approx(CHANGE, abs=0.2)
    for name, true in changes.items():
        change, std = last.changed[name]
        assert 0 < std < 0.1 * true and abs(change - true) < 3 * std


def test_an_effect_that_sets_in_is_named_and_no_parameter_is():
    told = diagnose_run(sets_in(Plant(effects={"cogging": HIDDEN["cogging"][0]}), 5.0), diagnoser(library=FEW))
    last = told[-1][1]
    assert any(said.group == ("cogging",) for t, said in told if t < CHANGE + 5.0)
    assert last.kind == "missing" and last.group == ("cogging",) and not last.changed
    assert last.since == pytest.approx(CHANGE, abs=0.2)
    assert last.ranking[0].theta["cogging.sin"] == pytest.approx(-0.2, rel=0.1)  # on the left-hand side


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [5.0, 13.0])
def test_a_second_change_is_reported_too(seconds):
    """A payload is picked up at 10 s, and put down some seconds later; no effect is missing at any time."""
    plants = {0.0: Plant(), CHANGE: HEAVIER, CHANGE + seconds: Plant()}
    experiment = Experiment(rate=RATE, seconds=5.0, counts=COUNTS, torque_noise=0.05, seed=3)
    told = [said for _, said in diagnose_run(simulate_changes(plants, experiment), diagnoser(library=FEW))]
    assert {said.kind for said in told} == {"calibrating", "nothing", "changed"}
    last = {said.since: said.changed["inertia"] for said in told if said.kind == "changed"}
    (first, (one, _)), (second, (other, _)) = last.items()
    assert first == pytest.approx(CHANGE, abs=0.2) and second == pytest.approx(CHANGE + seconds, abs=0.2)
    assert one == pytest.approx(0.03, rel=0.05) and other == pytest.approx(-0.03, rel=0.05)


def test_a_given_model_is_compared_in_its_unit_and_without_its_unknown_parameters(tmp_path):
    theta = PAPER | {"gravity": 1.6, "viscous": 0.5}
    model = Model.build(BASE, np.array(list(theta.values())))
    env = DiagnoseOnline(gym.make(PENDULUM, rate=200), candidates="cogging", model=model.mark_unknown({"viscous"}))
    env.reset(seed=0)
    *_, info = play_two_tones(env, 2400)
    assert info["diagnosis"].kind == "changed" and set(info["diagnosis"].changed) == {"gravity"}
    assert info["diagnosis"].changed["gravity"][0] == pytest.approx(PAPER["gravity"] - 1.6, rel=0.05)
    model.convert_units(JointUnits("A")).save(tmp_path / "current.json")
    with pytest.raises(ValueError, match="per A, but the environment measures torque in N m"):
        DiagnoseOnline(gym.make(PENDULUM), model=tmp_path / "current.json")


def test_undo_brings_the_model_back():
    recording, whole = recorded("cogging"), diagnoser(library=FEW)
    (one,) = whole.each
    for call, why in ((one.undo, "no added effect"), (lambda: one.add("cogging"), "has not been tried yet")):
        with pytest.raises(ValueError, match=why):
            call()
    first = run(whole, recording, last=10.0)
    one.add("cogging")
    for id, why in (("cogging", "in the model already"), ("coging", "did you mean cogging")):
        with pytest.raises(ValueError, match=why):
            one.add(id)
    one.undo()
    again = run(whole, recording, first=10.0, last=17.0)
    assert again.terms == first.terms == BASE
    assert again.group[0] == first.group[0] == "cogging"


def test_a_wrapper_diagnoses_beside_others_and_adds():
    env = EstimateParameters(gym.make(PENDULUM, rate=200, effects=["gravity_tilt:gravity_tilt=0.3"]), schemes="dynamic")
    env = DiagnoseOnline(env, candidates=["gravity_tilt", "quadratic_drag", "presliding"])
    env = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    _, info = env.reset(seed=0)
    assert set(info["diagnosis"].not_run) == {"presliding"}
    *_, info = play_two_tones(env, 1500)
    assert info["diagnosis"].group == ("gravity_tilt",)
    env.get_wrapper_attr("add")("gravity_tilt")
    *_, info = play_two_tones(env, 1500, first=1500)
    said = info["diagnosis"]
    assert said.added == ("gravity_tilt",) and "dynamic" in info["estimates"]
    assert said.kind == "nothing" and said.theta["gravity_tilt"] == pytest.approx(0.3, rel=0.05)
    _, info = env.reset()
    assert info["diagnosis"].added == () and info["diagnosis"].kind == "calibrating"


def test_what_cannot_be_followed_is_refused():
    for options, why in (
        ({"terms": ["inertia", "presliding"]}, "presliding depends on the past"),
        ({"candidates": ["stribek"]}, "did you mean stribeck"),
        ({"candidates": "backlash"}, "no candidate has an online diagnosis: backlash .depends on the past"),
        ({"rate": np.nan}, "give a positive number"),
        ({"model": Model.build(BASE[1:], 0.5)}, "lacks the term inertia"),
        ({"alarms_per_hour": 0.0}, "alarms_per_hour"),
    ):
        with pytest.raises(ValueError, match=why):
            DiagnoseOnline(gym.make(PENDULUM), **options)
    with pytest.raises(ValueError, match="coupling@first,second depends on the past"):
        Diagnoser(1000.0, [get_coupling("first,second", False)()])


class OneWithout(VectorWrapper):
    """The last environment says nothing, as Gymnasium's masks tell it; what stands in its places is of no meaning."""

    def step(self, actions):
        *result, info = self.env.step(actions)
        told = np.arange(self.num_envs) < self.num_envs - 1
        return *result, {**info, **{f"_{name}": told for name in ("time", "position", "torque")}}


def test_a_vector_twin_diagnoses_each_and_leaves_out_what_was_not_measured():
    env = OneWithout(gym.make_vec(PENDULUM, num_envs=3, rate=200.0, effects=["torque_offset=0.3"]))
    env = DiagnoseOnlineVector(env, candidates=["torque_offset"])
    env.reset(seed=0)
    *_, info = play_two_tones(env, 1200)
    assert [said.group for said in info["diagnosis"]] == [("torque_offset",), ("torque_offset",), ()]
    env.diagnoser.reset(np.array([True, False, False]))
    assert [said.kind for said in env.diagnoser.diagnoses] == ["calibrating", "missing", "calibrating"]


def bins_of_two_joints(first, last):
    """Bins of two joints with friction, drag at the second, which begins to move after six seconds."""
    rng = np.random.default_rng(0)
    for joint, begin in ((j, k / 100) for k in range(first, last) for j in range(2 if k > 600 else 1)):
        t = begin + 1e-3 * np.arange(13)
        way = 1.0 if int(begin / 0.4) % 2 else -1.0
        speed = way * (2.0 + np.sin((5.0 + 2.0 * joint) * t))
        load = 0.3 * speed + 0.5 * way + 0.1 * joint * speed * np.abs(speed)
        series = np.array([t, np.cos(t), speed, load])
        torque, slices = float(load[2:-1].mean()) + 0.01 * rng.normal(), np.zeros(5 * (ONLINE.bins.history + 1))
        yield Bin(joint, series, np.zeros(0), torque, slices)


def test_a_joint_that_moves_later_is_diagnosed_from_then_on():
    joints = "first", "second"
    terms = [place_term(term, joint) for joint in joints for term in FRICTION]
    library = {f"quadratic_drag@{joint}": place_effect(effects()["quadratic_drag"], joint) for joint in joints}
    plant, blank = PlantBins(joints, 1e-3, 10, Smoothing(2)), OnlineDiagnosis("calibrating", threshold=10.0)
    monitor = EffectMonitor(terms, library, plant, blank, Criterion())
    for one in bins_of_two_joints(1, 590):
        monitor.take(one)
    monitor.finish()
    said = monitor.diagnosis
    assert said.kind == "nothing" and said.not_run["quadratic_drag@second"] is Obstacle.JOINT_AT_REST
    for one in bins_of_two_joints(590, 1390):
        monitor.take(one)
    monitor.finish()
    said = monitor.diagnosis
    assert said.group == ("quadratic_drag@second",) and not said.not_run
    assert said.ranking[0].theta["quadratic_drag@second"] == pytest.approx(0.1, rel=0.05)
    assert len(repr(said)) < 400 and "\n" not in repr(said)
