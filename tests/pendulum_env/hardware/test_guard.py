"""Each limit of the guard, on a drive that does as it is told, in a time that passes as it is told."""

import math
from contextlib import contextmanager
from dataclasses import replace

import pytest

from pendulum_env.backends.hardware import DriveError, Reading, Sent, driver_errors
from pendulum_env.backends.hardware import guard as guards
from pendulum_env.backends.hardware.config import FaultReaction, GuardLimits, PlantRanges, load
from pendulum_env.backends.hardware.guard import Fault, Guard

PER_RADIAN = 1_024_000 / (2 * math.pi)
DT = 0.005  # [s]
UNWATCHED = PlantRanges(watch=False)  # what these drives do is no motion of an arm


class Clock:
    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class FakeAdapter:
    """Turns as fast as it is told, and hangs for as long at each reading."""

    noise = 0.0

    def __init__(self, clock):
        self.clock, self.powered, self.sent, self.angle, self.fault, self.dead = clock, False, [], 0.0, None, False
        self.calls, self.hangs = [], 0.0

    def _reached(self, call, powered=None):
        self.calls.append(call)
        if self.dead:
            raise DriveError("the drive did not answer: check its cable")
        self.powered = self.powered if powered is None else powered

    def open(self):
        self._reached("open")

    def enable(self):
        self._reached("enable", True)

    def disable(self):
        self._reached("disable", False)

    def write(self, torque):
        self._reached("write")
        self.sent.append(torque)
        return Sent(self.clock.now, torque)

    def read(self):
        self._reached("read")
        self.clock.sleep(self.hangs)
        return Reading(self.clock.now, round(self.angle * PER_RADIAN) % 2**32, self.fault)

    def close(self):
        self.calls.append("close")


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(guards, "time", clock)
    return clock


@pytest.fixture
def make(clock, tmp_path):
    def make(checked=True, on_fault=None, torque_sign=1, plant=UNWATCHED, **limits):
        path = tmp_path / "rig.toml"
        path.write_text('adapter = "serial"\nrate = 200.0\n[serial]\nport = "/dev/none"\n')
        config = replace(
            load(path), checked=checked, torque_sign=torque_sign, limits=replace(GuardLimits(), **limits),
            fault=on_fault or FaultReaction(), plant=plant,
        )  # fmt: skip
        guard = Guard(FakeAdapter(clock), config)
        guard.open()
        guard.enable()
        guard.write(0.0)
        guard.read()
        return guard, guard.motor

    return make


def step(guard, clock, torque, velocity=0.0, dt=DT):
    """One period: a torque, then what the arm did; returns what the drive was sent."""
    guard.write(torque)
    clock.now += dt
    guard.motor.angle += velocity * dt
    guard.read()
    return guard.motor.sent[-1]


@contextmanager
def fault(guard, match):
    """What is done is a fault, which is kept, and the drive has neither torque nor power."""
    with pytest.raises(Fault, match=match):
        yield
    for again in (lambda: guard.write(1.0), guard.read, guard.enable) * 2:
        with pytest.raises(Fault, match=match):
            again()
    assert not guard.motor.powered
    assert guard.motor.sent[-1] == 0.0


@pytest.mark.parametrize("torque", [math.nan, -math.inf])
def test_what_is_no_number_is_refused(make, torque):
    guard, drive = make()
    with fault(guard, "was asked for: mend what computes it"):
        guard.write(torque)
    assert all(map(math.isfinite, drive.sent))


def test_torque_is_clamped_more_closely_until_the_check_has_passed(make, clock):
    for checked, most in ((True, 6.0), (False, 2.0)):
        guard, _ = make(checked, slew=1e9)
        assert [step(guard, clock, torque) for torque in (50.0, -50.0, 1.5)] == [most, -most, 1.5]


def test_torque_changes_no_faster_than_the_slew_limit(make, clock):
    guard, _ = make(slew=100.0)
    sent = [step(guard, clock, 3.0) for _ in range(10)]
    assert sent == pytest.approx([min(3.0, 100.0 * DT * k) for k in range(1, 11)])
    assert step(guard, clock, -3.0) == pytest.approx(3.0 - 100.0 * DT)


def test_torque_that_speeds_up_fades_out_and_torque_that_brakes_does_not(make, clock):
    guard, _ = make(slew=1e9, soft_velocity=10.0, hard_velocity=20.0)
    for velocity, speeding in ((5.0, 2.0), (15.0, 1.0), (19.0, 0.2)):
        for way in (1.0, -1.0):
            step(guard, clock, 0.0, way * velocity)
            assert step(guard, clock, way * 2.0, way * velocity) == pytest.approx(way * speeding, abs=0.01)
            assert step(guard, clock, -way * 2.0, way * velocity) == pytest.approx(-way * 2.0)


@pytest.mark.parametrize(
    ("limits", "sound", "wrong", "said"),
    [
        ({"hard_velocity": 30.0}, [(0.0, 29.0)], [(0.0, 31.0)], r"31 rad/s, 30 are allowed \(limits.hard_velocity\)"),
        ({}, [], [(0.0, 1.0 / DT)], "the encoder jumped by 1 rad"),
        ({"stall_torque": 4.0, "stall_time": 0.2}, 100 * [(3.9, 0.0)], 100 * [(5.0, 0.0)], "stand still under 5 N m"),
        (
            {"stall_torque": 4.0},
            [(5.0, -10.0 + 0.1 * k) for k in range(100)],  # it is braked
            [(5.0, -0.05 * k) for k in range(100)],
            "speeds up against 5 N m: the sign of the torque or of the encoder is wrong",
        ),
    ],
)
def test_an_arm_that_does_not_obey_is_a_fault(make, clock, limits, sound, wrong, said):
    guard, _ = make(**limits)
    for torque, velocity in sound:
        step(guard, clock, torque, velocity)
    with fault(guard, said):
        for torque, velocity in wrong:
            step(guard, clock, torque, velocity)


