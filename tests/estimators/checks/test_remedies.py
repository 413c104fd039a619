"""What a fit says of columns that were read wrongly."""

import re
from dataclasses import replace

import numpy as np
import pytest

from estimators import identify
from estimators.checks.remedies import wrong_columns
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.origin import Origin

TERMS = ("inertia", "gravity", "viscous", "coulomb", "gravity_tilt")


@pytest.fixture(scope="module")
def run() -> Recording:
    """A run of the paper's pendulum, as read from degrees."""
    origin = Origin(find_columns(["t", "ang_deg", "tau"]))
    return replace(record(None, excitation("multisine", 1), 10, rng=1), origin=origin)


@pytest.mark.parametrize("off", [20.0, -3.0, 170.0])
def test_a_wrong_zero_is_told_in_degrees_with_what_mends_it(run, off):
    moved = replace(run, position=run.position + np.radians(off))
    (told,) = (doubt.text for doubt in identify([moved], TERMS, "energy").doubts if "zero" in doubt.text)
    size, error = map(float, re.match(r"your zero is ([\d.]+) ± ([\d.]+) degrees off", told).groups())
    assert size == pytest.approx(abs(off), abs=5 * error + 0.01) and 0 < error < 0.5
    mended = float(re.search(r"read it with --columns position=ang_deg:deg([+-][\d.]+) instead$", told)[1])
    assert mended == pytest.approx(-off, abs=5 * error + 0.01)


def test_an_upright_zero_and_a_turned_sign_are_told_with_what_mends_them(run):
    upright = replace(run, position=run.position + np.pi)
    turned = replace(run, torque=-run.torque)
    for wrong, remedy in ((upright, "position=ang_deg:deg+180"), (turned, "torque=-tau")):
        (told,) = (doubt.text for doubt in identify([wrong], schemes="energy").doubts if "negative" in doubt.text)
        assert told.endswith(f": read it with --columns {remedy} instead")
        (plain,) = (
            doubt.text
            for doubt in identify([replace(wrong, origin=None)], schemes="energy").doubts
            if "negative" in doubt.text
        )
        assert told.startswith(plain) and "--columns" not in plain  # nobody knows its columns


def test_files_with_other_columns_are_told_apart(run):
    other = replace(run, name="other", origin=Origin(find_columns(["t", "q", "u"])))
    found = identify([run], schemes="energy")["energy"].model
    (told,) = wrong_columns(negative(found), [run, other])
    assert told.endswith("with --columns torque=-tau instead; read other with --columns torque=-u instead")


def negative(model: Model) -> Model:
    estimates = {name: replace(own, value=-own.value) for name, own in model.estimates.items()}
    return replace(model, estimates=estimates)


def test_under_different_known_loads_no_zero_is_told(run):
    """Their weight was taken off at the wrong angle, each another."""
    found = identify([run], TERMS, "energy")["energy"].model
    tilted = replace(found, estimates={**found.estimates, "gravity_tilt": replace(found.estimates["gravity"])})
    loaded = [replace(run, load=Load(0.0, weight)) for weight in (0.0, 1.0)]
    assert wrong_columns(tilted, loaded[:1]) and not wrong_columns(tilted, loaded)
