"""The paper's experiment: its Table 2 recovered, its equalities kept, its faults shown."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import SCHEMES, Identification, identify, scheme
from estimators.regression.least_squares import least_squares
from estimators.schemes import PAPER, Integral, Scheme
from estimators.signals.measurements import Measurements, measure
from pendulum_env.physics import BASE, simulate
from pendulum_env.plant import paper_plant
from pendulum_env.recording import Recording
from tests.cases import recorded

TABLE_2 = {  # [I, mgl, b, fc]; the Hamiltonian pair is given its inertia
    "dynamic": (0.0895, 2.0100, 0.3638, 0.9163),
    "filtered_dynamic": (0.0903, 2.0171, 0.3874, 0.9229),
    "energy": (0.0937, 1.9496, 0.3291, 1.1109),
    "filtered_power": (0.0911, 1.9335, 0.3299, 1.1201),
    "hamiltonian": (None, 2.0100, 0.3638, 0.9163),
    "filtered_hamiltonian": (None, 2.0171, 0.3874, 0.9229),
}
TRUTH = np.array(TABLE_2["dynamic"])
PAIRS = [("hamiltonian", "dynamic"), ("filtered_hamiltonian", "filtered_dynamic")]
OF_TORQUE = [id for pair in PAIRS for id in pair]  # at an instant or over a sample, not energy
WITH_STICK = [dataclasses.replace(one, guard=None) for one in SCHEMES]


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    """Three runs of the paper's pendulum, of 6 s each, from a simulator that shares no code with the packages."""
    return recorded(Plant(*TRUTH), *(Experiment(seconds=6.0, seed=seed) for seed in (5, 6, 7)))


@pytest.fixture(scope="module")
def identified(recordings) -> list[Identification]:
    return [identify(recording) for recording in recordings[:2]]


def estimates(schemes: Sequence[Scheme], measured: Sequence[Measurements]) -> dict[str, np.ndarray]:
    """Least-squares estimates (R, 4) of R runs, by scheme."""
    found = {}
    for one in schemes:
        regressions = [one.regression(m, BASE) for m in measured]
        found[one.id] = np.array([least_squares(eq.phi[usable], eq.y[usable]) for eq, usable in regressions])
    return found


def error(theta: np.ndarray) -> float:
    """Largest median error of a parameter, as a share."""
    return float(np.median(np.abs(theta / TRUTH - 1), axis=0).max())


def rms(values: np.ndarray) -> float:
    """The paper's norm (10)."""
    return float(np.sqrt(np.mean(values**2)))


def at_rest_in_stick(recording: Recording) -> Measurements:
    m = measure(recording)
    return dataclasses.replace(m, velocity=np.where(m.moving, m.velocity, 0.0))


def command_as_logged(recording: Recording) -> Measurements:
    """Torque is the command of the same row: half a sample early."""
    m = measure(recording)
    return dataclasses.replace(m, torque=np.append(m.held[1:], m.held[-1]), held=m.torque)


def differentiated_backwards(recording: Recording) -> Measurements:
    """Velocity is the backward difference of the encoder, acceleration that of the velocity, as in the paper."""
    m = measure(recording)
    velocity = np.diff(recording.position, prepend=recording.position[0]) * recording.rate
    acceleration = np.diff(velocity, prepend=0.0) * recording.rate
    margin = (len(recording) - len(m)) // 2
    motion = {"position": recording.position, "velocity": velocity, "acceleration": acceleration}
    return dataclasses.replace(m, **{name: own[margin : margin + len(m)] for name, own in motion.items()})


def as_in_the_paper(recording: Recording) -> Measurements:
    """Backward differences, and the command of the same row."""
    logged = command_as_logged(recording)
    return dataclasses.replace(differentiated_backwards(recording), torque=logged.torque, held=logged.held)


def test_every_scheme_recovers_table_2(identified):
    """Median below 1 % is the aim; in 6 s each run stays well below it. Theta(0) = 0 and P(0) = 1e7 leave no trace."""
    assert tuple(paper_plant().theta) == TABLE_2["dynamic"]
    assert tuple(paper_plant().estimates) == ("inertia", "gravity", "viscous", "coulomb")
    for found in identified:
        for id in TABLE_2:
            assert np.abs(found[id].model.theta / TRUTH - 1).max() < 0.005
            np.testing.assert_allclose(found[id].convergence.theta[-1], found[id].model.theta, rtol=1e-6)


