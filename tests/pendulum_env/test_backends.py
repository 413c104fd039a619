"""One contract for every backend: simulated, replayed, and the rig over each of its adapters and a package's."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.excitation import excitation
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import read_recording, write_recording
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RecordMeasurements
from tests.pendulum_env.packages import install_bench
from tests.pendulum_env.rigs import KINDS, PATIENT, Disturbed

pytestmark = pytest.mark.realtime

PUSH = np.array([2.0], dtype=np.float32)  # [N m], enough to move the arm


@pytest.fixture(params=["pymunk", "mujoco", "replay", *KINDS, "package"])
def settings(request, tmp_path, monkeypatch):
    """Arguments with which the environment has each backend."""
    if request.param == "replay":
        file = tmp_path / "played.csv"
        signal = excitation("paper", np.random.default_rng(0))
        write_recording(rollout(gym.make(PENDULUM), OpenLoop(signal, 1000.0), 1500, seed=0), file)
        return {"backend": "replay", "recording": file}
    if request.param in KINDS:
        rig = request.getfixturevalue("make_emulated_rig")(request.param, limits=PATIENT, first=2**31 - 1000)
        return {"backend": "dm1015b", "config": rig.config}
    if request.param == "package":
        install_bench(tmp_path, monkeypatch)
        limits = "".join(f"{name} = {value}\n" for name, value in {**PATIENT, "behind": 60.0}.items())
        file = tmp_path / "rig.toml"
        file.write_text(f'adapter = "bench"\nrate = 200\n[bench]\naddress = "left"\n[limits]\n{limits}')
        return {"backend": "dm1015b", "config": file}
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    return {"backend": request.param}


def test_an_environment_keeps_its_contract(settings, tmp_path):
    path = tmp_path / "run.csv"
    with RecordMeasurements(gym.make(PENDULUM, **settings), path, overwrite=True) as env:  # of a disturbed attempt
        rate = env.unwrapped.rate
        for episode in (1, 2):
            observation, info = env.reset(seed=episode)
            assert env.observation_space.contains(observation)
            assert (info["time"], info["torque"]) == (0.0, 0.0)
            start, spent = info["position"], 0.0
            for k in range(1, int(1.02 * rate)):
                before = info
                observation, reward, terminated, truncated, info = env.step(PUSH)
                if "fault" in info:
                    raise Disturbed(info["fault"])
                assert (reward, terminated, truncated) == (0.0, False, False)
                assert env.observation_space.contains(observation)
                assert info["time"] == pytest.approx(k / rate, abs=1e-9)
                assert info["velocity"] == pytest.approx((info["position"] - before["position"]) * rate, abs=1e-6)
                q = info["position"]
                np.testing.assert_allclose(observation[:2], [np.cos(q), np.sin(q)], atol=1e-6)
                spent += info["torque"] / rate
            if info["follows"]:
                assert 0.05 < info["position"] - start < 3.0  # the way it was pushed, also where the counter rolls over
                assert info["torque"] == pytest.approx(2.0, abs=0.01)
                assert spent == pytest.approx(2.0 * info["time"], rel=0.1)  # what came late is accounted for
    env.close()  # once more
    for name in ("run.csv", "run-2.csv"):
        assert read_recording(tmp_path / name).rate == pytest.approx(rate)
