"""What counts as noise."""

import pytest

from estimators.selection.criterion import Criterion
from estimators.weak_form.dataset import Structure


@pytest.mark.parametrize(
    ("left", "noise"),
    [
        (Structure(0.0, 0.0, 2.0), True),  # white, of a size that the sensors may have
        (Structure(0.0, -9.0, 3.0), False),  # white, and far too much
        (Structure(0.6, 4.0, 1.0), True),  # shared perhaps
        (Structure(0.6, 6.0, 1.0), False),  # shared surely
        (Structure(0.4, 60.0, 1.0), True),  # surely, and too little to matter
        (Structure(0.4, 60.0, 3.0), False),
    ],
)
def test_noise_is_white_or_too_little_to_matter_and_never_far_above_the_floor(left, noise):
    assert Criterion().is_noise(left, 1.0) is noise
    assert Criterion().is_noise(Structure(1e-3 * left.shared, left.sure, 1e-3 * left.all), 1e-3) is noise


def test_from_white_noise_nothing_can_be_learnt():
    assert not Criterion().shows(Structure(0.4, 4.9, 2.0), 1.0)
    assert Criterion().shows(Structure(0.4, 5.1, 2.0), 1.0)
    assert Criterion().shows(Structure(0.0, 0.0, 2.6), 1.0)
