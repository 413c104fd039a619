"""What a fit says of columns that were read wrongly."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate

from estimators import diagnose, identify
from estimators.checks.remedies import Remedy, UnevenClock, WrongColumn, find_remedies, find_wrong_columns
from estimators.diagnosis.completeness import Incomplete
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model
from pendulum_env.recording import Load, Recording, read_recording
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.origin import Origin

TERMS = ("inertia", "gravity", "viscous", "coulomb", "gravity_tilt")


@pytest.fixture(scope="module")
def run() -> Recording:
    """A run of the paper's pendulum, as read from degrees."""
    origin = Origin(find_columns(["t", "ang_deg", "tau"]))
    return replace(record(None, excitation("multisine", 1), 10, rng=1), origin=origin)


def free_swing(off: float) -> Recording:
    """A swing let go at 70 degrees, of g/I = 30 1/s^2, by SciPy, with the zero off by an angle [deg]."""

    def slope(_: float, state: np.ndarray) -> list[float]:
        q, v = state
        return [v, -30.0 * np.sin(q) - 0.08 * v - 0.1 * np.tanh(v / 1e-2)]

    time = np.arange(1500) / 120.0
    q = scipy.integrate.solve_ivp(slope, (0, 13), [1.22, 0.0], t_eval=time, rtol=1e-8, atol=1e-8).y[0]
    q = q + np.radians(off + np.random.default_rng(1).normal(0.0, 0.02, len(q)))
    return Recording(time, q, origin=Origin(find_columns(["t", "ang_deg"])))


@pytest.mark.parametrize(("free", "off"), [(False, 20.0), (False, 50.0), (True, -89.0), (True, 1.0)])
def test_a_wrong_zero_is_told_with_what_mends_it(run, free, off):
    moved = free_swing(off) if free else replace(run, position=run.position + np.radians(off))
    (shifted,) = (own for own in identify([moved], TERMS, "energy").findings if isinstance(own, WrongColumn))
    assert np.degrees(abs(shifted.angle.value)) == pytest.approx(abs(off), abs=0.5)
    (remedy,) = shifted.remedies
    mended = float(re.fullmatch(r"ang_deg:deg([+-][\d.]+)", remedy.columns["position"])[1])
    assert mended == pytest.approx(-off, abs=0.5)
    right = free_swing(0.0) if free else run
    assert not any(isinstance(own, WrongColumn) for own in identify([right], TERMS, "energy").findings)


@pytest.mark.parametrize("off", [172.0, -170.0])
def test_a_zero_is_found_from_a_model_without_a_tilt(run, off):
    moved = replace(run, position=run.position + np.radians(off))
    (shifted,) = (own for own in identify([moved], schemes="energy").findings if isinstance(own, WrongColumn))
    (remedy,) = shifted.remedies
    mended = float(re.fullmatch(r"ang_deg:deg([+-][\d.]+)", remedy.columns["position"])[1])
    assert mended == pytest.approx(-off, abs=0.5)


def test_a_zero_at_the_horizontal_is_found_by_a_diagnosis():
    """A heavy link that swings by 80 degrees about hanging down, whose log has its zero at the horizontal.

    The equation of motion gives the torque of a chosen motion; fitted without a tilt, the inertia is ten times too
    large.
    """
    rng, time = np.random.default_rng(5), np.arange(3000) / 100
    parts = [(0.8, 2.1, 0.3), (0.5, 3.7, 1.1), (0.1, 6.1, 2.0)]  # amplitude, frequency, phase
    q = sum(a * np.sin(w * time + p) for a, w, p in parts)
    fine = np.arange(3000 * 20) / 2000
    x, v, a = (sum(A * w**n * np.sin(w * fine + p + n * np.pi / 2) for A, w, p in parts) for n in range(3))
    torque = (20.0 * a + 130.0 * np.sin(x) + 22.0 * v + 17.0 * np.sign(v)).reshape(3000, 20).mean(axis=1)
    noisy = torque + 0.7 * rng.standard_normal(3000), q - np.pi / 2 + 1e-4 * rng.standard_normal(3000)
    found = diagnose(Recording(time, noisy[1], noisy[0], name="horizontal"))
    assert found.selected == ("gravity_tilt",)
    (shifted,) = (own for own in found.findings if isinstance(own, WrongColumn))
    assert shifted.column == "position" and abs(shifted.angle.value) == pytest.approx(np.pi / 2, abs=0.01)
    assert abs(found.model["inertia"].value - 20.0) < 4 * found.model["inertia"].std


def test_an_upright_zero_and_a_turned_sign_are_told_with_what_mends_them(run):
    upright = replace(run, position=run.position + np.pi)
    turned = replace(run, torque=-run.torque)
    for wrong, column, columns in (
        (upright, "position", {"position": "ang_deg:deg+180"}),
        (turned, "torque", {"torque": "-tau"}),
    ):
        for recording, mended in ((wrong, [columns]), (replace(wrong, origin=None), [])):
            (found,) = (own for own in identify([recording], schemes="energy").findings if isinstance(own, WrongColumn))
            assert found.column == column and [own.columns for own in found.remedies] == mended


def test_files_with_other_columns_are_told_apart(run):
    other = replace(run, name="other", origin=Origin(find_columns(["t", "q", "u"])))
    found = identify([run], schemes="energy")["energy"].model
    (turned,) = find_wrong_columns(negative(found), [run, other])
    assert turned.remedies == (Remedy({"torque": "-tau"}, (run.name,)), Remedy({"torque": "-u"}, ("other",)))


def negative(model: Model) -> Model:
    estimates = {name: replace(own, value=-own.value) for name, own in model.estimates.items()}
    return replace(model, estimates=estimates)


def test_under_different_known_loads_no_zero_is_told(run):
    """Their weight was taken off at the wrong angle, each another."""
    found = identify([run], TERMS, "energy")["energy"].model
    tilted = replace(found, estimates={**found.estimates, "gravity_tilt": replace(found.estimates["gravity"])})
    loaded = [replace(run, load=Load(0.0, weight)) for weight in (0.0, 1.0)]
    assert find_wrong_columns(tilted, loaded[:1]) and not find_wrong_columns(tilted, loaded)


def test_an_incomplete_model_suggests_no_other_zero(run):
    moved = replace(run, position=run.position + np.radians(20.0))
    model = identify([moved], TERMS, "energy")["energy"].model
    assert [own.column for own in find_remedies(model, [moved])] == ["position"]
    assert find_remedies(model, [moved], is_complete=False) == []


@pytest.mark.parametrize("accumulates", [True, False])
def test_a_clock_that_cannot_be_recovered_may_cause_the_residual(accumulates: bool) -> None:
    rows, rng = record(None, excitation("paper", 0, 20.0), 20.0, rate=200.0, rng=0), np.random.default_rng(1)
    errors = rng.normal(0.0, 0.002 if accumulates else 0.0008, len(rows))
    time = np.sort(rows.time + (np.cumsum(errors) if accumulates else errors))
    found = identify(read_recording({"time": time, "position": rows.position, "torque": rows.torque})).findings
    assert any(isinstance(finding, UnevenClock) for finding in found) == accumulates
    assert any(isinstance(finding, Incomplete) for finding in found) == accumulates
