"""What an adapter itself has to notice, with a drive that does not as it should."""

import os

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.emulators.serial import Firmware
from pendulum_env.backends.hardware import DriveError, find_adapter, frames
from pendulum_env.backends.hardware.config import load
from pendulum_env.backends.hardware.encoder import DeviceClock
from pendulum_env.plant import paper_plant
from pendulum_env.registration import PENDULUM
from tests.pendulum_env.rigs import PATIENT

pytestmark = [pytest.mark.realtime, pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals of Unix")]


def opened(make_emulated_rig, kind, **tables):
    rig = make_emulated_rig(kind, limits=PATIENT, **tables)
    drive = find_adapter((config := load(rig.config)).adapter)(config)
    try:
        drive.open()
    except DriveError:
        drive.close()
        raise
    return rig, drive


def test_power_that_is_gone_without_a_word_is_a_fault(make_emulated_rig):
    """A microcontroller that starts anew has no power and no fault to tell of."""
    _, drive = opened(make_emulated_rig, "serial")
    assert drive.read().fault is None  # nobody has asked for power yet
    drive.enable()
    assert drive.read().fault is None
    drive._request(frames.POWER, 0)  # behind the adapter's back
    assert "it has no power any more" in drive.read().fault
    drive.close()


def test_a_torque_that_the_firmware_refuses_is_a_fault(make_emulated_rig):
    """It knows what the motor stands, and keeps the last torque that was within."""
    _, drive = opened(make_emulated_rig, "serial")
    drive.enable()
    for torque, fault in ((1.0, False), (20.0, True)):
        for _ in range(10):
            drive.write(torque)
            why = drive.read().fault
        assert (why is not None and "does not set 20 N m" in why) == fault
    drive.disable()
    drive.close()


class Port:
    """A serial port with a firmware behind it, and a clock of its own; answers are late, and the first is lost."""

    def __init__(self, late: float) -> None:
        self.now, self.late, self.in_waiting, self.timeout = 0.0, late, 0, 0.01
        self.firmware, self.coming = Firmware(Motor(paper_plant())), []

    def monotonic(self) -> float:
        return self.now

    def write(self, data: bytes) -> None:
        self.coming.append((self.now + self.late, self.firmware.answer(data)))

    def read(self, most: int) -> bytes:
        if most and self.coming and self.coming[0][0] <= self.now + self.timeout:
            self.now, data = self.coming.pop(0)
            return data
        self.now += self.timeout * bool(most)
        return b""


@pytest.mark.parametrize(("late", "lost", "reply"), [(0.001, True, 0.25), (0.025, False, 0.08)])
def test_no_run_ends_for_an_answer_that_is_lost_or_late(tmp_path, monkeypatch, late, lost, reply):
    rig = f'adapter = "serial"\nrate = 500\n[serial]\nport = "-"\n[limits]\nreply = {reply}\n'
    (tmp_path / "rig.toml").write_text(rig)
    config = load(tmp_path / "rig.toml")
    drive, port = find_adapter(config.adapter)(config), Port(late)
    drive._port, drive._sequence, drive._clock, drive._splitter = port, 0, DeviceClock(), frames.Splitter()
    monkeypatch.setattr("pendulum_env.backends.hardware.serial_adapter.time", port)
    port.firmware.answer = lambda data, answer=port.firmware.answer: answer(data) if port.now or not lost else b""
    assert drive.read().counts == 0
    assert port.now < 0.6 * config.limits.gap


@pytest.mark.parametrize(
    ("kind", "keys", "said"),
    [
        ("serial", 'port = "/dev/none"', "/dev/none cannot be opened .*check serial.port"),
        ("nidaq", 'torque = "Dev1/ao0"\nencoder = "Dev1/ctr0"\nenable = "Dev1/port0/line0"', "driver is not installed"),
    ],
)
def test_what_is_not_there_is_named_with_its_key(tmp_path, kind, keys, said):
    path = tmp_path / "rig.toml"
    path.write_text(f'adapter = "{kind}"\n[{kind}]\n{keys}\n')
    try:
        find_adapter(kind)
    except ModuleNotFoundError as error:
        pytest.skip(str(error))
    with pytest.raises(DriveError, match=said):
        gym.make(PENDULUM, backend="dm1015b", config=path)


def test_a_voltage_that_reaches_less_torque_says_so(make_emulated_rig):
    """10 V are 15 N m here, and 5 N m at the scale in the file: more than these cannot be sent."""
    _, drive = opened(make_emulated_rig, "nidaq", nidaq={"newton_metres_per_volt": 0.5, "volts_offset": 1.0})
    drive.enable()
    sent = [drive.write(torque).torque for torque in (3.0, 6.0, -6.0)]
    drive.disable()
    drive.close()
    np.testing.assert_allclose(sent, [3.0, 4.5, -5.5])


def test_servo_enable_falls_although_the_voltage_cannot_be_set(make_emulated_rig, monkeypatch):
    rig, drive = opened(make_emulated_rig, "nidaq")
    drive.enable()

    def broken(torque):
        raise ValueError("the output is gone")

    monkeypatch.setattr(drive, "_set_voltage", broken)
    with pytest.raises(DriveError, match="the output is gone"):
        drive.disable()
    assert [value for _, event, value in rig.events() if event == "power"] == [1.0, 0.0]
    drive.close()
