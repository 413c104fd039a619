"""What a person goes through with a new rig, with somebody who does as told beside an emulated one."""

import io
import re
import time

import pytest

from pendulum_env.backends.hardware.config import load
from tests import slow
from tests.pendulum_env.rigs import PATIENT, Disturbed
from workbench.cli import main
from workbench.commands.hardware import STEPS, CheckFailed, check_rig

pytestmark = pytest.mark.realtime


class Helper:
    def __init__(self, rig):
        self.rig, self.said, self.asked = rig, [], []

    def print(self, text):
        self.said.append(text)

    def confirm(self, text):
        self.asked.append(text)
        if "quarter turn" in text:
            self._hand("hold 90")
        elif "hang down" in text:
            self._hand("hold 0")
            self._hand("hold")
        return True

    def _hand(self, does):
        self.rig.tell(does)
        self.rig.heard(b"hold")
        time.sleep(1.2)


def checked(rig):
    helper = Helper(rig)
    check_rig(load(rig.config), helper.print, helper.confirm)
    return helper


def wired(make_emulated_rig, kind, *, top="", **encoder):
    rig = make_emulated_rig(kind, limits=PATIENT, encoder={"counts": 1_024_000, **encoder})
    rig.config.with_name("rig.toml.checked").unlink()
    rig.config.write_text(top + rig.config.read_text())
    return rig


def told(failed, remedy):
    """What failed is what was wrong, and not a push that the machine slept through."""
    if not re.search(remedy, str(failed.value)):
        raise Disturbed(failed.value)


@pytest.mark.parametrize("kind", slow.but_first(["serial", "nidaq"]))
def test_a_rig_that_is_wired_right_passes_and_may_use_its_torque(make_emulated_rig, kind):
    rig = wired(make_emulated_rig, kind)
    assert load(rig.config).max_torque == 2.0
    helper = checked(rig)
    assert load(rig.config).max_torque == 6.0
    assert len(helper.said) == 2 * len(STEPS) + 1
    turned, hung = (float(re.search(r"(\d+)(?:\.\d)? degrees", helper.said[k])[1]) for k in (3, 5))
    assert turned == pytest.approx(90, abs=2) and hung <= 3  # as the hand held it
    assert "the drive let go by itself" in helper.said[-2]
    torques = [abs(value) for _, event, value in rig.events() if event == "command"]
    assert 0.3 < max(torques) <= 2.0 + 1e-6
    assert [value for _, event, value in rig.events() if event == "power"][-1] == 0


@pytest.mark.parametrize(
    ("wrong", "remedy"),
    [
        ({"sign": -1}, "the counts go the wrong way: set encoder.sign = 1"),
        ({"counts": 256_000}, "a quarter turn came as .* degrees: encoder.counts is nearer to"),
        ({"top": "torque_sign = -1\n"}, "set torque_sign = 1"),
    ],
)
def test_a_rig_that_is_wired_wrong_is_told_what_to_change(make_emulated_rig, wrong, remedy):
    rig = wired(make_emulated_rig, "serial", **wrong)
    with pytest.raises(CheckFailed) as failed:
        checked(rig)
    told(failed, remedy)
    assert load(rig.config).max_torque == 2.0
    assert [0.0, *(value for _, event, value in rig.events() if event == "power")][-1] == 0


def test_a_servo_enable_that_does_nothing_is_found(make_emulated_rig, monkeypatch):
    """Then no watchdog could take the torque away either."""
    rig = wired(make_emulated_rig, "nidaq")
    from pendulum_env.backends.hardware.nidaq import NiDaq

    reserve = NiDaq._reserve_channels

    def always_on(self):
        reserve(self)
        self._enable.write_one_sample_one_line(True, 1.0)

    monkeypatch.setattr(NiDaq, "_reserve_channels", always_on)
    with pytest.raises(CheckFailed) as failed:
        checked(rig)
    told(failed, "moves without power")
    commands = [value for _, event, value in rig.events() if event == "command"]
    assert max(commands) < 2.0 and commands[-1] == 0.0


def test_the_check_on_the_command_line(make_emulated_rig, monkeypatch, capsys):
    rig = wired(make_emulated_rig, "serial")
    for answers, said in (
        (["", "n"], "software is never the emergency stop"),
        ([], "asks questions: run it in a terminal"),
    ):
        monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(answers)))
        assert main(["hardware", "check", str(rig.config)]) == 2
        out = capsys.readouterr()
        assert "1 of 6: wiring" in out.out and said in out.err
    assert not rig.events()  # nothing was powered
    assert main(["hardware", "check", "nowhere.toml"]) == 2
    assert "nowhere.toml: cannot be read" in capsys.readouterr().err
