"""The paper's experiment: its Table 2 recovered, its equalities kept, its faults shown."""

import dataclasses

import numpy as np
import pytest

from estimators.paper import PARAMETERS, PRINTED, TABLE_2, Experiment, as_logged
from estimators.paper.experiment import simulated
from pendulum_env.plant import paper_plant
from pendulum_env.recording import Recording
from tests.cases import of_the_paper

DYNAMIC_PAIRS = [("hamiltonian", "dynamic"), ("filtered_hamiltonian", "filtered_dynamic")]
FOUR, SIX = [id for pair in DYNAMIC_PAIRS for id in pair], list(TABLE_2)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return of_the_paper()


def test_every_scheme_recovers_table_2(experiment):
    """Median below 1 % is the aim; in 6 s each run stays well below it. Theta(0) = 0 and P(0) = 1e7 leave no trace."""
    assert tuple(experiment.truth) == TABLE_2["dynamic"]
    assert PARAMETERS == ("inertia", "gravity", "viscous", "coulomb")
    for scheme in TABLE_2:
        assert experiment.score("ours", scheme).worst.max() < 0.005
        for way in ("ours", "printed"):
            found = experiment.found[0][way][scheme]
            np.testing.assert_allclose(found.convergence.theta[-1], found.model.theta, rtol=1e-6)


@pytest.mark.parametrize(("hamiltonian", "dynamic"), DYNAMIC_PAIRS)
def test_hamiltonian_equals_dynamic_given_the_same_inertia(hamiltonian, dynamic, experiment):
    """To four digits, in our way and as printed, as the paper's Table 2 has it."""
    assert experiment.disagreement(hamiltonian) < 1e-4
    assert TABLE_2[hamiltonian][1:] == TABLE_2[dynamic][1:]
    for way in ("paper", "printed"):
        np.testing.assert_allclose(experiment.theta(way, hamiltonian), experiment.theta(way, dynamic), rtol=1e-4)


def test_the_printed_equations_are_biased(experiment):
    """By encoder noise in the acceleration, and by torque and velocity that are not of the same instant."""
    dynamic, filtered = (
        experiment.theta("printed", id) / experiment.truth - 1 for id in ("dynamic", "filtered_dynamic")
    )
    assert (dynamic[:, 0] < -0.02).all()  # noise in a regressor
    assert (filtered[:, 2] < -0.01).all()  # a delay
    assert experiment.worst_median("printed") > 10 * experiment.worst_median("ours")


@pytest.mark.parametrize("scheme", PRINTED, ids=lambda scheme: scheme.id)
def test_the_printed_equations_hold_on_exact_motion(scheme):
    """Their mathematics is right: sampled fast, from rest, without encoder, hold or reversal, nothing is left."""
    time = np.arange(20_000) / 10_000
    q, v, a = time**2, 2 * time, np.full_like(time, 2.0)
    torque = np.column_stack([a, np.sin(q), v, np.sign(v)]) @ paper_plant().theta
    m = as_logged(Recording("made", time, q, torque))
    exact = dataclasses.replace(m, velocity=v, acceleration=a)
    equations, usable = scheme.regression(exact, paper_plant().terms)
    assert usable.all()
    left = equations.y - equations.phi @ paper_plant().theta
    np.testing.assert_allclose(left, 0, atol=1e-3 * np.abs(equations.y).max())


@pytest.mark.parametrize(
    ("way", "schemes", "times"),
    [
        ("stick_kept", FOUR, 3),
        ("stick_as_zero", FOUR, 3),
        ("command_as_logged", SIX, 2),
        ("differentiated_backwards", SIX, 2),
    ],
)
def test_each_care_pays(way, schemes, times, experiment):
    for scheme in schemes:
        assert experiment.score(way, scheme).median.max() > times * experiment.score("ours", scheme).median.max()


def test_stick_is_where_torque_tells_nothing(experiment):
    anatomy = experiment.anatomy
    assert 0 < anatomy.at_rest < 0.2
    assert anatomy.torque_at_rest > 10 * anatomy.torque_clear
    assert anatomy.memory_from_start > 0.5 > abs(anatomy.memory_in_windows)


def test_the_norm_of_backward_differences_prefers_a_wrong_model(experiment):
    """Fig. 9 of the paper: the dynamic model and its twin come out best; better than the truth itself."""
    assert max(experiment.following.values()) < 0.01  # in open loop, all do as well
    printed, ours = experiment.norms("printed"), experiment.norms("ours")
    assert min(printed.models, key=printed.models.get) in ("dynamic", "hamiltonian")
    assert printed.models["dynamic"] < printed.truth
    for norm in ours.models.values():
        assert norm == pytest.approx(ours.truth, rel=0.01)
    assert ours.truth < 0.1 * printed.truth


def test_intervals_hold_the_truth(experiment):
    assert np.mean([experiment.coverage(scheme) for scheme in TABLE_2]) > 0.75


def test_the_same_seed_repeats_itself_and_another_does_not():
    first, second, other = (simulated(np.random.default_rng(seed), 1.0, "run") for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.torque, second.torque)
    np.testing.assert_array_equal(first.position, second.position)
    assert np.abs(first.torque - other.torque).max() > 0.1
