"""A diagnosis in a process of its own says the same, and its loop never waits for a fit."""

import multiprocessing

import gymnasium as gym
import numpy as np
import pytest

from estimators.online.worker import DiagnoserProcess
from estimators.wrappers import DiagnoseOnline
from pendulum_env.physics.library import effect
from pendulum_env.registration import PENDULUM
from tests.estimators.online.test_diagnosis import RATE, diagnoser, recorded, run

LIBRARY = {id: effect(id) for id in ("cogging", "quadratic_drag", "stribeck")}


@pytest.fixture
def process():
    """A diagnosis in a process, which ends with the test."""
    one = DiagnoserProcess(diagnoser(library=LIBRARY))
    yield one
    one.close()


def wait(process):
    """Wait until all samples are taken."""
    with pytest.raises(ValueError, match="did you mean cogging"):
        process.each[0].add("coging")
    return process.diagnoses[0]


def test_the_process_says_what_the_diagnosis_says(process):
    here = diagnoser(library=LIBRARY)
    run(process, recorded("cogging"), last=6.0)
    assert repr(wait(process)) == repr(run(here, recorded("cogging"), last=6.0)) and process.diagnoses[0].group
    assert repr(process.each[0].add("cogging")) == repr(here.each[0].add("cogging"))
    run(process, recorded("cogging"), first=6.0, last=9.0)
    assert repr(wait(process)) == repr(run(here, recorded("cogging"), first=6.0, last=9.0))
    assert process.each[0].diagnosis.added == ("cogging",)
    process.each[0].undo()
    with pytest.raises(ValueError, match="call add first"):
        process.each[0].undo()
    process.reset()
    assert process.diagnoses[0].kind == wait(process).kind == "calibrating"


def test_an_environment_is_diagnosed_by_its_worker():
    env = DiagnoseOnline(gym.make(PENDULUM, rate=RATE), candidates=["cogging"], worker=True)
    env.reset(seed=0)
    for k in range(500):
        *_, info = env.step(np.array([4.0 * np.sin(0.05 * k)], dtype=np.float32))
    with pytest.raises(ValueError, match=r"not been tried|unknown effect"):
        env.add("stribeck")
    assert env.diagnoser.diagnosis.kind in ("calibrating", "nothing") and info["diagnosis"].threshold > 0
    env.close()
    assert not multiprocessing.active_children()
