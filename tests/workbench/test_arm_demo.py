from functools import partial

import numpy as np
import pytest

from estimators import Diagnosis, diagnose
from estimators.selection.errors import Step
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.recording import read_arm_recording
from pendulum_env.physics import Model
from workbench.commands import demo
from workbench.commands.demo import verdict

ALIKE = ("stribeck@elbow", "spring@elbow")


def test_the_demo_finds_what_it_hides_and_tells_the_truth(tmp_path, monkeypatch, done):
    few = ("load_dependent_friction", "stribeck", "spring")  # else it takes long
    monkeypatch.setattr(demo, "diagnose", partial(diagnose, only=few))
    monkeypatch.setattr(demo, "SECONDS", 5.0)
    report, files = tmp_path / "r.html", [tmp_path / f"r.{part}.csv" for part in ("train", "holdout")]
    told = done("demo", "--robot", "two-link", "--seed", "2", "-o", report)
    hidden = "load_dependent_friction@elbow"  # of which the elbow shows nothing: its links' parameters imitate it there
    assert f"Missing: {hidden}" in told and f"hidden was {hidden}: (mu |tau| + mu_o |w sin q|) sgn q'" in told
    assert "\nfound\n" in told
    rows = {line.split()[0]: line.split() for line in told.splitlines() if "@" in line and "±" in line}
    for name in ("mz@shoulder", "Iyy@elbow", "coulomb@elbow"):  # the file has other masses
        assert float(rows[name][2]) == pytest.approx(float(rows[name][1]), rel=0.01)
    assert all(len(read_arm_recording(file, ("shoulder", "elbow"))) == 5000 for file in files)
    assert report.stat().st_size > 0


def test_every_effect_that_may_be_hidden_can_be_simulated():
    seen = set()
    for seed in range(60):
        hidden = demo.hide_somewhere(np.random.default_rng(seed))
        PlanarArm(effects=[hidden]).reset()
        seen.add(hidden.partition("@")[0])
    assert len(seen) > 12


@pytest.mark.parametrize(
    ("selected", "ambiguous", "told"),
    [
        (("spring@elbow",), (), "found"),
        (("stribeck@elbow",), (ALIKE,), "found as one of a group that looks the same: spring@elbow and stribeck@"),
        (("stribeck@elbow",), (), "NOT found as it is: the diagnosis says stribeck@elbow"),
        ((), (), "NOT found as it is: the diagnosis says nothing"),
        (("spring@elbow", "stribeck@elbow"), (), "NOT found as it is"),
    ],
)
def test_the_verdict_is_honest(selected, ambiguous, told):
    found = Diagnosis(tuple(Step(one, Model(), {}) for one in (None, *selected)), (), ambiguous, (), 0.0, ())
    assert verdict(["spring@elbow"], found).startswith(told)