@pytest.mark.parametrize(("hamiltonian", "dynamic"), PAIRS)
def test_hamiltonian_equals_dynamic_given_the_same_inertia(hamiltonian, dynamic, recordings):
    """To four digits, as the paper's Table 2 has it."""
    assert TABLE_2[hamiltonian][1:] == TABLE_2[dynamic][1:]
    for recording in recordings[:2]:
        found = identify(recording, schemes=PAPER)
        np.testing.assert_allclose(found[hamiltonian].model.theta, found[dynamic].model.theta, rtol=1e-4)


def test_the_papers_measurements_bias_the_estimates(recordings):
    """By encoder noise in the acceleration, and by torque and velocity that are not of the same instant."""
    ours = estimates(SCHEMES, [measure(recording) for recording in recordings])
    paper = estimates(WITH_STICK, [as_in_the_paper(recording) for recording in recordings])
    assert (paper["dynamic"][:, 0] < 0.98 * TRUTH[0]).all()  # noise in a regressor
    assert (paper["filtered_dynamic"][:, 2] < 0.99 * TRUTH[2]).all()  # a delay
    assert max(map(error, paper.values())) > 10 * max(map(error, ours.values()))


@pytest.mark.parametrize(
    ("chosen", "measured", "ids", "times"),
    [
        (WITH_STICK, measure, OF_TORQUE, 3),
        (WITH_STICK, at_rest_in_stick, OF_TORQUE, 3),
        (SCHEMES, command_as_logged, list(TABLE_2), 2),
        (SCHEMES, differentiated_backwards, list(TABLE_2), 2),
    ],
    ids=["stick kept", "stick kept at velocity 0", "command as logged", "backward differences"],
)
def test_each_precaution_pays(chosen, measured, ids, times, recordings):
    ours = estimates(SCHEMES, [measure(recording) for recording in recordings])
    without = estimates(chosen, [measured(recording) for recording in recordings])
    for id in ids:
        assert error(without[id]) > times * error(ours[id])


def test_stick_is_where_torque_tells_nothing(recordings):
    m = measure(recordings[0])
    equations, clear = scheme("dynamic").regression(m, BASE)
    left = equations.y - equations.phi @ TRUTH
    assert 0 < np.mean(~m.moving) < 0.2
    assert rms(left[~m.moving]) > 10 * rms(left[clear])


def test_energy_from_the_start_remembers_its_errors(recordings):
    """After 0.2 s, the error still correlates with itself; that of windows of 50 ms does not."""
    m, memory = measure(recordings[0]), []
    for operator in (Integral(window=None), Integral()):
        equations, usable = scheme("energy", operator=operator).regression(m, BASE)
        left, lag = (equations.y - equations.phi @ TRUTH)[usable], round(0.2 * m.rate)
        memory.append(np.corrcoef(left[:-lag], left[lag:])[0, 1])
    assert memory[0] > 0.5 > abs(memory[1])


def test_the_norm_of_backward_differences_prefers_a_wrong_model(recordings, identified):
    """Fig. 9 of the paper: the dynamic model comes out best; better than the truth itself."""
    *_, fresh = recordings
    ours = {id: found.model.theta for id, found in identified[0].schemes.items()}
    motion = simulate(BASE, np.column_stack([*ours.values()]), 1 / fresh.rate, fresh.torque, 0.0, 0.0).position[:-1]
    assert max(map(rms, (motion - fresh.position[:, None]).T)) < 0.01  # in open loop, all do as well

    def norms(theta: dict[str, np.ndarray], one: Scheme, m: Measurements) -> dict[str, float]:
        equations, usable = one.regression(m, BASE)
        return {id: rms((equations.y - equations.phi @ own)[usable]) for id, own in theta.items()}

    paper = {id: own[0] for id, own in estimates(WITH_STICK, [as_in_the_paper(recordings[0])]).items()}
    printed = norms({**paper, "truth": TRUTH}, WITH_STICK[0], as_in_the_paper(fresh))
    clear = norms({**ours, "truth": TRUTH}, SCHEMES[0], measure(fresh))
    assert min(printed, key=printed.get) in ("dynamic", "hamiltonian")
    for norm in clear.values():
        assert norm == pytest.approx(clear["truth"], rel=0.01)
    assert clear["truth"] < 0.1 * printed["truth"]


def test_intervals_hold_the_truth(identified):
    held = [
        np.abs(found[id].model.theta - TRUTH) <= 1.96 * found[id].convergence.std[-1]
        for found in identified
        for id in TABLE_2
    ]
    assert np.mean(held) > 0.75
