"""Units of quantities where another channel stands for the torque, and at a joint that slides."""

import pytest

from pendulum_env.physics import effects
from pendulum_env.units import JointUnits, is_of_torque


@pytest.mark.parametrize(
    ("si", "current", "relative", "sliding"),
    [
        ("N m", "A", "rad/s^2", "N"),
        ("kg m^2", "A s^2", "1", "kg"),
        ("N m s/rad", "A s/rad", "1/s", "N s/m"),
        ("N m s/rad/K", "A s/rad/K", "1/s/K", "N s/m/K"),
        ("N m/rad", "A/rad", "1/s^2", "N/m"),
        ("N m s^2/rad^2", "A s^2/rad^2", "1/rad", "N s^2/m^2"),
        ("J", "A rad", "rad^2/s^2", "J"),
        ("W", "A rad/s", "rad^2/s^3", "W"),
        ("rad/s", "rad/s", "rad/s", "m/s"),
        ("1", "1", "1", "1"),
    ],
)
def test_units_by_channel(si, current, relative, sliding):
    every = (JointUnits(), JointUnits("A"), JointUnits("rad/s^2"), JointUnits(is_prismatic=True))
    assert [units.unit(si) for units in every] == [si, current, relative, sliding]
    assert JointUnits("A").unit(current) == current
    at_slide = JointUnits("A", is_prismatic=True).unit(si)
    assert at_slide == ("A s^2/m" if si == "kg m^2" else current.replace("rad", "m"))
    assert is_of_torque(si) == (si != current)


@pytest.mark.parametrize("kind", effects().values())
def test_no_parameter_of_an_effect_keeps_its_torque(kind):
    for channel, gone in (
        (JointUnits("A"), ("N m", "kg")),
        (JointUnits("rad/s^2"), ("N m", "kg")),
        (JointUnits(is_prismatic=True), ("N m", "rad")),
    ):
        given = [channel.unit(column.unit) for column in kind().columns]
        given += [own.get_unit(channel) for own in kind.nonlinear_parameters if not own.is_frequency]
        assert not [unit for unit in given if any(own in unit for own in gone)]
