"""Servos with their controller in the loop: against an independent integrator, closed forms, and step for step."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendulum_env.physics import BASE, KnownLoad, effect, simulate
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.transmission import Backlash, JointFlexibility
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.loop import ControllerSamples, Servos, simulate_servos
from robots.servos.torque import compute_commanded_torque
from tests.runge_kutta import step_runge_kutta
from tests.terms import Clipped, Table

INERTIA, GRAVITY, VISCOUS = 0.02, 0.8, 0.1
SMOOTH = np.array([INERTIA, GRAVITY, VISCOUS, 0.0])  # without dry friction, which the integrator below does not know
STEP = 1e-4  # [s]


def servo(drive: ServoDrive, goal: np.ndarray, **more: object) -> Servos:
    """One servo that hangs at rest, its goal given at every step."""
    column, rest = np.asarray(goal, dtype=float)[:, None], np.zeros(1)
    ones = np.ones_like(column)
    return replace(Servos((drive,), STEP, column, 10 * ones, ones, rest, rest, rest, KnownLoad()), **more)


def path(
    drive: ServoDrive, goal: np.ndarray, terms: tuple = BASE, theta: np.ndarray = SMOOTH, **more: object
) -> np.ndarray:
    return simulate_servos(terms, np.asarray(theta)[:, None], servo(drive, goal, **more))[:, 0, 0]


def wave(seconds: float = 2.0) -> np.ndarray:
    time = STEP * (np.arange(round(seconds / STEP)) + 0.5)
    return np.sin(3 * time) * np.minimum(time, 1.0)


@pytest.mark.parametrize("friction", [0.05, 0.09, 0.13])
def test_joint_creeps_to_the_edge_of_the_count_at_which_dry_friction_holds_it(friction):
    """Under strong damping, the joint stops when its encoder shows the first count whose torque friction holds."""
    count, kp, goal = 0.04, 2.0, 0.6
    drive = ServoDrive(output="torque", kp=kp, rate=1000.0)
    found = path(drive, np.full(60_000, goal), BASE, np.array([0.005, 0.0, 1.0, friction]), encoder_step=count)
    held = math.ceil((goal - friction / kp) / count)  # kp (goal - held count) <= friction
    assert found[-1] == pytest.approx((held - 0.5) * count, abs=0.02 * count)


@pytest.mark.parametrize("derivative", ["velocity", "error"])
def test_continuous_controller_of_counts_damps_the_same_at_every_step_of_the_integrator(derivative):
    """Without a rate, counts act on the position alone: the speed is exact."""
    count, time = 0.01, (np.arange(8000) + 0.5) / 4000.0
    drive = ServoDrive(output="torque", kp=4.0, kd=0.4, derivative=derivative)
    goal = np.sin(3 * time) * np.minimum(time, 1.0)
    theta = np.array([INERTIA, GRAVITY, VISCOUS, 0.02])
    coarse = path(drive, goal.reshape(-1, 4).mean(axis=1), BASE, theta, encoder_step=count, step=1e-3)
    fine = path(drive, goal, BASE, theta, encoder_step=count, step=2.5e-4)
    assert np.abs(coarse - fine[::4]).max() < count


@pytest.mark.parametrize(
    "drive",
    [
        ServoDrive(kp=0.5, kd=0.02, gain=0.4),
        ServoDrive(kp=0.6, ki=0.8, gain=0.4),
        ServoDrive(kp=3.0, limit=0.2, gain=0.4),
        ServoDrive("velocity", kp=0.2, ki=1.0, gain=0.4),
        ServoDrive(output="torque", kp=2.0, kd=0.1),
    ],
)
def test_motion_is_that_of_an_independent_integrator(drive):
    goal = wave()
    scale = (10.0 if drive.output == "duty" else 1.0) * (drive.gain or 1.0)

    def rate(t: float, q: float, v: float, integral: float) -> tuple[float, float, float]:
        wanted = math.sin(3 * t) * min(t, 1.0)
        error = wanted - (v if drive.acts_on_speed else q)
        asked = drive.kp * error + drive.ki * integral - (0.0 if drive.acts_on_speed else drive.kd * v)
        torque = scale * min(max(asked, -drive.max_output), drive.max_output)
        winds = abs(asked) > drive.max_output and asked * error > 0
        return v, (torque - GRAVITY * math.sin(q) - VISCOUS * v) / INERTIA, 0.0 if winds else error

    step, y, exact = 4 * STEP, [0.0, 0.0, 0.0], [0.0]
    for k in range(len(goal) // 4):
        y = step_runge_kutta(rate, k * step, y, step)
        exact.append(y[0])
    assert np.abs(path(drive, goal)[::4] - exact).max() < 2e-4 * np.ptp(exact)


def integrated_by(windup: str, order: str, goal: np.ndarray, drive: ServoDrive) -> np.ndarray:
    """Path of a servo whose controller looks every 100 steps, as the firmware of a drive is written."""
    q = v = total = output = 0.0
    found, period = [q], 100 * STEP
    for k, wanted in enumerate(goal):
        if k % 100 == 0:
            error, before = wanted - q, total
            if order == "before":
                total += error * period
            asked = drive.kp * error + drive.ki * total
            output = min(max(asked, -drive.limit), drive.limit)
            total = before + error * period
            if windup == "stop" and asked != output and asked * error > 0:
                total = before
            if windup == "clamp":
                total = min(max(total, -drive.limit / drive.ki), drive.limit / drive.ki)
        torque = 10.0 * drive.gain * output
        v += STEP * (torque - GRAVITY * math.sin(q + 0.5 * STEP * v) - VISCOUS * v) / INERTIA
        q += STEP * v
        found.append(q)
    return np.array(found)


@pytest.mark.parametrize("order", ["after", "before"])
@pytest.mark.parametrize("windup", ["stop", "clamp", "free"])
def test_integral_of_a_drive_follows_its_convention(windup, order):
    goal = np.where(np.arange(40_000) // 10_000 % 2, -0.8, 0.8)
    drive = ServoDrive(kp=0.5, ki=2.0, limit=0.25, gain=0.4, rate=100.0, windup=windup, integral=order)
    exact = integrated_by(windup, order, goal, drive)
    errors = {}
    for other in itertools.product(["stop", "clamp", "free"], ["after", "before"]):
        told = path(replace(drive, windup=other[0], integral=other[1]), goal)
        errors[other] = np.abs(told - exact).max()
    own = errors.pop((windup, order))
    assert own < 2e-3 * np.ptp(exact) and own < 0.1 * min(errors.values())


@pytest.mark.parametrize("derivative", ["velocity", "error"])
def test_derivative_part_acts_on_the_velocity_or_on_the_derivative_of_the_error(derivative):
    goal = np.where(np.arange(40_000) // 10_000 % 2, -0.8, 0.8) + 0.2 * np.sin(5e-4 * np.arange(40_000))
    drive = ServoDrive(kp=0.5, kd=0.02, limit=0.6, gain=0.4, rate=100.0, cutoff=10.0, derivative=derivative)
    q = v = speed = output = before = 0.0
    last, exact, period = goal[0], [0.0], 100 * STEP
    for k, wanted in enumerate(goal):
        if k % 100 == 0:
            change = q - before - (wanted - last if derivative == "error" else 0.0)
            speed += (1.0 - math.exp(-math.tau * drive.cutoff * period)) * (change / period - speed)
            before, last = q, wanted
            output = min(max(drive.kp * (wanted - q) - drive.kd * speed, -drive.limit), drive.limit)
        v += STEP * (10.0 * drive.gain * output - GRAVITY * math.sin(q + 0.5 * STEP * v) - VISCOUS * v) / INERTIA
        q += STEP * v
        exact.append(q)
    right, other = (
        np.abs(path(replace(drive, derivative=name), goal) - exact).max()
        for name in (derivative, {"velocity": "error", "error": "velocity"}[derivative])
    )
    assert right < 5e-3 * np.ptp(exact) and right < 0.1 * other


def test_servo_comes_to_rest_where_its_law_balances_the_load_and_dry_friction_holds_it():
    drive = ServoDrive(kp=0.5, gain=0.4)
    at = path(drive, np.full(60_000, 0.7))[-1]
    assert 0.5 * 10.0 * 0.4 * (0.7 - at) == pytest.approx(GRAVITY * np.sin(at), abs=1e-6)
    held = path(drive, np.full(5000, 0.4), theta=np.array([INERTIA, 0.0, VISCOUS, 1.0]))  # asks for 0.8 of 1 N m
    assert np.abs(held).max() == 0.0


GAP = 0.03  # [rad]
LINK, RESONANCE = 0.008, 120.0  # [kg m^2], [rad/s]
PLAY = Backlash(gap=GAP, resonance=RESONANCE, damping=20.0, gravity=GRAVITY / LINK)  # all weight is the link's


@pytest.mark.parametrize("encoder", ["motor", "output"])
def test_servo_with_play_rests_where_its_law_balances_the_load_at_the_shaft_of_its_encoder(encoder):
    drive = ServoDrive(kp=0.5, gain=0.4, encoder=encoder)
    at = path(drive, np.full(60_000, 0.7), (*BASE, PLAY), np.append(SMOOTH, LINK))[-1]
    torque = 0.5 * 10.0 * 0.4 * (0.7 - at)
    behind = GAP + torque / (LINK * RESONANCE**2) if encoder == "motor" else 0.0  # of the link, which hangs
    assert torque == pytest.approx(GRAVITY * np.sin(at - behind), abs=1e-6)


@pytest.mark.parametrize(
    ("gap", "resonance", "term"),
    [(GAP, RESONANCE, PLAY), (0.0, 30.0, JointFlexibility(30.0, 20.0, GRAVITY / LINK))],
)
def test_controller_at_the_output_reads_the_link(gap, resonance, term):
    """Two bodies by an independent integrator; the log and the controller have the second."""
    drive, goal = ServoDrive(kp=0.6, kd=0.01, gain=0.4, encoder="output"), wave()

    def rate(t: float, q: float, v: float, ql: float, vl: float) -> tuple[float, float, float, float]:
        stretch = q - ql - min(max(q - ql, -gap), gap)
        pull = LINK * (resonance**2 * stretch + 20.0 * (v - vl) * (stretch != 0))
        torque = 4.0 * min(max(0.6 * (math.sin(3 * t) * min(t, 1.0) - ql) - 0.01 * vl, -1.0), 1.0)
        a = (torque - pull - VISCOUS * v) / (INERTIA - LINK)
        return v, a, vl, (pull - GRAVITY * math.sin(ql)) / LINK

    y, exact = [0.0] * 4, [0.0]
    for k in range(len(goal)):
        y = step_runge_kutta(rate, k * STEP, y, STEP)
        exact.append(y[2])
    followed = path(drive, goal, (*BASE, term), np.append(SMOOTH, LINK))
    at_motor = path(replace(drive, encoder="motor"), goal, (*BASE, term), np.append(SMOOTH, LINK))
    error = np.abs(followed - exact).max()
    assert error < 2e-3 * np.ptp(exact) and error < 0.1 * np.abs(at_motor - exact).max()


def test_servo_at_the_output_begins_where_its_encoder_says():
    drive = ServoDrive(kp=0.5, gain=0.4, encoder="output")
    goal, lifted = np.full(100, 0.7), np.full(1, 0.5)
    assert path(drive, goal, (*BASE, PLAY), np.append(SMOOTH, LINK), position=lifted)[0] == 0.5


@pytest.mark.parametrize("steps", [1, 7, 40])
def test_delay_is_exact_to_a_step(steps):
    goal = np.full(400, 1.0)
    drive = ServoDrive(kp=0.5, gain=0.4)
    late = path(replace(drive, delay=steps * STEP), goal)
    assert np.all(late[: steps + 1] == 0.0) and late[steps + 1] > 0.0
    # at first the whole torque accelerates: q = tau t^2 / 2 I
    assert late[steps + 1] == pytest.approx(0.5 * 10.0 * 0.4 * STEP**2 / (2 * INERTIA), rel=1e-3)


def test_controller_holds_its_output_between_its_turns():
    goal = np.zeros(200)
    goal[15:] = 1.0  # between two turns of a controller that looks every 10 steps
    moved = path(ServoDrive(kp=0.5, gain=0.4, rate=1 / (10 * STEP)), goal)
    assert np.all(moved[:21] == 0.0) and moved[21] > 0.0


@pytest.mark.parametrize("control", ["position", "velocity"])
def test_controller_sees_the_speed_between_the_positions_of_two_turns(control):
    turn, steps = 4e-3, 40
    drive = ServoDrive(control, "torque", kp=2.0 if control == "position" else 0.5, kd=0.3, rate=1 / turn, cutoff=30.0)
    goal = np.ones(100 * steps)

    def rate(t: float, q: float, v: float, torque: float) -> tuple[float, float, float]:
        return v, (torque - GRAVITY * math.sin(q) - VISCOUS * v) / INERTIA, 0.0

    y, before, seen, exact = [0.0, 0.0, 0.0], 0.0, 0.0, [0.0]
    for k in range(100):
        seen += (1 - math.exp(-2 * math.pi * drive.cutoff * turn)) * ((y[0] - before) / turn - seen)
        before = y[0]
        y[2] = drive.kp * (1.0 - seen) if drive.acts_on_speed else drive.kp * (1.0 - y[0]) - drive.kd * seen
        y = step_runge_kutta(rate, k * turn, y, turn)
        exact.append(y[0])
    assert path(drive, goal)[::steps] == pytest.approx(exact, abs=2e-4)


@pytest.mark.parametrize(
    ("rate", "error"), [(2000.0, 1e-4), (1300.0, 2e-3), (700.0, 1e-4), (333.0, 1e-4), (250.0, 1e-4)]
)
@pytest.mark.parametrize("kd", [0.0, 0.15])
def test_motion_does_not_depend_on_the_steps_of_the_integrator_between_the_looks_of_a_controller(rate, error, kd):
    """A stiff servo with goals held for 12 ms, integrated a hundred times as finely with each look at its time."""
    drive = ServoDrive(output="torque", kp=60.0, kd=kd, rate=rate, cutoff=60.0)
    fine, coarse, held, viscous = 1e-5, 1e-3, 12e-3, 0.5 - kd
    goals = 0.5 * np.sin(9.0 * held * np.arange(101))
    q = v = torque = before = speed = 0.0
    looks, exact, share = 0, [], 1 - math.exp(-2 * math.pi * 60.0 / rate)
    for k in range(120_000):
        if k * fine * rate > looks - 1e-6:
            speed += share * ((q - before) * rate - speed)
            before, looks = q, looks + 1
            torque = 60.0 * (float(goals[int(k * fine / held + 1e-6)]) - q) - kd * speed
        v += fine * (torque - GRAVITY * math.sin(q) - viscous * v) / INERTIA
        q += fine * v
        exact.append(q)
    times = ControllerSamples(rate, coarse, 1200)
    goal = times.average(goals[(times.time / held + 1e-6).astype(int)])
    theta = np.array([INERTIA, GRAVITY, viscous, 0.0])
    found = simulate_servos(BASE, theta[:, None], replace(servo(drive, goal), step=coarse))[1:, 0, 0]
    assert np.abs(found - exact[99::100]).max() < error * np.ptp(exact)


def test_dead_time_of_the_model_and_delay_of_the_drive_are_one():
    late = effect("dead_time")(dead_time=12 * STEP)
    drive = ServoDrive(kp=0.5, gain=0.4)
    own = path(drive, wave(), (*BASE, late))
    assert own == pytest.approx(path(replace(drive, delay=12 * STEP), wave()), abs=1e-12)


def test_open_motor_neither_drives_nor_brakes():
    off = np.zeros((3000, 1))
    start = {"position": np.array([1.0])}
    plain = path(ServoDrive(kp=5.0, gain=0.4), np.zeros(3000), **start, is_on=off)
    with_emf = path(
        ServoDrive(kp=5.0, gain=0.4), np.zeros(3000), (*BASE, BackEmf()), np.r_[SMOOTH, 0.5], **start, is_on=off
    )
    assert with_emf == pytest.approx(plain, abs=1e-12)
    assert plain[-1] != pytest.approx(1.0, abs=0.1)  # it swings


def test_integral_begins_anew_with_power():
    goal = np.full(20_000, 0.6)
    on = np.ones((len(goal), 1))
    on[1000:9000] = 0.0
    drive = ServoDrive(kp=0.5, ki=2.0, gain=0.4)
    assert path(drive, goal, is_on=on).max() < 1.3 * path(drive, goal).max()


def test_back_emf_is_viscous_friction_while_the_motor_is_on():
    drive = ServoDrive(kp=0.5, gain=0.4)
    braked = path(drive, wave(), (*BASE, BackEmf()), np.r_[SMOOTH, 0.2])
    assert braked == pytest.approx(path(drive, wave(), theta=SMOOTH + np.array([0.0, 0.0, 0.2, 0.0])), abs=1e-12)


def test_variants_and_servos_do_not_know_of_each_other():
    goals, two = (wave(), 0.5 * wave()), (ServoDrive(kp=0.5, gain=0.4), ServoDrive(kp=0.9, kd=0.05, gain=0.4))
    goal, rest = np.column_stack(goals), np.zeros(2)
    both = Servos(two, STEP, goal, np.full_like(goal, 10.0), np.ones_like(goal), rest, rest, rest, KnownLoad())
    other = SMOOTH * [1.5, 0.7, 1.2, 1.0]
    paths = simulate_servos(BASE, np.column_stack([SMOOTH, other]), both)
    assert paths[:, 1, 1] == pytest.approx(path(two[1], goals[1], theta=other), abs=1e-12)
    assert paths[:, 0, 0] == pytest.approx(path(two[0], goals[0]), abs=1e-12)


@pytest.mark.parametrize("every", [1, 10])
def test_a_servo_moves_alike_until_its_end_beside_a_longer_one(every):
    """Lanes of a batch of unequal logs end one by one."""
    drive, rest, goal = ServoDrive(kp=0.5, gain=0.4), np.zeros(3), np.column_stack([wave(), 0.5 * wave(), 2 * wave()])
    ends = np.array([len(goal), 4001, 12000])
    servos = Servos(
        (drive,) * 3, STEP, goal, np.full_like(goal, 10.0), np.ones_like(goal), rest, rest, rest, KnownLoad()
    )
    theta = np.column_stack([SMOOTH, SMOOTH * [1.5, 0.7, 1.2, 1.0]])
    whole, ended = (simulate_servos(BASE, theta, each, every) for each in (servos, replace(servos, ends=ends)))
    for lane, end in enumerate(-(-ends // every)):
        assert (ended[: end + 1, :, lane] == whole[: end + 1, :, lane]).all()
        assert (ended[end:, :, lane] == ended[end, :, lane]).all()


def test_law_that_is_no_formula_is_simulated_all_the_same():
    drive, goal = ServoDrive(kp=0.5, gain=0.4), wave(0.2)
    tabled, clipped = (path(drive, goal, (*BASE, kind()), np.r_[SMOOTH, 0.3]) for kind in (Table, Clipped))
    assert tabled == pytest.approx(clipped, abs=1e-12) and np.ptp(tabled) > 0.0


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-20, 20), st.floats(0.1, 3), st.floats(0, 1), st.floats(0.1, 1.5))
def test_torque_that_was_asked_for_is_bounded_and_odd(goal, position, velocity, kp, kd, limit):
    drive = ServoDrive(kp=kp, kd=kd, limit=limit, gain=0.4)
    ones = np.ones(1)
    told = drive.torque(goal * ones, position * ones, velocity * ones, 12 * ones, ones)
    turned = drive.torque(-goal * ones, -position * ones, -velocity * ones, 12 * ones, ones)
    assert np.abs(told) <= 12 * 0.4 * min(limit, 1.0) + 1e-12
    assert told == pytest.approx(-turned)
    assert drive.torque(goal * ones, position * ones, velocity * ones, 12 * ones, 0 * ones) == 0.0


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ({"kp": -1}, "0 or a positive"),
        ({"kp": 0}, "does not follow"),
        ({"preset": "xl330"}, "the controller has no gain"),
        ({"preset": "sts3215", "kp": 16, "kd": 32}, "leave it out"),
        ({"kp": 1, "control": "force"}, "position or velocity"),
        ({"kp": 1, "output": "power"}, "duty or voltage or current or torque"),
        ({"preset": "xl33"}, "xl330"),
        ({"kp": 1, "delay": 3.0}, "no controller is later"),
        ({"kp": 1, "supply": float("inf")}, "supply is inf: it should be a positive number"),
    ],
)
def test_drive_that_cannot_be_is_refused_with_the_reason(told, reason):
    with pytest.raises(ValueError, match=reason):
        ServoDrive.from_settings(told)


def test_drive_is_told_as_it_was_said():
    drive = ServoDrive.from_settings({"preset": "xl330", "kp": 200, "gain": 0.13, "rate": 1000})
    assert ServoDrive.from_settings(drive.get_settings()) == drive


@pytest.mark.parametrize(
    ("preset", "kp", "torque"),  # at 0.1 rad from the goal, for 0.5 N m/V, as their sources say
    [
        ("xl330", 400, 0.5 * 7.3 * 400 * 0.1 * 4096 / (2 * np.pi) / (256 * 885)),
        ("xl320", 32, 0.5 * 7.5 * 32 * 0.0505 * 0.1),
        ("mx", 32, 0.5 * 15.0 * 32 * 0.158 * 0.1),
        ("sts3215", 32, 0.5 * 7.4 * 32 * 0.166 * 0.1),
        ("sts3215", 320, 0.5 * 7.4 * 0.97),  # where its duty ends
        ("mit", 20, 20 * 0.1),
    ],
)
def test_a_preset_s_gain_is_that_of_the_servo_s_register(preset, kp, torque):
    drive = ServoDrive.from_settings({"preset": preset, "kp": kp, **({} if preset == "mit" else {"gain": 0.5})})
    one = np.ones(1)
    supply = one * (drive.supply or 1.0)
    assert drive.torque(0.1 * one, 0 * one, 0 * one, supply, one) == pytest.approx(torque)


def test_a_load_torque_drives_a_servo_that_hardly_follows():
    """Without a gain that counts, the motion is that of the joint under the load torque alone."""
    load = 0.5 * wave()
    drive = ServoDrive(output="torque", kp=1e-12)
    found = path(drive, 0 * load, load=KnownLoad(torque=load[:, None]))
    alone = simulate(BASE, SMOOTH, STEP, load, 0.0, 0.0).position[:, 0]
    np.testing.assert_allclose(found, alone, atol=1e-9)


@pytest.mark.parametrize(
    "drive",
    [
        ServoDrive(kp=0.5, ki=2.0, limit=0.25, gain=0.4, rate=100.0, windup="clamp", integral="before"),
        ServoDrive(kp=0.5, ki=2.0, limit=0.25, gain=0.4, rate=200.0, windup="free"),
        ServoDrive(kp=0.5, kd=0.02, limit=0.6, gain=0.4, rate=100.0, cutoff=10.0, derivative="error"),
    ],
)
def test_torque_that_a_controller_asks_for_along_a_motion_is_that_which_moves_the_joint(drive):
    """The impulse of the torque, less that of gravity and friction, is the momentum of the joint."""
    goal = np.where(np.arange(40_000) // 10_000 % 2, -0.8, 0.8)
    motion = path(drive, goal)[:-1]
    volts = np.full(len(goal[::50]), 10.0)
    moved = Recording(
        50 * STEP * np.arange(len(volts)),
        motion[::50],
        np.zeros(len(volts)),
        reference=goal[::50],
        supply=volts,
        drive=replace(drive, goal="held"),
    )
    torque = np.repeat(compute_commanded_torque(moved), 50)
    velocity = np.gradient(motion, STEP)
    impulse = STEP * np.cumsum(torque - GRAVITY * np.sin(motion) - VISCOUS * velocity)
    error = impulse[::50] - INERTIA * velocity[::50]
    assert np.abs(error).max() < 0.03 * np.abs(INERTIA * velocity).max()


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
def test_torque_of_a_controller_at_the_begin_of_each_segment_is_that_of_its_speed_there(rate):
    """A joint that swings through the begin of a log; a count a look is the error of the speed."""
    drive = ServoDrive(output="torque", kp=5.0, kd=0.1, rate=rate, goal="held", derivative="error")
    count, begins = math.tau / 4096, np.array([0.0, 3.0])
    time = np.add.outer(begins, np.arange(500) / 500.0)
    looks = np.add.outer(begins, np.floor(np.arange(500) / 500.0 * rate + 1e-6) / rate)
    position, seen, before = (0.8 * np.sin(4.0 * t + 2.0) for t in (time, looks, looks - 1.0 / rate))
    exact = -5.0 * seen - 0.1 * (seen - before) * rate
    still, rounded = np.zeros(time.size), count * np.round(position.ravel() / count)
    moved = Recording(time.ravel(), rounded, still, reference=still, drive=drive, starts=(0, 500))
    assert len(moved.segments) == 2
    error = compute_commanded_torque(moved).reshape(exact.shape) - exact
    assert np.abs(error[:, :2]).max() < 0.1 * count * 500.0