def test_a_swinging_arm_is_no_fault(make, clock):
    """A fast reversal of torque finds the arm moving against it, but slowing down."""
    guard, _ = make(stall_torque=4.0)
    for k in range(400):
        step(guard, clock, 6.0 * math.copysign(1.0, math.sin(10 * k * DT)), -8.0 * math.cos(10 * k * DT))
    assert guard.fault is None


@pytest.mark.parametrize("hangs", ["drive", "program"])
def test_a_loop_that_is_held_up_is_a_fault_which_says_for_how_long_the_drive_did(make, clock, hangs):
    guard, drive = make(gap=0.05)
    step(guard, clock, 1.0, dt=0.049)
    if hangs == "drive":
        drive.hangs = 0.02
    else:
        clock.sleep(0.02)
    guard.read()
    drive.hangs = 0.0
    took = {"drive": 20, "program": 0}[hangs]
    with fault(guard, rf"no command.* for 69 ms, 50 ms are allowed \(limits.gap\); the drive took {took} ms"):
        guard.write(1.0)
    assert drive.sent.count(1.0) == 1


def test_a_loop_that_does_not_keep_its_rate_is_a_fault(make):
    for late, said in (((0.0, 11), "11 ticks were missed, 10"), ((0.11, 0), "the loop is 110 ms behind, 100 ms")):
        guard, _ = make(overruns=10, behind=0.1)
        guard.check_lateness(0.09, 10)
        with fault(guard, f"{said} are allowed .* lower the rate, .* real-time priority"):
            guard.check_lateness(*late)


def test_a_fault_is_kept_until_it_is_cleared_and_the_first_one_counts(make, clock):
    guard, drive = make()
    drive.dead = True
    with pytest.raises(Fault, match="check its cable"):
        guard.read()
    assert drive.calls[-2:] == ["write", "disable"]  # at least it was tried
    guard.disable()
    guard.close()
    with pytest.raises(DriveError):
        guard.clear()  # it is still dead
    with pytest.raises(Fault, match="check its cable"):
        guard.enable()
    drive.dead = False
    guard.clear()
    guard.enable()
    assert drive.powered and step(guard, clock, 1.0) == 1.0


def test_there_is_no_torque_without_power(make):
    guard, drive = make()
    guard.write(1.0)
    guard.disable()
    assert (drive.sent[-1], drive.powered) == (0.0, False)
    with pytest.raises(Fault, match="has no power: reset"):
        guard.write(1.0)
    assert drive.sent[-1] == 0.0
    assert guard.fault is None  # a slip, not a fault
    guard.enable()
    guard.write(0.0)


@pytest.mark.parametrize(
    ("checked", "gained", "braked"),
    [
        (True, 0.0, True),
        (True, 60.0, True),  # with a wrong sign, braking speeds the arm up [rad/s^2], and would go on for 2 s
        (False, 0.0, False),  # with signs that nobody has tried, a brake may be a push
    ],
)
def test_braking_pushes_against_the_motion_and_ends(make, clock, checked, gained, braked):
    guard, drive = make(checked, FaultReaction("brake", gain=0.1, seconds=2.0), hard_velocity=10.0)
    speed, rest = [11.0], [clock.now + 2.0]

    def slept(seconds):
        clock.now += seconds
        speed[0] += gained * seconds
        drive.angle += speed[0] * seconds

    clock.sleep = slept
    with fault(guard, "hard_velocity"):
        step(guard, clock, 0.0, 11.0)
    assert speed[0] < 14.0 and clock.now < rest[0] + 0.1
    assert set(drive.sent) == {0.0} if not braked else drive.sent[-2] == pytest.approx(-0.1 * speed[0], rel=0.02)


def test_torque_and_power_go_before_a_word_is_written(make, monkeypatch):
    """A log on a busy disk may take its time."""
    guard, drive = make()
    guard.write(1.0)
    states = []
    monkeypatch.setattr(guard, "log_message", lambda *words: states.append((drive.sent[-1], drive.powered)))
    drive.fault = "over-current"
    with pytest.raises(Fault):
        guard.read()
    assert set(states) == {(0.0, False)}


def test_signs_of_the_wiring_are_taken_out_and_zero_is_where_the_arm_hangs_when_the_rig_is_opened(make, clock):
    guard, drive = make(torque_sign=-1)
    assert step(guard, clock, 2.0) == -2.0
    assert guard.torque == 2.0
    drive.angle += 1.0  # its counter loses its place
    guard.close()
    guard.open()
    assert guard.read()[1] == 0.0


def test_a_motion_that_no_such_arm_can_make_takes_the_torque(make, clock):
    """One principle whatever the fault: here the arm is said to stop dead under a torque that goes on."""
    guard, drive = make(plant=PlantRanges())
    speed = 0.0
    for _ in range(60):
        speed += DT * (3.5 - 0.9 - 0.36 * speed - 2.0 * math.sin(drive.angle)) / 0.09
        step(guard, clock, 3.5, speed)
    with fault(guard, r"cannot have moved so under 3\.5 N m, its speed changed by .* \[plant\] of"):
        for _ in range(6):
            step(guard, clock, 3.5, 0.0)


def test_whatever_a_driver_raises_is_an_error_of_the_drive():
    with (
        pytest.raises(DriveError, match=r"no answer \('x'\): check it"),
        driver_errors("no answer", "check it"),
    ):
        raise KeyError("x")
