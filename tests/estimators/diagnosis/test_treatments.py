"""Treatments of the recordings: which are kept, and what a diagnosis records of them."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import Diagnosis, add, compare, diagnose
from estimators.data.treatment import Action, Treatment
from pendulum_env.physics import BASE, Model
from pendulum_env.physics.potential import Spring
from pendulum_env.recording import Recording
from tests.cases import diagnosed

RATE, SECONDS = 500.0, 20.0
GATES = {"gain", "p_value", "tie_probability", "assumptions"}  # of treatments without a purpose


def diagnosed_under_chirps(plant: Plant, *only: str, late: int = 0) -> Diagnosis:
    """Diagnosis of a plant under two chirps up to 3.3 Hz, with a library of a few effects, torque some samples late."""
    time = np.arange(round(RATE * SECONDS)) / RATE
    commands = [size * np.sin(2 * np.pi * (0.1 + 0.08 * time) * time) for size in (2.8, 3.1)]
    experiments = [Experiment(RATE, SECONDS, seed=seed, torque_noise=0.03, counts=16384) for seed in (11, 12)]
    runs = simulate([(plant, experiment) for experiment in experiments], commands)
    torques = [np.append(np.zeros(late), run.torque[: len(run.torque) - late]) for run in runs]
    fitted, unseen = (
        Recording(run.time, run.position, own, name="chirp") for run, own in zip(runs, torques, strict=True)
    )
    return diagnose(fitted, unseen, only=only)


@pytest.mark.slow
def test_diagnosis_records_the_treatments_that_were_tried():
    found = diagnosed("bouncing")
    (tried,) = found.treatments
    assert tried.action == Action.IMPACTS_INCLUDED and tried.is_kept
    assert [gate.name for gate in tried.decision.gates] == ["gain", "p_value", "stops"] and tried.decision.passed
    assert Action.IMPACTS_INCLUDED in found.data.actions
    (row,) = found.json()["treatments"]
    assert row["action"] == "impacts_included" and row["kept"] and row["assumptions"] == {"with": 5, "without": 0}


def test_friction_that_fades_under_a_chirp_is_no_late_log():
    plant = Plant(effects={"friction_drift": {"drift_a": 0.6, "drift_T": 6.0, "drift_b": 0.0}})
    found = diagnosed_under_chirps(plant, "friction_drift", "stribeck", "viscous_asymmetry", "torque_offset")
    assert found.selected == ("friction_drift",) and not found.unexplained and not found.data.timing.has_moved
    for name, truth in (("inertia", plant.inertia), ("coulomb", plant.coulomb), ("friction_drift.warm_up", 6.0)):
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 3 * estimate.std and estimate.std < 0.05 * truth


def test_a_wave_of_the_angle_is_no_stop_that_yields():
    plant = Plant(effects={"cogging": {"cog_n": 3, "cog_s": 0.12, "cog_c": 0.0}})
    found = diagnosed_under_chirps(plant, "hard_stop", "torque_offset")
    assert not found.selected and found.tables == ("torque_by_angle",)


@pytest.mark.slow
def test_torque_is_either_timed_or_kept_as_logged():
    hidden = {"viscous_asymmetry": {"asym_v": 0.15}, "cogging": {"cog_n": 3, "cog_s": 0.3, "cog_c": 0.0}}
    found = diagnosed_under_chirps(Plant(effects=hidden), "viscous_asymmetry", late=1)
    actions = {*found.data.actions}
    assert found.selected == ("viscous_asymmetry",) and found.unexplained
    assert not actions >= {Action.TIMED_BY_MODEL, Action.TIMED_AS_LOGGED}
    tried = [treatment for treatment in found.treatments if treatment.treatment == Treatment(Action.TIMED_AS_LOGGED)]
    assert {gate.name for treatment in tried for gate in treatment.decision.gates} <= GATES


TRUE_SPRING = {"inertia": 0.05, "gravity": 1.2, "viscous": 0.06, "coulomb": 0.1, "spring.stiffness": 0.4}


def record_turns_against_a_spring(**friction_spot: float) -> list[Recording]:
    """Two recordings over several turns, in which the base model without the spring has a tenth of the inertia."""
    time = np.arange(round(RATE * SECONDS)) / RATE
    hidden = {"spring": {"spring_k": 0.4, "spring_q0": 0.3}, "friction_spot": friction_spot}
    plant, frequencies = Plant(0.05, 1.2, 0.06, 0.1, hidden), np.array([0.15, 0.31, 0.53, 0.87, 1.31, 2.1, 3.3])
    commands = []
    for seed in (9, 10):
        phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(frequencies))
        waves = np.sin(2 * np.pi * np.outer(time, frequencies) + phases) @ frequencies**-0.5
        commands.append(2.2 * waves / np.abs(waves).max())
    experiments = [Experiment(RATE, SECONDS, seed=seed, torque_noise=0.0, counts=16384) for seed in (1, 2)]
    runs = simulate([(plant, experiment) for experiment in experiments], commands)
    return [Recording(run.time, run.position, run.torque, name=f"turns {k}") for k, run in enumerate(runs, 1)]


def test_windows_follow_the_inertia_of_the_model_with_the_spring():
    fitted, unseen = record_turns_against_a_spring()
    found = diagnose(fitted, unseen, only=("spring", "torque_offset"))
    assert Action.WINDOWS_BY_INERTIA in found.data.actions
    assert found.steps[0].model.estimates["inertia"].value < 0.5 * TRUE_SPRING["inertia"]
    assert found.selected == ("spring",) and not found.unexplained
    model = Model.build((*BASE, Spring()), [*TRUE_SPRING.values(), -0.4 * 0.3])
    added = add(Model(), "spring", fitted, unseen)
    for estimates in (found.model.estimates, added.model.estimates):
        for name, truth in TRUE_SPRING.items():
            assert not estimates[name].is_biased
            assert abs(estimates[name].value - truth) < max(4 * estimates[name].std, 1e-4 * truth)
    compared = compare(model, unseen).joint
    assert compared.errors.torque_rms == pytest.approx(compared.noise_floor, rel=0.3)


def test_a_law_beside_the_spring_stays_unexplained():
    fitted, unseen = record_turns_against_a_spring(spot_f=0.1, spot_q=0.5, spot_w=0.3)
    found = diagnose(fitted, unseen, only=("spring", "torque_offset"))
    assert found.selected == ("spring",) and found.unexplained
    added = add(Model(), "spring", fitted, unseen)
    assert all(estimate.is_biased for estimate in added.model.estimates.values())


def test_a_controller_that_runs_ten_times_faster_than_the_log_is_timed_beside_the_friction_of_its_gear():
    plant = Plant(
        0.0125, gravity=0.92, viscous=0.16, coulomb=0.1, effects={"load_dependent_friction": {"load_mu": 0.16}}
    )
    loop = {"excitation": "pd_loop", "gains": (6.0, 0.12), "scale": 0.8}
    experiment = Experiment(1000.0, 40.0, seed=3, counts=4096, torque_noise=2e-3, **loop)
    (run,) = simulate([(plant, experiment)])
    rows = slice(None, None, 10)
    found = diagnose(
        [Recording(run.time[rows], run.position[rows], run.torque[rows])], only=["load_dependent_friction"]
    )
    assert found.selected == ("load_dependent_friction",) and not found.unexplained
    for name, truth in {"inertia": 0.0125, "viscous": 0.16, "coulomb": 0.1, "load_dependent_friction": 0.16}.items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 5 * estimate.std, name
