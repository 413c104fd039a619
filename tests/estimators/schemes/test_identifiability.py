from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import diagnose
from estimators.identification import identify
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.identifiability import ClearRows, Gap, Undetermined, find_undetermined
from estimators.signals.measurements import measure
from pendulum_env.physics import BASE, effects
from pendulum_env.physics.limits import limit_term
from pendulum_env.recording import Recording, read_recording
from tests.cases import THETA, recorded

TIME = np.arange(3000) / 500


def driven(command: np.ndarray, start: float = 0.0, **plant: float) -> Recording:
    """6 s at 500 Hz under a command."""
    return recorded(Plant(**plant), Experiment(rate=500.0, seconds=6.0, start=(start, 0.0)), commands=[command])[0]


def gaps(recording: Recording, *added: str) -> list[Gap]:
    terms = (*BASE, *(effects()[id]() for id in added))
    return [finding.gap for finding in find_undetermined([measure(recording)], terms)]


def test_nothing_is_doubted_of_a_rich_recording(paper_run):
    assert gaps(paper_run) == []
    assert gaps(paper_run, "torque_offset", "stribeck") == []


def test_a_coarse_swing_that_oscillates_has_both_directions():
    """The few samples clear of reversals are all in one direction."""
    time = np.arange(0, 8, 1 / 30)
    noise = 8e-3 * np.random.default_rng(1).standard_normal(len(time))
    swing = Recording(
        time=time, position=2.6 * np.exp(-0.5 * time) * np.cos(6 * time) + noise, torque=np.zeros(len(time))
    )
    clear = measure(swing).find_clear(0.0)
    assert len(set(np.sign(measure(swing).velocity[clear]))) == 1
    assert Gap.ONE_DIRECTION not in gaps(swing)
    with pytest.raises(
        IdentificationError, match=rf"needs {measure(swing).reach / 30:.2g} s on either side.* higher rate"
    ):
        identify([swing], schemes="energy", fixed={"gravity": 1.0})


def test_one_direction_hides_friction_behind_an_offset():
    run = driven(5.0 + np.sin(3 * TIME))
    assert gaps(run) == [Gap.ONE_DIRECTION]
    found = identify([run])
    assert found["dynamic"].withheld == {"coulomb"}
    assert found["dynamic"].json()["theta"]["coulomb"] == {"value": None, "std": None, "unit": "N m", "unknown": True}
    assert found["dynamic"].json()["theta"]["inertia"]["value"] == pytest.approx(THETA["inertia"], rel=0.02)
    assert not identify([driven(-5.0 - np.sin(3 * TIME)), run]).findings


def test_known_friction_leaves_no_doubt_in_one_direction():
    run = driven(5.0 + np.sin(3 * TIME))
    known = [limit_term(term, {"coulomb": (THETA["coulomb"],) * 2}) for term in BASE]
    assert find_undetermined([measure(run)], known) == ()
    found = identify([run], known)["dynamic"].model
    for name in ("inertia", "gravity", "viscous"):
        assert abs(found[name].value - THETA[name]) < 4 * found[name].std


def limited(id: str, limits: dict[str, float]):
    """An effect, or a base term, with known parameters."""
    term = next((term for term in BASE if term.id == id), None) or effects()[id]()
    return limit_term(term, {name: (value, value) for name, value in limits.items()})


