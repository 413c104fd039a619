"""Servos fitted and diagnosed in the loop: parameters of an independent plant come back, and what hides in it."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import servos
from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import add, compare, diagnose, identify
from estimators.arguments import apply_limits
from estimators.checks.torque_constant import UnknownConstant
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import LoopLimits
from estimators.diagnosis.case import Trial
from estimators.diagnosis.options import Options
from estimators.findings import Quantity
from estimators.selection.search import SearchResult
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE, Estimate, Model, effects
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.friction import TemperatureDependentFriction
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording, RecordingError, Source, read_recording, write_recording, write_study
from pendulum_env.recording.channel import Load
from robots.servos import ServoDrive
from robots.servos.case import SERVO
from robots.servos.conclusion import ScaledTorque, UnknownSpeedRate, find_torque_scale
from robots.servos.goal_reading import reread_goals
from robots.servos.in_loop import complete_drives, decide_conventions
from robots.servos.in_loop.conventions import ControllerConvention, GoalConvention, UnseenCounts
from robots.servos.in_loop.fit import fit_rollouts
from robots.servos.in_loop.likelihood import compute_log_likelihood
from robots.servos.in_loop.linearisation import linearise_errors
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.servos import are_driven
from robots.servos.in_loop.settings import LOOP
from robots.servos.refit import make_data
from tests import slow
from tests.notes import list_notes
from workbench.cli import main
from workbench.narrator.diagnosis import describe_result

TRUE = {"inertia": 0.012, "gravity": 0.9, "viscous": 0.05, "coulomb": 0.08}
FEW = [id for id in effects() if id in ("stribeck", "load_dependent_friction", "cogging", "viscous_asymmetry")]
TYPICAL = np.array([1e-3, 0.05, 5e-3, 0.01, 0.01])
CONVENTIONS: dict[str, Any] = {"goal": "ramp", "reads": "counts"}  # of `recorded`; declared, no fit has to decide
MODEL, TILTED = Model.build(BASE, list(TRUE.values())), (*BASE, GravityTilt())


def list_laws(findings):
    """Findings on laws of controllers."""
    return [own for own in findings if isinstance(own, ControllerConvention) and not own.is_of_position]


def with_goals(recordings: list[Recording], is_held: bool) -> tuple[Recording, ...]:
    """Recordings whose drives declare their goals as held from row to row, or as running on."""
    return complete_drives(recordings, {"goal": "held" if is_held else "ramp"})


def recorded(
    hidden: dict[str, dict[str, float]], gains: tuple[float, ...] = (2.5, 5.0, 8.0), **declared: Any
) -> list[Recording]:
    """Goals and positions of a servo whose controller looks a thousand times a second, logged at 125 Hz."""
    servo, found = {"counts": 4096, "torque_limit": 6.0, "control": "servo"}, []
    for k, gain in enumerate(gains):
        experiment = Experiment(1000.0, 8.0, "pd_loop", 0.5, 7 + k, gains=(gain, 0.0), **servo)
        (run,) = simulate([(Plant(*TRUE.values(), hidden), experiment)])
        drive = ServoDrive(output="torque", kp=gain, limit=6.0, rate=1000.0, **declared)
        time, position, goal = run.time[::8], run.position[::8], run.goal[::8]
        ones = np.ones(len(time))
        torque = drive.torque(goal, position, 0 * ones, ones, ones)
        found.append(Recording(time, position, torque, reference=goal, drive=drive, name=f"gain-{k}"))
    return found


@pytest.fixture(scope="module")
def plain() -> list[Recording]:
    return recorded({})


@pytest.fixture(scope="module")
def known() -> list[Recording]:
    return recorded({}, **CONVENTIONS)


@pytest.fixture(scope="module")
def pressed() -> list[Recording]:
    return recorded({"load_dependent_friction": {"load_mu": 0.0, "load_w": 0.0, "load_out": 0.3}}, **CONVENTIONS)


@pytest.fixture(scope="module")
def rubbed() -> list[Recording]:
    return [under_voltage(kp, k, rubs=0.25) for k, kp in enumerate((2.0, 4.0, 3.0))]


@pytest.fixture
def rollouts(plain) -> Rollouts:
    return Rollouts(with_goals(plain[:2], False))


@pytest.mark.parametrize("asked", [{"max_torque": 2.0}, {"max_angle": 1.0}])
def test_bounds_of_an_experiment_are_refused_in_the_loop(plain, asked):
    with pytest.raises(ValueError, match="leave them out"):
        diagnose(plain, **asked)


def test_rows_around_a_fit_are_derivatives_of_simulations(rollouts: Rollouts):
    rollouts = rollouts.without_counts  # counts change by steps
    data = make_data(RolloutRows(rollouts, RegressionData.from_recordings(rollouts.recordings).torque))
    terms, theta = data.maker.fit(TILTED)
    np.testing.assert_allclose(data.residual(terms), data.residual(terms, theta), atol=1e-9)
    nearby = theta * (1.0 + 5e-3 * np.array([1, -1, 1, -1, 1]))
    simulated, linear = data.residual(terms, nearby), data.equations(terms).error(nearby)
    changed = np.std(simulated - data.residual(terms))
    assert np.std(simulated - linear) < 0.3 * changed  # a servo that sticks elsewhere is not linear


@pytest.mark.slow
def test_a_law_without_a_name_is_kept_as_a_table_of_a_servo():
    rubs = recorded({"friction_spot": {"spot_f": 0.08, "spot_q": 0.3, "spot_w": 0.2}}, **CONVENTIONS)
    added = add(MODEL, "friction_by_angle", rubs[:2], rubs[2:])
    assert added.objection is None and added.after.errors["holdout"].is_of_motion
    before, after = (step.errors["holdout"].motion for step in (added.before, added.after))
    assert after < 0.5 * before
    curve = added.after.model.tables["friction_by_angle"][1]
    assert abs(curve.x[np.argmax(curve.value)] - 0.3) < 0.1


def test_parameters_come_back_from_goals_and_positions(plain):
    found = diagnose(plain[:2], plain[2:], only=FEW)
    assert describe_result(found) == "Nothing is missing" and found.steps[0].errors["holdout"].is_of_motion
    for name, value in TRUE.items():
        own = found.model.estimates[name]
        assert own.value == pytest.approx(value, rel=0.02)
        assert abs(own.value - value) < 5 * own.std + 0.002 * value  # the two simulators differ by a bit
    assert found.steps[-1].errors["holdout"].motion < 2e-3  # the encoder has 1.5e-3 rad a count


def test_standard_errors_hold_what_a_late_log_does(known):
    """Goals that were logged later than they acted, by as much as nobody says."""
    found, late = (
        add(MODEL, "viscous_asymmetry", part[:2], part[2:]).before.model.estimates
        for part in (known, Rollouts(tuple(known)).mistimed[0].recordings)
    )
    moved = {name: abs(late[name].value - found[name].value) / found[name].std for name in TRUE}
    assert max(moved.values()) < 2.0 and max(moved.values()) > 0.3  # which is most of some


@pytest.mark.slow
def test_play_is_a_candidate_before_an_encoder_at_the_output_and_is_not_found_where_it_is_none(plain):
    drives = [replace(recording.drive, encoder="output") for recording in plain]
    recordings = [replace(own, drive=drive) for own, drive in zip(plain, drives, strict=True)]
    found = diagnose(recordings[:2], recordings[2:], only=["backlash", "joint_flexibility", "stribeck"])
    assert len(found.candidates) == 3 and not found.selected
    assert ServoDrive.from_settings(drives[0].get_settings()) == drives[0]
    assert ServoDrive.from_settings({"preset": "sts3215", "kp": 16}).encoder == "output"


def test_parameters_come_back_where_goals_are_said_to_run_on():
    """Under control of the speed, which a goal that is half a sample late disturbs as much as what hides."""
    case = servos.goal(5)
    recordings = list(with_goals([case.recorded(k, run) for k, run in enumerate(simulate(case.runs))], is_held=False))
    found = diagnose(recordings[:-1], recordings[-1:], only=("coulomb_asymmetry", "stribeck"))
    assert found.selected == case.hidden == ("coulomb_asymmetry",) and not found.unexplained
    for name, value in case.truth.items():
        own = found.model.estimates[name]
        assert abs(own.value - value) < 3 * own.std


def test_friction_that_grows_with_the_load_is_named_and_the_error_falls(pressed):
    found = diagnose(pressed[:2], pressed[2:], only=FEW)
    assert found.selected == ("load_dependent_friction",)
    first, last = found.steps[0].errors["holdout"], found.steps[-1].errors["holdout"]
    assert last.motion < 0.3 * first.motion and np.isnan(last.torque_rms)
    own = found.model.estimates["load_dependent_friction.output"].value * found.model.estimates["gravity"].value
    assert own == pytest.approx(0.3, rel=0.25)
    json.dumps(found.json(), allow_nan=False)


def under_voltage(kp: float, seed: int, rubs: float = 0.0, pressed: float = 0.0, warms: float = 0.0) -> Recording:
    """Eight seconds of a servo whose duty drives a motor that brakes by turning, beside friction of its torque.

    By steps of 0.2 ms that stop where dry friction does; the motor, 0.3 N m/V, brakes by 0.25 N m s/rad. Friction grows
    by `rubs` of its torque, by `pressed` of the weight's and by `warms` with each kelvin, where the motor is off at
    last.
    """
    rng, step, rate = np.random.default_rng(seed), 2e-4, 100
    tones, phases = 2 * np.pi * np.array([0.23, 0.41, 0.9]), rng.uniform(0, 2 * np.pi, 3)
    q, v, held, rows = 0.0, 0.0, 0.0, []
    for k in range(round(8.0 / step)):
        is_on, warmer = float(not warms or k * step < 6.5), 2.5 * k * step
        if k % round(1 / rate / step) == 0:
            held = float(np.sin(tones * k * step + phases) @ [0.5, 0.35, 0.2]) + (warms > 0)
            rows.append((k * step, np.round(q / 1.5e-3) * 1.5e-3, held, is_on, 25.0 + warmer))
        motor = is_on * (0.3 * 12.0 * min(max(kp * (held - q), -0.95), 0.95) - 0.25 * v)
        weight = TRUE["gravity"] * math.sin(q)
        pushed = v + step * (motor - weight - TRUE["viscous"] * v) / TRUE["inertia"]
        dry = TRUE["coulomb"] + rubs * abs(motor) + pressed * abs(weight) + warms * warmer
        v = math.copysign(max(abs(pushed) - step * dry / TRUE["inertia"], 0.0), pushed)
        q += step * v
    time, position, goal, on, temperature = np.array(rows).T
    drive = ServoDrive(kp=kp, limit=0.95, supply=12.0, gain=0.3, goal="held", reads="exact")
    torque = drive.torque(goal, position, 0 * goal, 12.0 + 0 * goal, on)
    known = {"enabled": on, "temperature": temperature} if warms else {}
    return Recording(time, position, torque, reference=goal, drive=drive, **known, name=f"gain-{kp}")


def test_what_a_motor_brakes_is_told_from_viscous_friction_where_the_gear_rubs_under_its_torque(rubbed):
    found = diagnose(rubbed[:2], rubbed[2:], only=("load_dependent_friction",))
    assert describe_result(found) == "Load dependent friction is missing"
    for name, value in {**TRUE, "back_emf": 0.25, "load_dependent_friction": 0.25}.items():
        own = found.model.estimates[name]
        assert abs(own.value - value) < 4 * own.std and own.std < 0.1 * max(value, 0.25)
    assert "back_emf" not in found.steps[0].model.estimates


def integrating(
    kp: float,
    seed: int,
    windup: str,
    order: str,
    ki: float = 12.0,
    kd: float = 0.0,
    derivative: str = "velocity",
    count: float = 0.0,
    **declared: Any,
) -> Recording:
    """Ten seconds of a servo that jumps between goals, by firmware that looks 100 times a second; without torque.

    The firmware reads exact positions, or those of an encoder with a count [rad].
    """
    rng, step, rate, limit = np.random.default_rng(seed), 2e-4, 100, 1.2
    goals, q, v, total, asked, rows = rng.uniform(-1.2, 1.2, 11), 0.0, 0.0, 0.0, 0.0, []
    goals[0] = last = last_goal = 0.0
    for k in range(round(10.0 / step)):
        if k % round(1 / rate / step) == 0:
            goal = goals[int(k * step)]
            error, before = goal - (count * np.round(q / count) if count else q), total
            total += error / rate
            change = (goal - last_goal if derivative == "error" else 0.0) - (q - last)
            wanted = kp * error + ki * (total if order == "before" else before) + kd * change * rate
            last, last_goal = q, goal
            asked = min(max(wanted, -limit), limit)
            if windup == "stop" and wanted != asked and wanted * error > 0:
                total = before
            if windup == "clamp" and ki:
                total = min(max(total, -limit / ki), limit / ki)
            if k % round(0.01 / step) == 0:
                rows.append((k * step, np.round(q / (count or 1.5e-3)) * (count or 1.5e-3), goal))
        pushed = v + step * (asked - TRUE["gravity"] * math.sin(q) - 0.2 * v) / TRUE["inertia"]
        v = math.copysign(max(abs(pushed) - step * TRUE["coulomb"] / TRUE["inertia"], 0.0), pushed)
        q += step * v
    time, position, goal = np.array(rows).T
    drive = ServoDrive(output="torque", kp=kp, ki=ki, kd=kd, limit=limit, rate=float(rate), goal="held", **declared)
    logged = {"time": time, "position": position, "reference": goal}
    return replace(read_recording(logged, drive=drive), name=f"gain-{kp}")


LAWS = slow.but_first([("clamp", "before"), ("stop", "after"), ("free", "before")])


@pytest.mark.parametrize(("windup", "order"), LAWS)
def test_convention_of_an_integral_is_found_by_the_motion(windup, order):
    """Wound up, the integral of another convention biases the inertia and leaves errors that no joint has."""
    recordings = [integrating(kp, k, windup, order, reads="exact") for k, kp in enumerate((3.0, 5.0, 4.0))]
    found = diagnose(recordings[:2], recordings[2:], only=("stribeck", "quadratic_drag"))
    (read,) = list_laws(found.findings)
    assert read.settings == {"windup": windup, "integral": order}
    assert not found.selected and not found.unexplained
    assert found.model.estimates["inertia"].value == pytest.approx(TRUE["inertia"], rel=0.01)
    declared = [replace(own, drive=replace(own.drive, windup=windup, integral=order)) for own in recordings]
    assert not list_laws(decide_conventions(declared).findings)


@pytest.mark.parametrize("count", [0.0, 8e-3])
def test_friction_is_found_whether_the_controller_reads_counts_or_exact_positions(count):
    """A count asks for half of the dry friction, so that the joint creeps where it would stick."""
    recordings = [integrating(kp, 20 + k, "stop", "after", ki=0.0, count=count) for k, kp in enumerate((4.0, 6.0, 5.0))]
    decided = decide_conventions(recordings[:2], recordings[2:])
    for recording in (*decided.recordings, *decided.holdout):
        assert recording.drive is not None and recording.drive.reads == ("counts" if count else "exact")
    (read,) = (own for own in decided.findings if isinstance(own, ControllerConvention) and own.is_of_position)
    assert read.settings == {"reads": "counts" if count else "exact"} and read.gain.value > 0
    estimates = add(MODEL, "viscous_asymmetry", decided.recordings, decided.holdout).before.model.estimates
    for name, value in (TRUE | {"viscous": 0.2}).items():
        assert abs(estimates[name].value - value) < 3 * estimates[name].std
    assert estimates["coulomb"].value == pytest.approx(TRUE["coulomb"], rel=0.015)


def test_the_current_of_a_controller_with_an_integral_is_not_converted_by_loads():
    servo = integrating(4.0, 0, "stop", "after")
    logged = {"time": servo.time, "position": servo.position, "reference": servo.reference}
    known = {"windup": "stop", "integral": "after", "reads": "exact"}
    recording = read_recording(logged, drive=replace(servo.drive, output="current", **known))
    weighted = replace(recording, load=Load(inertia=0.01, gravity=0.5))
    data = FitData.from_recordings([recording, weighted])
    assert data.doubt == UnknownConstant("A", has_integral=True)
    assert all(own.torque_unit == "A" for own in data.recordings)


def test_reading_of_the_position_that_one_drive_declares_holds_for_all():
    recordings = [integrating(kp, k, "stop", "after", ki=0.0, count=8e-3) for k, kp in enumerate((4.0, 6.0))]
    said = [replace(recordings[0], drive=replace(recordings[0].drive, reads="exact")), *recordings[1:]]
    decided = decide_conventions(said)
    assert all(own.drive is not None and own.drive.reads == "exact" for own in decided.recordings)
    assert not any(isinstance(own, ControllerConvention) and own.is_of_position for own in decided.findings)


def test_declared_counts_are_reported_if_the_log_shows_no_step_of_an_encoder():
    recording = integrating(4.0, 0, "stop", "after", ki=0.0)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, len(recording))
    drive = replace(recording.drive, reads="counts")
    filtered = replace(recording, position=recording.position + noise, drive=drive)
    (found,) = decide_conventions([filtered]).findings
    assert isinstance(found, UnseenCounts)
    assert Rollouts((filtered,)).creep_torque == Rollouts((filtered,)).without_counts.creep_torque > 0


def test_counts_of_the_encoder_help_over_friction_unless_simulated_controllers_read_them():
    recording = integrating(4.0, 0, "stop", "after", ki=0.0, count=8e-3)
    exact, counts = (
        Rollouts((replace(recording, drive=replace(recording.drive, reads=reads)),), has_counts=True)
        for reads in ("exact", "counts")
    )
    assert exact.creep_torque > 0 == counts.creep_torque


@pytest.mark.parametrize("derivative", ["velocity", "error"])
def test_quantity_that_the_derivative_part_acts_on_is_found_by_the_motion(derivative):
    """The derivative of the error kicks at each step of the goal; taken for that of the velocity, it leaves drag."""
    law = ("stop", "after", 0.0, 0.04, derivative)
    recordings = [integrating(kp, k, *law, reads="exact") for k, kp in enumerate((3.0, 5.0, 4.0))]
    found = diagnose(recordings[:2], recordings[2:], only=("quadratic_drag", "torque_saturation"))
    (read,) = list_laws(found.findings)
    assert read.settings == {"derivative": derivative} == {"derivative": found.model.log_format["derivative"]}
    assert not found.selected and not found.unexplained
    for name, value in (TRUE | {"viscous": 0.2}).items():
        assert abs(found.model.estimates[name].value - value) < 4 * found.model.estimates[name].std


def test_every_command_uses_the_torque_with_the_integral():
    """Without its integral, a servo that holds a weight seems to need no torque, so that gravity is lost."""
    recordings = [integrating(kp, k, "clamp", "before", reads="exact") for k, kp in enumerate((3.0, 5.0, 4.0))]
    identified = identify(recordings[:2], schemes="filtered_dynamic")
    model, conventions = identified.primary.model, {"windup": "clamp", "integral": "before"}
    assert model.estimates["gravity"].value == pytest.approx(TRUE["gravity"], rel=0.01)
    assert conventions.items() <= model.log_format.items()
    assert list_laws(identified.findings)
    compared = compare(identified.least_squares, recordings[2:])
    assert compared.data is not None
    assert compared.joint.errors.torque_rms < 0.1 * np.sqrt(np.mean(recordings[2].torque ** 2))
    (held_out,) = compared.data.recordings
    declared = replace(recordings[2], drive=replace(recordings[2].drive, **conventions))
    added = add(MODEL, "stribeck", recordings[:2], [declared])  # what one drive declares holds for all
    assert conventions.items() <= added.after.model.log_format.items()
    assert held_out.drive is not None and held_out.drive.windup == "clamp" and held_out.drive.integral == "before"
    for name, value in (TRUE | {"viscous": 0.2}).items():
        assert (
            abs(identified.least_squares.estimates[name].value - value)
            < 3 * identified.least_squares.estimates[name].std
        )


@pytest.mark.slow
def test_sets_of_several_kinds_are_identified_with_conventions_of_each():
    """A servo without torque beside a joint without a drive, and beside another shaft: together they are no loop."""
    asked = [integrating(kp, k, "clamp", "before", reads="exact") for k, kp in enumerate((3.0, 5.0))]
    driveless = replace(asked[1], drive=None, reference=None)
    other = replace(asked[1], drive=replace(asked[1].drive, encoder="output"))
    for mixed, names in (([asked[0], driveless], {("gain-3.0",)}), ([asked[0], other], {("gain-3.0",), ("gain-5.0",)})):
        found = identify(mixed, schemes="filtered_dynamic")
        assert {own.recordings for own in list_laws(found.findings)} == names
        assert found.primary.model.estimates["gravity"].value == pytest.approx(TRUE["gravity"], rel=0.02)
        with pytest.raises(RecordingError):
            diagnose(mixed)


def test_conventions_that_one_drive_declares_hold_for_all_before_those_of_a_model():
    first, second = (integrating(3.0, k, "stop", "after") for k in range(2))
    declared = replace(first, drive=replace(first.drive, windup="clamp"))
    for recording in complete_drives([declared, second], {"windup": "free", "integral": "before"}):
        assert (recording.drive.windup, recording.drive.integral) == ("clamp", "before")


def test_convention_of_a_position_drive_is_not_that_of_a_velocity_drive():
    first, second = (integrating(3.0, k, "stop", "after") for k in range(2))
    declared = replace(first, drive=replace(first.drive, windup="clamp"))
    turned = replace(second, drive=replace(second.drive, control="velocity"))
    applied = complete_drives([declared, second, turned], {"integral": "before"})
    assert [r.drive.windup for r in applied] == ["clamp", "clamp", None]
    assert {r.drive.integral for r in applied} == {"before"}


@pytest.mark.slow
def test_kind_of_drive_that_is_only_held_out_is_decided_by_its_own_motion():
    first, second = (integrating(3.0 + k, k, "clamp", "before") for k in range(2))
    fitted = replace(first, drive=replace(first.drive, windup="stop", integral="after"))
    other = replace(second, drive=replace(second.drive, encoder="output"))
    for recordings in ([fitted], [replace(fitted, drive=None, reference=None)]):
        decided = decide_conventions(recordings, [other])
        (held_out,) = decided.holdout
        assert (held_out.drive.windup, held_out.drive.integral) == ("clamp", "before")
        (read,) = list_laws(decided.findings)
        assert read.recordings == (other.name,)


@pytest.mark.parametrize(("size", "is_kept"), [(0.0005, False), (0.002, True)])
def test_effect_that_explains_a_small_share_of_the_error_is_dropped_though_it_is_significant(size, is_kept):
    id, recordings = "viscous_asymmetry", recorded({"viscous_asymmetry": {"asym_v": size}}, **CONVENTIONS)
    data, options = SERVO.prepare(recordings[:2], recordings[2:], Options(BASE, {id: effects()[id]}))
    evidence = SERVO.make_evidence(data, options)
    longer = evidence.fits.fit_with_std((*options.base, effects()[id]()), added=id)
    found = SearchResult(evidence, [evidence.fits.fit_with_std(options.base), longer])
    assert longer.model.estimates[id].is_significant
    assert (len(Trial(SERVO, data, options, found).final.steps) == 2) == is_kept


def test_back_emf_is_viscous_friction_where_no_torque_of_the_motor_tells_it():
    """Friction that the weight alone presses does not, nor does one that is added and is not there."""
    pressed = [under_voltage(kp, k, pressed=0.3) for k, kp in enumerate((2.0, 4.0, 3.0))]
    added = add(MODEL, "load_dependent_friction", pressed[:2], pressed[2:])
    for model in (added.before.model, added.after.model):
        assert "back_emf" not in model.estimates
    both = added.after.model.estimates["viscous"]
    assert both.value == pytest.approx(TRUE["viscous"] + 0.25, abs=max(4 * both.std, 0.01))


@pytest.mark.slow
def test_what_is_known_of_viscous_friction_stays_beside_back_emf(rubbed):
    model = Model.build([term for term in BASE if term.id != "viscous"], [0.012, 0.9, 0.08])
    added = add(model, "load_dependent_friction", rubbed[:2], rubbed[2:])
    assert added.after.model.estimates["back_emf"].value == pytest.approx(TRUE["viscous"] + 0.25, rel=0.15)
    known = add(MODEL, "load_dependent_friction", rubbed[:2], rubbed[2:], fixed={"viscous": 0.05})
    assert known.after.model.estimates["viscous"].value == known.before.model.estimates["viscous"].value == 0.05


def test_an_effect_is_added_without_objection_only_where_it_hides(pressed, known):
    right, wrong = (add(MODEL, "load_dependent_friction", own[:2], own[2:]) for own in (pressed, known))
    assert right.objection is None and right.noise_ratio < 3 and wrong.objection is not None


def test_errors_of_a_comparison_are_those_of_whole_recordings(known):
    wrong = MODEL.with_values({"gravity": 0.6})
    right, off = (compare(model, known).joint.errors for model in (MODEL, wrong))
    assert right.motion < 2e-3 < 0.02 < off.motion
    assert right.motion <= right.motion_rms


def test_fit_finds_the_likeliest_parameters_from_far_away_and_a_limit_that_is_too_low_is_where_one_ends(rollouts):
    found = fit_rollouts(rollouts, Point(TILTED, np.array([0.03, 0.4, 0.2, 0.2, 0.1])), TYPICAL, share=0.0)
    true = rollouts.compute_position_errors([Point(TILTED, np.array([*TRUE.values(), 0.0]))])
    told = [compute_log_likelihood(rollouts, e)[0] for e in (found.error[:, None], true)]
    assert told[0] >= told[1]
    assert found.point.theta[:4] == pytest.approx(list(TRUE.values()), rel=0.05)
    limited, _ = apply_limits(TILTED, {}, None, {"viscous": (0.0, 0.04)})
    start = np.array([*TRUE.values(), 0.0]) * [1.2, 0.8, 0.8, 1.0, 1.0]
    found = fit_rollouts(rollouts, Point(tuple(limited), start), TYPICAL, share=0.0)
    assert found.point.theta[2] == pytest.approx(0.04)
    assert found.point.theta[1] == pytest.approx(TRUE["gravity"], rel=0.1)


@pytest.mark.parametrize(("tones", "sizes"), [((0.2, 0.6), (0.7, 0.3)), ((0.3, 0.8), (0.8, 0.4))])
def test_fit_finds_friction_beside_drag_though_the_output_is_mostly_at_its_limit(tones, sizes):
    """Their sum is known well, so the fit has to follow a narrow valley."""
    true, limit, step, recordings = np.array([0.0124, 0.386, 1.955, 0.071]), 1.5, 1e-4, []
    inertia, gravity, viscous, coulomb = true
    for kp, phase in ((36.0, 1.0), (85.0, 2.0)):
        q, v, goal, torque, rows = 0.0, 0.0, 0.0, 0.0, []
        for k in range(80_000):
            if k % 80 == 0:
                slow, fast = (2 * np.pi * tone * k * step for tone in tones)
                goal = sizes[0] * np.sin(slow) + sizes[1] * (np.sin(fast + phase) - np.sin(phase))
                rows.append((k * step, q, goal))
            if k % 10 == 0:
                torque = min(max(kp * (goal - q), -limit), limit)
            pushed = v + step * (torque - gravity * math.sin(q) - viscous * v) / inertia
            v = math.copysign(max(abs(pushed) - step * coulomb / inertia, 0.0), pushed)
            q += step * v
        time, position, goals = np.array(rows).T
        drive = ServoDrive(output="torque", kp=kp, limit=limit, rate=1000.0, goal="held")
        recordings.append(Recording(time, position, np.ones(len(time)), reference=goals, drive=drive, name=f"{kp}"))
    start = Point(BASE, true * [1.0, 0.95, 0.95, 2.0])
    found = fit_rollouts(Rollouts(tuple(recordings), LOOP.simulation.fine_steps), start, TYPICAL[:4], share=0.0)
    assert found.point.theta == pytest.approx(true, rel=0.03)


def test_end_of_a_recording_is_compared_as_the_whole_has_it(plain):
    point = Point(TILTED, np.array([*TRUE.values(), 0.02]))
    whole, first, last = (Rollouts(tuple(plain[:2]), shares=own) for own in ((0.0, 1.0), (0.0, 0.7), (0.7, 1.0)))
    told = [one.compute_position_errors([point])[:, 0] for one in (whole, first, last)]
    assert np.sort(np.concatenate(told[1:])) == pytest.approx(np.sort(told[0]), abs=1e-12)
    assert len(told[2]) == pytest.approx(0.3 * len(told[0]), rel=0.02)


def test_parameters_of_an_unknown_gain_are_per_volt_and_compared_so(known, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    drive = ServoDrive(kp=2.5 / 12.0, limit=0.5, supply=12.0, rate=1000.0, **CONVENTIONS)  # 1 N m/V
    gain_of_one = [replace(one, drive=replace(drive, kp=one.drive.kp / 12.0), torque_unit="V") for one in known]
    found = diagnose(gain_of_one[:2], gain_of_one[2:], only=FEW)
    assert found.model.torque_unit == "V"
    assert found.model.estimates["gravity"].value == pytest.approx(TRUE["gravity"], rel=0.02)
    in_torque = replace(MODEL, torque_constant=Estimate(1.0, 0.01, "N m/V"))  # whose constant is the drive's gain
    for model in (Model.from_json(found.model.json()), in_torque):
        assert compare(model, gain_of_one).joint.errors.motion < 2e-3


@pytest.mark.parametrize(
    ("other", "refusal"),
    [
        ({"drive": None}, "has no drive, but others have one"),
        ({"drive": ServoDrive("velocity", "torque", kp=1.0)}, "controls another quantity"),
        ({"drive": ServoDrive(kp=1.0, supply=12.0)}, "give the drive a gain"),
        ({"drive": ServoDrive(output="torque", kp=1.0, encoder="output")}, "encoder at another shaft"),
    ],
)
def test_servos_that_cannot_be_simulated_together_are_refused(plain, other, refusal):
    with pytest.raises(RecordingError, match=refusal):
        are_driven([plain[0], replace(plain[1], **other)])


def test_goal_of_a_speed_has_its_units_and_that_of_an_angle_its_turn(plain, tmp_path):
    time = plain[0].time
    position = 8.0 * np.sin(time)
    wrapped = (position + np.pi) % (2 * np.pi) - np.pi
    rows = np.column_stack([time, wrapped, wrapped + 0.01, np.full(len(time), 30.0)])
    np.savetxt(tmp_path / "w.csv", rows, delimiter=",", header="time,position,goal,rpm", comments="")
    angle = read_recording(tmp_path / "w.csv", unwrap=True, drive=ServoDrive(kp=1.0, output="torque"))
    assert np.abs(angle.reference - angle.position).max() < 0.02
    columns = {"reference": "rpm:rpm"}
    speed = read_recording(
        tmp_path / "w.csv", unwrap=True, columns=columns, drive=ServoDrive("velocity", "torque", kp=1.0)
    )
    assert speed.reference == pytest.approx(np.pi)


def test_slopes_are_those_of_smaller_and_larger_parameters(rollouts):
    rollouts = rollouts.without_counts  # counts change by steps
    theta = np.array([*TRUE.values(), 0.0])
    near = linearise_errors(rollouts, Point(TILTED, theta), TYPICAL, False)
    for k, step in enumerate(np.diag(TYPICAL / 20)):
        more, less = (rollouts.compute_position_errors([Point(TILTED, theta + s)])[:, 0] for s in (step, -step))
        slope = (more - less) / (2 * step[k])
        assert np.linalg.norm(near.slopes[:, k] - slope) < 0.1 * np.linalg.norm(slope)


def test_a_servo_that_is_told_to_go_at_once_starts_at_rest():
    rng, time = np.random.default_rng(0), np.arange(200) / 200.0
    position = 0.5 * (1.0 - np.cos(25.0 * time)) + 1e-5 * rng.standard_normal(len(time))
    told = {"reference": np.ones(len(time)), "drive": ServoDrive(output="torque", kp=3.0, rate=1000.0)}
    (speed,) = Rollouts((Recording(time, position, 3.0 * (1.0 - position), **told, name="jump"),)).servos.velocity
    assert abs(speed) < 0.1  # where a cubic over 80 ms has half a radian per second


def test_what_a_motor_loses_by_turning_presses_no_gear_and_what_warms_up_rubs_more():
    rollouts = Rollouts(tuple(under_voltage(kp, k, 0.25, 0.15, 0.004) for k, kp in enumerate((2.0, 4.0))))
    terms = (*BASE, BackEmf(), effects()["load_dependent_friction"](), TemperatureDependentFriction())
    start = Point(terms, np.array([0.01, 0.8, 0.05, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0]))
    found = fit_rollouts(rollouts, start, np.r_[TYPICAL[:4], 0.05, 0.05, 0.05, 1e-3, 1e-3], share=0.0)
    assert found.point.theta[:7] == pytest.approx([*TRUE.values(), 0.25, 0.25, 0.15], rel=0.05, abs=5e-3)
    assert found.point.theta[7:] == pytest.approx([0.0, 0.004], abs=3e-4)


def test_log_of_goals_and_positions_needs_no_torque(plain, tmp_path):
    path = tmp_path / "servo.csv"
    rows = np.column_stack([plain[0].time, plain[0].position, plain[0].reference])
    np.savetxt(path, rows, delimiter=",", header="time,position,goal", comments="")
    own = read_recording(path, drive=plain[0].drive)
    assert own.torque == pytest.approx(plain[0].torque, abs=1e-6) and not own.has_logged_torque
    compared = compare(MODEL.with_values({"gravity": 0.5}), own)
    assert not compared.is_torque_logged and not compared.regions and compared.joint.errors.motion > 0.02
    with pytest.raises(RecordingError, match="no column for torque"):
        read_recording(path)
    np.savetxt(path, rows * [1, 1, 2048 / np.pi], delimiter=",", header="time,position,goal", comments="")
    with pytest.raises(RecordingError, match=r"the goal is .* rad away from the position"):
        read_recording(path, drive=plain[0].drive)
    np.savetxt(path, rows[:, :2], delimiter=",", header="time,position", comments="")
    with pytest.raises(RecordingError, match="no column for reference"):
        read_recording(path, drive=plain[0].drive)


@pytest.mark.parametrize(
    ("drive", "header", "columns", "unit", "scale"),
    [
        (ServoDrive(kp=0.2), "duty,volts", {}, "V", 12.0),
        (ServoDrive(kp=0.2, gain=0.5), "duty [%],volts", {}, "N m", 0.01 * 12.0 * 0.5),
        (ServoDrive(kp=0.2), "pwm,volts", {"torque": "pwm:duty*?"}, "V", 12.0),
        (ServoDrive(output="current", kp=2.0), "current,x", {}, "A", 1.0),
        (ServoDrive(output="current", kp=2.0, gain=0.5), "current [mA],x", {}, "N m", 0.5e-3),
    ],
)
def test_output_of_a_controller_is_known_by_its_name_and_is_its_torque(
    plain, tmp_path, drive, header, columns, unit, scale
):
    path, output = tmp_path / "servo.csv", np.cos(plain[0].time)
    rows = np.column_stack([plain[0].time, plain[0].position, plain[0].reference, output, np.full(len(output), 12.0)])
    np.savetxt(path, rows, delimiter=",", header=f"time,position,goal,{header}", comments="")
    own = read_recording(path, drive=drive, columns=columns)
    assert own.torque == pytest.approx(scale * output) and own.torque_unit == unit and own.has_logged_torque
    assert are_driven([own]) and not any("to be found" in note for note in list_notes(own))


def test_logged_torque_tells_the_scale_of_a_wrong_gain(known, tmp_path):
    logs = []
    for own in known:
        path = tmp_path / f"{own.name}.csv"
        askew = own.position + 0.1, own.reference + 0.1  # as a horn that is put on by hand
        rows = np.column_stack([own.time, *askew, own.torque])
        np.savetxt(path, rows, delimiter=",", header="time,position,goal,torque", comments="")
        drive = replace(own.drive, kp=0.75 * own.drive.kp)
        logs.append(read_recording(path, drive=drive, columns={"torque": "torque:Nm"}))
    wrong = diagnose(logs[:2], logs[2:], only=["stribeck"]).findings
    (scaled,) = (own for own in wrong if isinstance(own, ScaledTorque))
    assert scaled.factor == pytest.approx(1 / 0.75, rel=0.01)
    with_integral = [replace(own, drive=replace(own.drive, ki=0.5)) for own in logs]
    limits = LoopLimits()
    assert find_torque_scale(logs, limits) is not None and find_torque_scale(with_integral, limits) is None


def test_a_drive_that_acts_on_the_speed_is_asked_how_often_it_looks(known):
    def asked(rate: float | None, kd: float) -> bool:
        damped = [replace(own, drive=replace(own.drive, rate=rate, kd=kd)) for own in known[:2]]
        return any(isinstance(own, UnknownSpeedRate) for own in diagnose(damped, only=["stribeck"]).findings)

    assert asked(None, 0.03) and not asked(1000.0, 0.03)


def test_command_line_diagnoses_compares_and_reports_in_the_loop(pressed, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for recording in pressed:
        write_recording(recording, f"{recording.name}.csv")
    roles = zip(pressed, ("fit", "fit", "holdout"), strict=True)
    write_study(
        [
            Source(Path(f"{own.name}.csv"), role, drive=replace(own.drive, goal=None, reads=None))  # for fits to decide
            for own, role in roles
        ],
        Path("study.toml"),
    )
    only = ["--only", "stribeck,load_dependent_friction"]
    assert main(["diagnose", "study.toml", *only, "-v", "-o", "m.json", "--report", "r.html"]) == 0
    shown = capsys.readouterr().out
    assert "\nload_dependent_friction: " in shown and "nan" not in shown
    assert ">nan" not in (tmp_path / "r.html").read_text().lower()
    assert main(["compare", "m.json", "study.toml", "--report", "c.html"]) == 0
    assert "in the loop" in capsys.readouterr().out


def logged_slowly(is_held: bool, late: float, kp: float, seed: int) -> Recording:
    """Eight seconds of a servo at 50 Hz whose goals are held from row to row, or run on, and act late [s]."""
    rng, step, rate, viscous = np.random.default_rng(seed), 1e-3, 50, 0.2
    tones, phases = 2 * np.pi * np.array([0.3, 0.7, 1.3]), rng.uniform(0, 2 * np.pi, 3)
    time = np.arange(8 * rate + 1) / rate
    looks = np.arange(0.0, 8.0, step)
    goals, smooth = (np.sin(own[:, None] * tones + phases) @ [0.5, 0.3, 0.2] for own in (time, looks))
    goal = goals[(looks * rate + 1e-6).astype(int)] if is_held else smooth
    q, v, asked, path = float(goals[0]), 0.0, [0.0] * (1 + round(late / step)), []
    for own in goal:
        path.append(q)
        asked = [kp * (own - q), *asked[:-1]]
        pushed = v + step * (asked[-1] - TRUE["gravity"] * math.sin(q) - viscous * v) / TRUE["inertia"]
        v = math.copysign(max(abs(pushed) - step * TRUE["coulomb"] / TRUE["inertia"], 0.0), pushed)
        q += step * v
    position = np.round(np.array(path)[:: 1000 // rate] / 1.5e-3) * 1.5e-3
    drive = ServoDrive(output="torque", kp=kp, rate=1000.0, reads="exact")
    known, count = goals[: len(position)], len(position)
    return Recording(time[:count], position, kp * (known - position), reference=known, drive=drive, name="slow")


def test_a_drive_without_any_torque_is_refused(plain):
    silent = replace(plain[0], torque=np.zeros(len(plain[0])))
    with pytest.raises(ValueError, match="computes the torque that the drive asks for"):
        diagnose([silent])


@pytest.mark.parametrize(("is_held", "late"), [(True, 0.0), (False, 0.0), (False, 0.02)])
def test_goals_are_held_or_run_on_as_the_base_model_with_a_lag_and_a_dead_time_decides(is_held, late):
    recordings = [logged_slowly(is_held, late, kp, k) for k, kp in enumerate((4.0, 7.0))]
    read = [own for own in decide_conventions(recordings).findings if isinstance(own, GoalConvention)]
    assert [own.is_held for own in read] == [is_held]
    declared = decide_conventions(with_goals(recordings, not is_held))  # as the user has it
    assert not any(isinstance(own, GoalConvention) for own in declared.findings)
    assert {own.drive.goal for own in declared.recordings if own.drive} == {"ramp" if is_held else "held"}


@pytest.mark.parametrize("is_held", [True, False])
def test_no_dead_time_of_half_a_sample_is_named(is_held):
    recordings = [logged_slowly(is_held, 0.0, kp, k) for k, kp in enumerate((4.0, 7.0, 5.0))]
    found = diagnose(recordings[:2], recordings[2:], only=["dead_time", "actuator_lag"])
    assert not found.selected
    own = found.model.estimates["viscous"]
    assert abs(own.value - 0.2) < 3 * own.std


@pytest.mark.parametrize("gain", [0.0, 50.0])  # [nat], of the base model, which may be wrong
@pytest.mark.parametrize("is_held", [True, False])
def test_goals_are_read_the_other_way_only_if_the_found_model_predicts_better_so(is_held, gain):
    """The goals are held. The model lacks the tilt of the horn, which leaves an error under either reading."""
    tilt = 0.1  # [rad]
    straight = [logged_slowly(True, 0.0, kp, k) for k, kp in enumerate((4.0, 7.0, 5.0))]
    tilted = [replace(own, position=own.position + tilt, reference=own.reference + tilt) for own in straight]
    first, second, last = with_goals(tilted, is_held)
    tie = GoalConvention(is_held, Quantity(gain, 1.0))
    data = FitData.from_recordings([first, second], [last], BASE).with_treatment(tie)
    changed = reread_goals(Trial.search(SERVO, data, Options(BASE, {"dead_time": effects()["dead_time"]})))
    goals = None if changed is None else {own.drive.goal for own in changed.recordings if own.drive}
    assert goals == (None if is_held else {"held"})


def test_goals_are_read_from_the_data_also_where_a_given_model_favours_the_other_reading():
    recordings = [logged_slowly(True, 0.0, kp, k) for k, kp in enumerate((4.0, 7.0))]
    wrong = Rollouts(with_goals(recordings, False))
    point = fit_rollouts(wrong, Point(TILTED, np.array([*TRUE.values(), 0.0])), TYPICAL, share=0.0).point
    held = Rollouts(with_goals(recordings, True))
    told = [compute_log_likelihood(own, own.compute_position_errors([point]))[0] for own in (wrong, held)]
    assert told[0] > told[1]
    found = compare(Model.build(point.terms, point.theta), recordings)
    assert found.data is not None and {own.drive.goal for own in found.data.recordings if own.drive} == {"held"}


def test_goals_are_held_unless_a_drive_declares_that_they_run_on(plain):
    held, ramp = (Rollouts(with_goals(plain[:1], own)).servos.goal for own in (True, False))
    assert np.abs(held - ramp).max() > 1e-3
    assert np.abs(held - Rollouts((plain[0],)).servos.goal).max() == 0


def test_positions_of_a_slow_log_are_compared_with_its_motion_and_not_with_chords(plain):
    time = np.arange(240) / 30.0
    motion = 0.8 * np.sin(5.0 * time)
    (own,) = (replace(plain[0], time=time, position=motion, torque=0 * time, reference=motion),)
    positions = Rollouts((own,)).positions
    inner = slice(4, -4)
    assert np.abs(positions.measured - 0.8 * np.sin(5.0 * positions.time))[inner].max() < 2e-4


@pytest.mark.parametrize(("log_rate", "controller_rate"), [(30.0, 2000.0), (83.0, 250.0), (200.0, 2000.0)])
def test_steps_of_the_integrator_are_neither_those_of_the_log_nor_of_the_controller(log_rate, controller_rate):
    """A stiff servo follows each held goal before the next one comes; its motion bends within every row."""
    inertia, viscous, step, recordings = 0.01, 1.2, 1e-4, []
    tones, phases = 2 * np.pi * np.array([0.2, 0.5, 1.1]), np.array([0.3, 2.0, 4.0])
    for kp in (30.0, 45.0):
        goals = np.sin(np.arange(8 * log_rate + 1)[:, None] / log_rate * tones + phases) @ [0.5, 0.3, 0.2]
        q, v, torque, looks, path = float(goals[0]), 0.0, 0.0, 0, []
        for k in range(80_000):
            if k * step * log_rate > len(path) - 1e-6:
                path.append(q)
            if k * step * controller_rate > looks - 1e-6:
                torque, looks = kp * (float(goals[len(path) - 1]) - q), looks + 1
            pushed = v + step * (torque - TRUE["gravity"] * math.sin(q) - viscous * v) / inertia
            v = math.copysign(max(abs(pushed) - step * TRUE["coulomb"] / inertia, 0.0), pushed)
            q += step * v
        count = 2 * np.pi / 2**14
        position, goal = np.round(np.array(path) / count) * count, goals[: len(path)]
        drive = ServoDrive(output="torque", kp=kp, rate=controller_rate, goal="held")
        known = {"reference": goal, "drive": drive, "name": f"{kp}"}
        recordings.append(Recording(np.arange(len(path)) / log_rate, position, kp * (goal - position), **known))
    rollouts = Rollouts(tuple(recordings), LOOP.simulation.fine_steps)
    found = fit_rollouts(rollouts, Point(TILTED, np.array([0.01, 0.9, 1.0, 0.1, 0.0])), TYPICAL, share=0.0)
    assert np.mean(np.abs(found.error)) < 1.5 * count / 4  # that of rounding
    assert found.point.theta[:4] == pytest.approx([inertia, TRUE["gravity"], viscous, TRUE["coulomb"]], rel=0.03)


@pytest.mark.parametrize("is_held", [True, False])
def test_goals_are_read_once_and_the_model_keeps_the_reading(is_held, tmp_path):
    recordings = [logged_slowly(is_held, 0.0, kp, k) for k, kp in enumerate((4.0, 7.0, 5.0))]
    goal = {"held" if is_held else "ramp"}
    found = diagnose(recordings[:2], recordings[2:], only=["dead_time"])
    assert found.data is not None and {own.drive.goal for own in found.data.recordings if own.drive} == goal
    found.model.save(tmp_path / "model.json")
    model, others = (
        Model.load(tmp_path / "model.json"),
        [logged_slowly(not is_held, 0.0, 6.0, 8)],
    )  # read by itself, else
    unread = replace(model, log_format={})
    for known, goals in ((model, goal), (unread, {"held", "ramp"} - goal)):
        compared = compare(known, others)
        assert compared.data is not None and {own.drive.goal for own in compared.data.recordings if own.drive} == goals
    assert add(model, "dead_time", others).after.model.log_format["goal"] in goal
