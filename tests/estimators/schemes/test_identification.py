from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.completeness import Incomplete
from estimators.diagnosis.run import diagnose
from estimators.identification import SlowedFilter, identify
from estimators.regression.least_squares import IdentificationError
from estimators.schemes import six
from estimators.schemes.six import PAPER, SCHEMES, Integral
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.windows import cut
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Model, simulate
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import Recording
from tests.cases import PLANT, TRUTH, recorded
from workbench.narrator.diagnosis import describe_result


def std(model: Model) -> np.ndarray:
    return np.array([model.estimates[column.name].std for column in model.columns])


@pytest.mark.slow
def test_standard_errors_are_honest():
    """Errors in standard errors have a root mean square near one over 18 recordings, the paper's energy included."""
    rng, z = np.random.default_rng(0), {}
    excitations = ["two_tone", "multisine", "chirp"]
    schemes = (*SCHEMES, six.scheme("energy", operator=Integral(None)))
    of_all = {"rate": 500.0, "seconds": 10.0, "torque_noise": 0.0}
    for clean in recorded(PLANT, *(Experiment(excitation=e, seed=k, **of_all) for k, e in enumerate(excitations))):
        for _ in range(6):  # only the noise differs
            noisy = clean.torque + 0.05 * rng.standard_normal(len(clean))
            for among in (SCHEMES, schemes[len(SCHEMES) :]):  # ids are unique within each
                result = identify(replace(clean, torque=noisy), schemes=among)
                for scheme in among:
                    error = result[scheme.id].model.theta - TRUTH
                    z.setdefault(scheme, []).append(error / std(result[scheme.id].model))
    for scheme in schemes:
        rms = float(np.sqrt(np.mean(np.square(z[scheme]))))
        assert 0.6 < rms < 1.5, scheme


def test_fast_rotation_does_not_bias_gravity():
    """The angle turns by up to two radians within the filter of a coarse encoder, so sin q is not that of its mean."""
    plant = Plant(inertia=0.09, gravity=2.0, viscous=0.03, coulomb=0.15)
    fast = {"rate": 200.0, "seconds": 15.0, "counts": 8192, "torque_noise": 0.0, "start": (0.0, 25.0)}
    truth = np.array([plant.inertia, plant.gravity, plant.viscous, plant.coulomb])
    for seed in range(2):
        for scheme, result in identify(recorded(plant, Experiment(seed=seed, **fast))).items():
            assert np.all(np.abs(result.model.theta - truth) < 3 * std(result.model)), scheme
            assert result.model.theta[1] == pytest.approx(2.0, rel=1e-3), scheme


def test_convergence_ends_at_the_model(paper_run):
    found = identify([paper_run])
    for scheme in SCHEMES:
        result = found[scheme.id]
        assert result.convergence.theta.shape == (200, 4)
        np.testing.assert_allclose(result.convergence.theta[-1], result.model.theta, rtol=1e-6)
        np.testing.assert_allclose(result.convergence.std[-1], std(result.model), rtol=1e-6)
        assert result.convergence.time[-1] == pytest.approx(paper_run.duration, abs=0.1)
        told = result.json()  # by name, as the estimates
        assert told["convergence"]["theta"].keys() == told["convergence"]["std"].keys() == told["theta"].keys()
        assert told["convergence"]["theta"]["gravity"] == result.convergence.theta[:, 1].tolist()


def test_the_papers_hamiltonian_pair_borrows_inertia(paper_run):
    found = identify([paper_run], schemes=PAPER)
    for borrower, lender in (("hamiltonian", "dynamic"), ("filtered_hamiltonian", "filtered_dynamic")):
        np.testing.assert_allclose(found[borrower].model.theta, found[lender].model.theta, rtol=1e-4)
        np.testing.assert_allclose(std(found[borrower].model), std(found[lender].model), rtol=0.1)
        assert found[borrower].model.estimates["inertia"] == found[lender].model.estimates["inertia"]
        assert np.all(found[borrower].convergence.theta[:, 0] == found[lender].model.theta[0])
    with pytest.raises(ValueError, match="put dynamic before it"):
        identify([paper_run], schemes=[six.scheme("hamiltonian", borrows="dynamic")])


