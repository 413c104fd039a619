"""The length of a block: folds of the fits and blocks of the score follow it in every case."""

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.checks.channel import estimate_alignment
from estimators.decisions.criterion import Criterion
from estimators.decisions.score import FOLDS
from estimators.diagnosis.cases import choose_case
from estimators.diagnosis.options import Options
from estimators.online.gains import Gains
from estimators.regression.fold_fits import solve_without
from pendulum_env.physics import BASE, Term
from pendulum_env.recording import Recording
from robots.arms import arm_base
from robots.servos.drive import ServoDrive
from tests.cases import recording
from tests.two_link import body, record_arm

SECONDS = 8.0


def record_servo() -> Recording:
    """Goals and positions of a servo that is logged at 125 Hz."""
    experiment = Experiment(
        1000.0, SECONDS, "pd_loop", 0.5, 7, gains=(2.5, 0.0), counts=4096, torque_limit=6.0, control="servo"
    )
    (run,) = simulate([(Plant(0.012, 0.9, 0.05, 0.08), experiment)])
    drive = ServoDrive(output="torque", kp=2.5, limit=6.0, rate=1000.0)
    time, position, goal = run.time[::8], run.position[::8], run.goal[::8]
    ones = np.ones(len(time))
    torque = drive.torque(goal, position, 0 * ones, ones, ones)
    return Recording(time, position, torque, reference=goal, drive=drive, name="servo")


CASES = {
    "pendulum": lambda: (recording("moving"), BASE),
    "arm": lambda: (record_arm(seconds=SECONDS), arm_base(body())),
    "servo": lambda: (record_servo(), BASE),
}


@pytest.mark.parametrize("block", [1.0, 1.5])
@pytest.mark.parametrize("name", CASES)
def test_folds_and_score_have_the_same_blocks_of_the_given_length(name, block):
    run, base = CASES[name]()
    terms: Sequence[Term] = base
    case = choose_case(terms, [run])
    data, options = case.prepare([run], [run], Options(terms, {}, Criterion(block=block)))
    evidence = case.make_evidence(data, options)
    scored = evidence.train.layout.scored
    assert len(scored.of_block) == pytest.approx(run.duration / block, abs=1.0)
    folds = [np.unique(scored.fold[scored.block == k]) for k in np.unique(scored.block)]
    assert all(len(fold) == 1 for fold in folds)  # no fit without a fold sees a block that it predicts
    assert len(evidence.densities.compute(tuple(options.base))) == 2 * len(scored.of_block)
    rows = evidence.train.equations(options.base)
    kept = scored.fold != 0
    assert FOLDS > 1 and 0 < kept.sum() < len(rows.y)
    fits = evidence.train.maker.fit_folds(tuple(options.base))
    assert np.allclose(fits.theta_without_fold, solve_without(rows, scored.fold, FOLDS), rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("name", ["pendulum", "arm"])
def test_laws_of_the_torque_channel_are_compared_by_the_same_blocks(name):
    run, base = CASES[name]()
    counts = [estimate_alignment([run], base, Criterion(block=block)).density.size for block in (1.0, 2.0)]
    assert counts[0] == pytest.approx(run.duration, abs=1.0) and counts[1] == pytest.approx(counts[0] / 2, abs=1.0)


def test_online_gains_are_summed_over_the_same_blocks():
    gains = Gains(2, chunk_time=0.2, block=3.0)
    ends = []
    for k in range(1, 31):
        gains.take(np.zeros(3))
        ends += [k] if gains.has_block_ended else []
    assert ends == [15, 30]
