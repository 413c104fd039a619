"""What the rig is for: parameters estimated while it runs, and a hidden effect found in what it recorded."""

import gc
import os
import signal
import sys
import time

import gymnasium as gym
import numpy as np
import pytest

from estimators import add
from estimators.wrappers import EstimateParameters
from pendulum_env.backends.hardware import DriveError
from pendulum_env.excitation import excitation
from pendulum_env.plant import PAPER, paper_plant
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import read_recording
from pendulum_env.registration import PENDULUM
from tests.pendulum_env.rigs import PATIENT, Disturbed
from workbench.cli import main

pytestmark = pytest.mark.realtime

ONLINE = 200.0  # [Hz], that leaves a busy machine time
TRUTH = np.array(list(PAPER.values()))
STILL = 0.03  # [s]
HANGING = {"zero": 0}
PUSH = np.array([2.0], dtype=np.float32)


def in_time(jitter):
    """What was measured while the machine stood still is interpolated, and no measurement."""
    worst = max(jitter)
    if worst > STILL:
        raise Disturbed(f"a sample was {worst:.3g} s late")


def make(rig, **options):
    return gym.make(PENDULUM, backend="dm1015b", config=rig.config, max_episode_steps=-1, **options)


def test_six_estimators_find_the_emulated_plant_while_it_runs(make_emulated_rig):
    rig = make_emulated_rig("serial", rate=ONLINE, limits=PATIENT, encoder=HANGING)
    signal = excitation("paper", np.random.default_rng(0))

    env = EstimateParameters(make(rig))
    infos = []
    rollout(env, OpenLoop(signal, rig.rate), int(4.0 * rig.rate), watch=infos.append)
    env.close()
    in_time(info["jitter"] for info in infos)
    if "fault" in infos[-1]:
        raise Disturbed(infos[-1]["fault"])
    assert len(infos[-1]["estimates"]) == 6
    for scheme, estimate in infos[-1]["estimates"].items():
        np.testing.assert_allclose([*estimate["theta"].values()], TRUTH, rtol=0.02, err_msg=scheme)


def test_a_recording_of_the_rig_shows_what_is_hidden_in_it(make_emulated_rig, capsys):
    rig = make_emulated_rig("serial", effects=["torque_offset=0.5"], limits=PATIENT, encoder=HANGING)
    path = rig.folder / "run.csv"
    command = ["record", "--backend", "dm1015b", "--config", str(rig.config), "--seconds", "3", "-o", str(path)]
    code, said = main(command), capsys.readouterr()
    if code != 0:
        raise Disturbed(said.err)
    assert "after their tick" in said.out
    in_time(np.loadtxt(path, delimiter=",", skiprows=1)[:, 3])
    found = add(paper_plant(), "torque_offset", path).after.model
    assert found["torque_offset"].value == pytest.approx(0.5, abs=0.03)


