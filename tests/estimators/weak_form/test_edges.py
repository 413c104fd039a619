"""Parameters without slopes: where a law jumps, they are scanned, and their errors are intervals of the likelihood."""

from dataclasses import dataclass
from math import sin

import numpy as np
import pytest

from estimators import diagnose
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.search_hints import make_grid
from estimators.weak_form.nonlinear import find_edges
from pendulum_env.physics import BASE, Column, NonlinearParameter, Term, effects
from pendulum_env.physics.limits import limit_kind
from pendulum_env.recording import Recording
from tests import slow

TRUTH = {"inertia": 0.085, "gravity": 2.0, "viscous": 0.36, "coulomb": 0.6, "ending": 0.25, "ending.end": 0.5}


@dataclass(frozen=True)
class Ending(Term):
    """Dry friction that ends at a speed."""

    end: float = 1.0

    id, law, kind = "ending", "f sgn q' for |q'| < v", "dissipative"
    nonlinear_parameters = (NonlinearParameter("end", "rad/s", 0.01, 100.0),)

    @property
    def columns(self):
        return (Column("ending", "N m", dry=lambda x: np.where(np.abs(x.velocity) < self.end, 1.0, 0.0)),)


@dataclass(frozen=True)
class Fading(Ending):
    """The same with a smooth end."""

    id = "fading"

    @property
    def columns(self):
        return (Column("fading", "N m", dry=lambda x: 1.0 / (1.0 + (x.velocity / self.end) ** 8)),)


def run(seed: int, rate: float = 500.0, seconds: float = 10.0) -> Recording:
    """A pendulum with such friction, in steps of 0.1 ms; it rests where dry friction holds it."""
    inertia, gravity, viscous, coulomb, more, end = TRUTH.values()
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1 / rate)
    harmonics, phases = 2 * np.pi * np.array([0.31, 0.73, 1.37, 2.11]), rng.uniform(0, 2 * np.pi, 4)
    torque = np.array([1.2, 1.2, 1.0, 0.8]) @ np.sin(harmonics[:, None] * time + phases[:, None])
    step, q, v, path = 1e-4, 0.0, 0.0, []
    for command in torque.tolist():
        path.append(q)
        for _ in range(round(1 / rate / step)):
            free = v + step * (command - gravity * sin(q) - viscous * v) / inertia
            held = step * (coulomb + (more if abs(v) < end else 0.0)) / inertia
            v = 0.0 if abs(free) <= held else free - (held if free > 0 else -held)
            q += step * v
    count = 2 * np.pi / 2**16
    return Recording(time, np.round(np.array(path) / count) * count, torque + 0.03 * rng.standard_normal(len(time)))


@pytest.mark.parametrize("seed", slow.but_first([1, 2, 3]))
def test_friction_that_ends_at_a_speed_is_found_with_its_edge(seed):
    found = diagnose(run(seed), run(seed + 100), library=effects() | {"ending": Ending})
    assert found.selected == ("ending",)
    for name, value in TRUTH.items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - value) < 3 * estimate.std < 0.3 * value, name


@pytest.mark.slow
def test_the_error_of_an_edge_covers_its_scatter():
    library = effects() | {"ending": Ending}
    found = [
        diagnose(run(seed), run(seed + 100), library=library).model.estimates["ending.end"] for seed in range(1, 7)
    ]
    squares = [((edge.value - TRUTH["ending.end"]) / edge.std) ** 2 for edge in found]
    assert np.mean(squares) < 2.1  # 95 % of chi squared with 6 degrees of freedom


def test_only_parameters_at_which_a_law_jumps_are_edges():
    data = RegressionData.from_recordings([run(1)])
    x, residual = data.samples, data.residual(BASE)
    assert [own.name for end in (0.2, 0.5, 2.0) for own in find_edges(Ending(end), x)] == ["end"] * 3
    assert find_edges(limit_kind(Ending, {"ending.end": (0.1, 1.0)})(0.5), x)
    assert not find_edges(Fading(0.5), x)
    for kind in effects().values():
        for variant in make_grid(kind, x, residual):
            assert all(own.instant for own in find_edges(variant, x)), kind


def test_an_edge_beyond_the_motion_is_none():
    x = RegressionData.from_recordings([run(1)]).samples
    assert not find_edges(Ending(4 * float(np.max(np.abs(x.velocity)))), x)


def test_an_edge_counts_as_given_in_the_covariance_of_the_others():
    data = RegressionData.from_recordings([run(1)])
    terms = (*BASE, effects()["payload_change"](5.0), effects()["stribeck"](0.3))
    model, fit = fit_terms(data, terms)
    names = [*model.estimates]
    assert len(fit.covariance) == len(names) and fit.covariance[names.index("payload_change.moment")].max() == 0.0
    assert model.estimates["payload_change.moment"].std > 0.0 < model.estimates["stribeck.stribeck_velocity"].std
