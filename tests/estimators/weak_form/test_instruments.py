"""Instruments of the reference: right where a disturbance that a controller answers misleads least squares."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.excitation import smooth_reference
from benchmarks.independent_plant import Experiment, Plant
from estimators import IdentificationError
from estimators.arguments import apply_limits
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.weak_form.instruments import fit_by_reference
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, effect
from pendulum_env.recording import Recording
from tests.cases import TRUTH, recorded


@pytest.fixture(scope="module")
def disturbed() -> list[Recording]:
    """Six runs in which a random torque as large as friction drives the controller."""
    plant = Plant(effects={"random_walk_torque": {"walk_rms": 1.2, "walk_T": 0.15}})
    experiments = [Experiment(500.0, 20.0, "pd_loop", 0.6, seed, gains=(40.0, 4.0)) for seed in range(6)]
    return [
        replace(run, reference=smooth_reference(np.random.default_rng([e.seed, 0]), run.time, e.scale))
        for run, e in zip(recorded(plant, *experiments), experiments, strict=True)
    ]


def test_instruments_are_unbiased_where_least_squares_finds_the_controller(disturbed):
    least_squares = fit_terms(RegressionData.from_recordings(disturbed), BASE)[0].theta
    model = fit_by_reference(prepare_windows(disturbed), BASE)
    off = np.abs(model.theta - TRUTH)
    std = np.array([estimate.std for estimate in model.estimates.values()])
    assert (off < 3 * std).all()
    assert (off < np.abs(least_squares - TRUTH))[:2].all()  # inertia and gravity


def test_what_is_known_beforehand_stays_so_beside_instruments(disturbed):
    known, _ = apply_limits(BASE, {}, {"gravity": 1.9}, {"viscous": (0.0, 0.1)})
    model = fit_by_reference(prepare_windows(disturbed), known)
    assert model.estimates["gravity"].value == 1.9
    assert model.estimates["viscous"].value == 0.1
    assert model.estimates["inertia"].value == pytest.approx(TRUTH[0], rel=0.1)


def test_what_instruments_cannot_do_is_refused(disturbed):
    run, still = disturbed[0], np.zeros(len(disturbed[0]))
    for recording, terms, why in (
        (replace(run, reference=None), BASE, "has no reference"),
        (run, (*BASE, effect("dead_time")()), "dead_time depends on more than the motion"),
        (replace(run, reference=still), BASE, "reference moves too little"),
    ):
        with pytest.raises(IdentificationError, match=why):
            fit_by_reference(prepare_windows([recording]), terms)