def test_a_known_zero_of_another_friction_gives_no_scale():
    run = driven(np.where(np.arange(3000) // 750 % 2, -2.6, 2.6))
    terms = (*BASE, limited("stribeck", {"stribeck": 0.0}))
    assert Gap.TORQUE_FOLLOWS_DIRECTION in [one.gap for one in find_undetermined([measure(run)], terms)]
    heavy = [limited(term.id, {"gravity": THETA["gravity"]} if term.id == "gravity" else {}) for term in BASE]
    assert find_undetermined([measure(run)], heavy) == ()


def test_a_known_partner_determines_the_other():
    one_way = measure(driven(5.0 + np.sin(3 * TIME)))
    friction = limited("coulomb", {"coulomb": THETA["coulomb"]})
    terms = (*(term for term in BASE if term.id != "coulomb"), friction, effects()["torque_offset"]())
    assert find_undetermined([one_way], terms) == ()
    small = measure(driven(0.3 * np.sin(5 * TIME) + 0.1 * np.sin(2 * TIME), coulomb=0.05))
    weight = limited("gravity", {"gravity": THETA["gravity"]})
    terms = (*(term for term in BASE if term.id != "gravity"), weight, effects()["spring"]())
    assert Gap.SMALL_ANGLES not in [one.gap for one in find_undetermined([small], terms)]


@pytest.mark.parametrize(("fixed", "unknown"), [({}, {"inertia", "viscous", "coulomb"}), ({"coulomb": 0.0}, set())])
def test_one_step_of_a_motor_determines_parameters_only_beside_known_friction(fixed, unknown):
    """J v' + b v = tau has v = tau/b (1 - exp(-b t / J)): without known friction, friction of tau explains all."""
    inertia, viscous, torque, time = 0.006, 0.115, 12.0, np.arange(1000) / 500
    position = torque / viscous * (time - inertia / viscous * (1 - np.exp(-time * viscous / inertia)))
    run = Recording(time, np.round(position, 6), np.full(len(time), torque), name="step")
    fixed = {"gravity": 0.0, **fixed}
    found, diagnosed = identify([run], fixed=fixed), diagnose([run], fixed=fixed)
    for model in (found["dynamic"].model, found["filtered_power"].model, diagnosed.model):
        assert {name for name, estimate in model.estimates.items() if estimate.is_unknown} == unknown
        if not unknown:
            assert model["viscous"].value == pytest.approx(viscous, rel=1e-3)
            assert model["inertia"].value == pytest.approx(inertia, rel=2e-3)
    assert diagnosed.selected == ()


def test_short_strokes_between_reversals_are_determined_by_the_rows_of_a_diagnosis():
    """A cart whose force is reversed at either end of 30 mm, measured in coarse counts."""
    mass, friction, force, rate = 6.3, 2.4, 13.34, 150
    position, velocity, sign, rows = 0.0, 0.0, 1.0, []
    for k in range(20 * rate * 100):  # steps of 1 / (100 rate), Moreau's friction
        if k % 100 == 0:
            sign = -sign if position * sign > 0.015 else sign
            rows.append((position, sign * force))
        free = velocity + sign * force / mass / (100 * rate)
        velocity = np.sign(free) * max(0.0, abs(free) - friction / mass / (100 * rate))
        position += velocity / (100 * rate)
    q, tau = np.array(rows).T
    counts = np.round(q / 88e-6) * 88e-6
    columns = {"time": np.arange(len(q)) / rate, "x_m": counts, "force": tau}
    run = read_recording(columns, columns={"position": "x_m:m", "torque": "force"})
    found = diagnose(run, fixed={"gravity": 0.0})
    assert found.selected == () and not found.unexplained
    for name, value in (("inertia", mass), ("coulomb", friction)):
        assert found.model[name].value == pytest.approx(value, rel=0.15) and not found.model[name].is_unknown


def test_noise_alone_is_no_torque():
    run = driven(np.zeros(3000), 2.5, coulomb=0.02, viscous=0.01)  # whose torque is logged with noise
    assert gaps(run)[0] is Gap.TORQUE_IS_NOISE
    with pytest.raises(IdentificationError, match=r"the torque is constant or noise.*: read the file without it"):
        identify([run])
    found = identify([replace(run, torque=np.zeros(len(run)))])
    assert found.torque_unit == "rad/s^2" and not found["dynamic"].withheld


def test_torque_of_one_size_determines_only_ratios():
    switching = np.where(np.arange(3000) // 750 % 2, -2.6, 2.6)
    run = driven(switching)
    assert gaps(run) == [Gap.TORQUE_FOLLOWS_DIRECTION]
    assert all(result.withheld == set(THETA) for result in identify([run]).values())
    found = diagnose([run])
    assert (
        not found.selected and not found.unexplained and all(own.is_unknown for own in found.model.estimates.values())
    )
    x = measure(run)
    phi = np.random.default_rng(0).normal(size=(40, 4))
    phi[:, 3] = np.linspace(-1, 1, 40)  # windows that turn have averages of the direction
    averaged = ClearRows(np.sign(phi[:, 3]), 2.6 * phi[:, 3], phi)
    assert [one.gap for one in find_undetermined([x], BASE, rows=averaged)] == [Gap.TORQUE_FOLLOWS_DIRECTION]
    small = driven(1.8 * switching / 2.6)  # a second size, or a known parameter, gives the scale
    two_sizes = identify([run, small])["dynamic"].model
    for name, value in THETA.items():
        assert abs(two_sizes[name].value - value) < 4 * two_sizes[name].std
    known = [limit_term(term, {"inertia": (0.09, 0.09)}) for term in BASE]
    assert find_undetermined([measure(run)], known) == ()


def test_constant_torque_in_both_directions_determines_the_parameters():
    run = driven(np.full(3000, 0.8), -0.8, coulomb=0.05, viscous=0.02)
    assert gaps(run) == []
    truth = THETA | {"coulomb": 0.05, "viscous": 0.02}
    for name, estimate in identify([run])["filtered_power"].model.estimates.items():
        assert abs(estimate.value - truth[name]) < 4 * estimate.std


def test_small_swings_cannot_tell_gravity_from_a_spring():
    run = driven(0.3 * np.sin(5 * TIME) + 0.1 * np.sin(2 * TIME), coulomb=0.05)
    assert gaps(run)[0] is Gap.SMALL_ANGLES
    assert identify([run])["dynamic"].withheld == frozenset()  # the model has no spring
    withheld = identify([run], (*BASE, effects()["spring"]()))["dynamic"].withheld
    assert withheld >= {"gravity", "spring.stiffness"}


def moved_along(position: np.ndarray, gravity: float) -> Recording:
    """A recording of a joint that is made to move so, with white noise on the torque."""
    time = np.arange(len(position)) / 500
    velocity = np.gradient(position, time)
    torque = 0.09 * np.gradient(velocity, time) + gravity * np.sin(position) + 0.36 * velocity + 0.1 * np.sign(velocity)
    return Recording(time, position, torque + 0.1 * np.random.default_rng(0).standard_normal(len(time)), name="moved")


@pytest.mark.slow
def test_a_parameter_whose_error_alone_is_more_than_all_torque_is_not_told():
    time = np.arange(5000) / 500
    swing = 0.3 * (1 + 0.001 * np.sin(0.7 * time)) * np.sin(2 * np.pi * time)  # inertia and gravity nearly act alike
    found = identify([moved_along(swing, 2.0)])
    assert all(own.model.estimates["gravity"].std > 2.0 for own in found.schemes.values())
    assert all("gravity" in own.withheld and "viscous" not in own.withheld for own in found.schemes.values())
    (unknown,) = (
        own
        for own in found.findings
        if isinstance(own, Undetermined) and own.gap is Gap.LARGE_ERROR and own.parameters == ("gravity",)
    )
    assert unknown.size.std > 2.0


def test_a_scheme_that_cannot_tell_a_parameter_shows_none_though_another_can():
    """Constant speed to and fro: inertia acts at the corners alone."""
    time = np.arange(5000) / 500
    speed = 12.0 * np.sign(np.sin(np.pi * time + 1e-9))
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(time))
    position = np.cumsum(speed) / 500 - 6.0
    found = identify([Recording(time, position, 0.3 * speed + 0.5 * np.sign(speed) + noise, name="to and fro")])
    inertia = {id: (own.model.estimates["inertia"], "inertia" in own.withheld) for id, own in found.schemes.items()}
    assert all(withheld or one.std < abs(one.value) for one, withheld in inertia.values())


def test_a_parameter_that_is_told_to_be_nothing_is_told():
    time = np.arange(5000) / 500
    found = identify([moved_along(np.sin(2 * np.pi * time) + 0.5 * np.sin(3 * time), 0.0)])
    gravity = found["filtered_dynamic"].model.estimates["gravity"]
    assert abs(gravity.value) < 3 * gravity.std < 0.1
    assert not any(own.withheld for own in found.schemes.values())


def test_equal_columns_are_named(paper_run):
    terms = (*BASE, effects()["torque_offset"](), effects()["coulomb_asymmetry"]())
    (finding,) = find_undetermined([measure(paper_run)], terms)
    assert (finding.gap, finding.parameters) == (Gap.ACT_ALIKE, ("torque_offset", "coulomb_asymmetry"))
    assert [*finding.combination.values()] == pytest.approx([1.0, 1.0], rel=1e-6)
    assert "only torque_offset + coulomb_asymmetry is determined" in str(finding)


def test_an_effect_that_never_acts_is_named(paper_run):
    terms = (*BASE, effects()["hard_stop"](upper=90.0))
    (finding,) = find_undetermined([measure(paper_run)], terms)
    assert finding.gap is Gap.NEVER_ACTS and finding.withheld == ("hard_stop.stiffness",)


def test_a_joint_that_hardly_moves_is_refused():
    rng = np.random.default_rng(0)
    still = Recording(TIME, 1e-5 * rng.normal(size=3000), 0.1 * np.sin(TIME), name="still")
    assert gaps(still) == [Gap.NO_MOTION]
    with pytest.raises(IdentificationError, match="too little of the motion"):
        identify([still])
