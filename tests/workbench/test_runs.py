"""Recording until the verdict stands."""

from pathlib import Path

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.findings import Obstacle
from estimators.online import OnlineDiagnosis
from estimators.signals.measurements import Smoothing
from pendulum_env.physics import BASE
from pendulum_env.recording import read_recording
from workbench.judges import OnlineJudge, ProcessJudge, describe_verdict


def test_a_recording_ends_when_the_verdict_stands(tmp_path: Path, done) -> None:
    output = tmp_path / "run.csv"
    command = ["record", "--until", "diagnosed", "--effect", "cogging", "--rate", "500"]
    assert "missing: cogging torque (the verdict stands" in done(*command, "-o", output)
    assert 3.0 < read_recording(output).duration < 15.0


def test_a_process_of_its_own_says_the_same() -> None:
    plant = Plant(effects={"torque_offset": {"offset": 0.4}})
    (run,) = simulate([(plant, Experiment(rate=250.0, seconds=9.0, counts=65_536, torque_noise=0.05))])
    smoothing = Smoothing.of_encoder(65_536, 250.0)
    judges = OnlineJudge(250.0, smoothing), ProcessJudge(250.0, smoothing)
    stood = [False, False]
    for t, q, tau in zip(run.time[:2200], run.position, np.r_[0.0, run.torque[:-1]], strict=False):
        info = {"time": float(t), "position": float(q), "torque": float(tau)}
        stood = [judge.has_verdict(info) or before for judge, before in zip(judges, stood, strict=True)]
        if all(stood):
            break
    here, apart = (judge.close() for judge in judges)
    assert stood[0] and (here.kind, here.group) == (apart.kind, apart.group) and "torque_offset" in here.group
    assert "stands" in describe_verdict(here, True)


def test_what_was_not_tried_is_said_and_a_run_too_short_says_nothing_of_what_is_missing():
    not_run = {"backlash": Obstacle.HAS_STATE, "dead_time": Obstacle.IS_DELAY}
    said = OnlineDiagnosis("missing", BASE, group=("torque_saturation",), motion=3.0, not_run=not_run)
    missing, not_tried = describe_verdict(said, True).splitlines()
    assert missing.startswith("missing: torque saturation") and "3.0 s" in missing
    assert not_tried.endswith("backlash and dead time of the torque")
    assert "too short for a verdict" in describe_verdict(OnlineDiagnosis("calibrating", BASE), False)
    changed = OnlineDiagnosis("changed", BASE, motion=3.0, changed={"inertia": (0.03, 0.001)})
    assert "inertia" in describe_verdict(changed, False)
