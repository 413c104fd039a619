"""What counts as noise."""

import pytest

from estimators.decisions.criterion import Criterion, ResidualStructure, has_structure, is_noise


@pytest.mark.parametrize(
    ("residual", "noise"),
    [
        (ResidualStructure(0.0, 0.0, 2.0), True),  # white, of a size that the sensors may have
        (ResidualStructure(0.0, -9.0, 3.0), False),  # white, and far too much
        (ResidualStructure(0.6, 4.0, 1.0), True),  # shared perhaps
        (ResidualStructure(0.6, 6.0, 1.0), False),  # shared surely
        (ResidualStructure(0.4, 60.0, 1.0), True),  # surely, and too little to matter
        (ResidualStructure(0.4, 60.0, 3.0), False),
    ],
)
def test_noise_is_white_or_too_little_to_matter_and_never_far_above_the_floor(residual, noise):
    scaled = ResidualStructure(1e-3 * residual.correlated_rms, residual.z_score, 1e-3 * residual.rms)
    assert is_noise(residual, 1.0, Criterion()) is is_noise(scaled, 1e-3, Criterion()) is noise


def test_from_white_noise_nothing_can_be_learnt():
    assert not has_structure(ResidualStructure(0.4, 4.9, 2.0), 1.0, Criterion())
    assert has_structure(ResidualStructure(0.4, 5.1, 2.0), 1.0, Criterion())
    assert has_structure(ResidualStructure(0.0, 0.0, 2.6), 1.0, Criterion())