@pytest.mark.slow
def test_the_fit_over_windows_is_the_one_that_a_diagnosis_begins_with(paper_run):
    found = identify([paper_run], schemes="energy", fixed={"gravity": 2.0})
    data = prepare_windows([paper_run])
    model, _ = fit_terms(RegressionData(data, ()), found["energy"].model.terms)
    np.testing.assert_array_equal(found.least_squares.theta, model.theta)
    assert found.least_squares.estimates["gravity"].value == 2.0
    with pytest.raises(IdentificationError, match="too little of the motion is clear of stick"):
        _ = replace(found, data=None).least_squares


def test_model_of_an_identification_is_the_fit_over_windows_or_that_of_the_only_scheme(paper_run):
    one, several = (identify([paper_run], schemes=schemes) for schemes in ("energy", ["energy", "dynamic"]))
    assert one.model is one["energy"].model and several.model is several.least_squares
    assert several.model.estimates.keys() == one.model.estimates.keys()


def test_several_recordings_share_one_set_of_parameters():
    """The coarse one counts less, and filters do not run from one into the next."""
    fine, other = recorded(PLANT, *(Experiment(rate=500.0, seconds=8.0, seed=seed) for seed in range(2)))
    count = 2 * np.pi / 2048
    coarse = replace(other, position=np.round(other.position / count) * count + 16 * np.pi)
    joint, alone = identify([fine, coarse]), identify([fine])
    for scheme in SCHEMES:
        np.testing.assert_allclose(joint[scheme.id].model.theta, TRUTH, rtol=0.01)
        assert np.abs(joint[scheme.id].model.theta / alone[scheme.id].model.theta - 1).max() < 0.005
    assert joint["dynamic"].convergence.time[-1] == pytest.approx(16.0, abs=0.3)


def test_slow_sampling_lowers_the_filters_and_says_so():
    found = identify(recorded(PLANT, Experiment(rate=50.0, seconds=20.0, counts=None, torque_noise=0.0)))
    (finding,) = found.findings
    assert isinstance(finding, SlowedFilter) and finding.rate.value == pytest.approx(50.0)
    for scheme in SCHEMES:
        np.testing.assert_allclose(found[scheme.id].model.theta, TRUTH, rtol=0.03)


def test_what_the_terms_lack_is_said_in_one_line_and_nothing_where_they_lack_nothing():
    """Friction that has a peak near rest: each scheme takes it for something else."""
    plants = {"whole": paper_plant(), "lacking": hide(paper_plant(), "stribeck=0.45")}
    runs = {name: record(plant, excitation("paper", 1), 15, rng=1) for name, plant in plants.items()}
    found = {name: identify(run) for name, run in runs.items()}
    assert not any(isinstance(one, Incomplete) for one in found["whole"].findings)
    (incomplete,) = (one for one in found["lacking"].findings if isinstance(one, Incomplete))
    assert None not in (incomplete.noise_ratio, incomplete.disagreement) and "coulomb" in incomplete.parameters
    for name, run in runs.items():  # all estimates of an incomplete model are biased, also by a single scheme
        (alone,) = identify(run, schemes="energy").values()
        models = [found[name].least_squares, alone.model, *(scheme.model for scheme in found[name].values())]
        estimates = [estimate for model in models for estimate in model.estimates.values()]
        assert {estimate.is_biased for estimate in estimates} == {name == "lacking"}
    fixed = identify(runs["lacking"], fixed={"inertia": plants["lacking"].estimates["inertia"].value})
    for scheme in fixed.values():  # a known value is no estimate
        assert {id for id, estimate in scheme.model.estimates.items() if not estimate.is_biased} == {"inertia"}


def test_torque_that_was_asked_of_an_open_motor_did_not_act():
    time = np.arange(8000) / 500.0
    asked, enabled = 2 * np.sin(3 * time) + np.sin(7.3 * time), (time % 4.0 < 3.0).astype(float)
    theta = [0.02, 0.9, 0.05, 0.08]
    position = simulate(BASE, np.array(theta), 1 / 500.0, asked * enabled, 0.0, 0.0).position[: len(time), 0]
    run = Recording(time, position, asked, enabled=enabled, name="run")
    assert not run.torque[enabled == 0].any() and run.torque[enabled == 1] == pytest.approx(asked[enabled == 1])
    assert identify(run)["dynamic"].model.theta == pytest.approx(theta, rel=0.01, abs=1e-3)
    assert describe_result(diagnose(run, only=["stribeck"])) == "Nothing is missing"
    short = run.slice(1450, 1510)
    assert len(cut(short, 0.04).centers) == 0  # the motor is off in half of it
