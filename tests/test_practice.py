"""Recordings of a foreign simulator whose hidden effects are known, where they are at hand."""

import json
from pathlib import Path

import pytest

from pendulum_env.recording import read_recording
from tests.cases import diagnosed

PRACTICE = Path(__file__).parents[2] / "shared" / "practice"

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not PRACTICE.is_dir(), reason="these recordings are not here")]


@pytest.mark.parametrize(
    "name", ["null_a", "null_b", "null_c", "null_d", "stribeck", "cogging", "encoder_eccentricity"]
)
def test_what_is_hidden_is_found_and_nothing_else(name):
    hidden = json.loads((PRACTICE / "truth.json").read_text())[name]["hidden"]
    train, holdout = (read_recording(PRACTICE / f"{name}.{part}.csv.gz") for part in ("train", "holdout"))
    found = diagnosed([train], [holdout])
    assert list(found.selected) == hidden
    assert found.ambiguous == ()
    assert found.unexplained == ()