def test_record_keeps_what_was_measured_up_to_a_fault_and_says_so_in_one_line(make_emulated_rig, capsys, monkeypatch):
    rig = make_emulated_rig("serial", limits=PATIENT)
    step = OpenLoop.predict

    def trouble(self, observation, state=None, *rest):
        if state is not None and state[0] == 700:
            rig.process.kill()
        return step(self, observation, state, *rest)

    monkeypatch.setattr(OpenLoop, "predict", trouble)
    path = rig.folder / "run.csv"
    assert main(["record", "--backend", "dm1015b", "--config", str(rig.config), "-o", str(path)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    if "was lost" not in said and "did not answer" not in said:
        raise Disturbed(said)
    assert f"what was measured until then is in {path}" in said
    assert len(read_recording(path)) >= 700


def test_a_fault_ends_the_episode_and_is_kept_until_it_is_cleared(make_emulated_rig):
    rig = make_emulated_rig("serial", limits={**PATIENT, "stall_torque": 0.3, "stall_time": 0.05})
    env = EstimateParameters(make(rig))
    env.reset()
    terminated = False
    while not terminated:
        *_, terminated, _, info = env.step(np.array([0.5], dtype=np.float32))  # friction holds that
    assert "the counts stand still under 0.5 N m" in info["fault"]
    assert env.step(PUSH)[4]["fault"] == info["fault"]
    with pytest.raises(DriveError, match=r"stand still.*env.reset\(options={'clear_fault': True}\)"):
        env.reset()
    _, info = env.reset(options={"clear_fault": True})
    assert "fault" not in info
    *_, terminated, _, info = env.step(PUSH)
    assert not terminated
    env.close()
    assert rig.off_after() < 0.1


def test_a_slow_learner_trips_nothing_between_episodes(make_emulated_rig):
    """The first step gives power, the watchdog takes it after the last one if nobody else does; neither is a fault."""
    rig = make_emulated_rig("serial", limits={"behind": 5.0})  # with the watchdog at 80 ms
    env = gym.make(PENDULUM, backend="dm1015b", config=rig.config, max_episode_steps=5)
    for _ in range(2):
        _, info = env.reset()
        time.sleep(0.3)
        truncated = False
        while not truncated:
            *_, truncated, info = env.step(PUSH)
        if "fault" in info:
            raise Disturbed(info["fault"])
        time.sleep(0.3)
    env.close()
    assert [value for _, event, value in rig.events() if event == "power"] == [1.0, 0.0, 1.0, 0.0]
    assert rig.off_after() < 0.1


def test_an_environment_that_is_forgotten_lets_go(make_emulated_rig):
    rig = make_emulated_rig("serial", limits=PATIENT)
    env = make(rig)
    env.reset()
    env.step(PUSH)
    assert [value for _, event, value in rig.events() if event == "torque"][-1] != 0
    del env
    gc.collect()
    assert rig.off_after() < 0.5  # long before the watchdog
    make(rig).close()  # and it can be opened again


def test_handlers_of_signals_are_there_while_the_rig_is_open_and_restored_after(make_emulated_rig):
    rig = make_emulated_rig("serial", limits=PATIENT)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    heard = []
    signal.signal(signal.SIGHUP, lambda *_: heard.append("hup"))
    env = make(rig)
    env.reset()
    env.step(PUSH)
    os.kill(os.getpid(), signal.SIGHUP)
    assert heard == ["hup"]  # somebody else's handler has its turn, after the motor
    assert rig.off_after() < 0.5
    assert "has no power" in env.step(PUSH)[4]["fault"]
    env.close()
    signal.signal(signal.SIGHUP, before[2])
    assert [signal.getsignal(number) for number in numbers] == before


def test_an_interrupt_while_the_rig_is_closed_leaves_no_handler_behind(make_emulated_rig, monkeypatch):
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        pytest.skip("whoever started these tests has them ignore interrupts, as a shell does in the background")
    rig = make_emulated_rig("serial", limits=PATIENT)
    before = signal.getsignal(signal.SIGINT)
    env = make(rig)
    guard = env.unwrapped.backend.guard
    close = guard.motor.close
    monkeypatch.setattr(guard.motor, "close", lambda: (os.kill(os.getpid(), signal.SIGINT), close()))
    with pytest.raises(KeyboardInterrupt):
        env.close()
    monkeypatch.undo()
    assert signal.getsignal(signal.SIGINT) == before
    make(rig).close()  # all was let go


def test_a_missing_extra_is_named_with_the_command(monkeypatch, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text('adapter = "serial"\n[serial]\nport = "/dev/none"\n')
    monkeypatch.setitem(sys.modules, "serial", None)
    monkeypatch.delitem(sys.modules, "pendulum_env.backends.hardware.serial_adapter", raising=False)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'pendulum-ident\[hardware\]'"):
        gym.make(PENDULUM, backend="dm1015b", config=path)


def test_an_emulator_overwrites_no_real_rigs_configuration(tmp_path, capsys):
    pytest.importorskip("serial")
    path = tmp_path / "rig.toml"
    path.write_text('adapter = "serial"\n')
    assert main(["emulate", "serial", "-o", str(path)]) == 2
    assert "rig.toml: exists, and no emulator wrote it" in capsys.readouterr().err
    assert path.read_text() == 'adapter = "serial"\n' and not path.with_name("rig.toml.checked").exists()
