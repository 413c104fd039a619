import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from robots.arms.body import read_body

ARM = TwoLink()


def written(tmp_path, text, name="arm.urdf"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


@pytest.fixture
def body(tmp_path):
    return read_body(written(tmp_path, ARM.urdf()))


@pytest.fixture
def motion():
    return np.random.default_rng(0).uniform(-3, 3, (3, 200, 2))


def test_torque_and_mass_matrix_are_those_of_the_textbook(body, motion):
    q, v, a = motion
    told = [ARM.mass_matrix(x) @ z + ARM.bias(x, y) for x, y, z in zip(q, v, a, strict=True)]
    assert np.abs(body.torque(q, v, a) @ body.values - told).max() < 1e-9
    matrices = [ARM.mass_matrix(x) for x in q]
    assert np.abs(body.mass_matrix(q, body.values) - matrices).max() < 1e-9


def test_base_parameters_of_two_links_are_six_said_in_words_and_with_rotors_seven(tmp_path, body):
    first = ["mx@shoulder", "mz@shoulder - 0.45 m@elbow", "Iyy@shoulder + 0.2025 m@elbow"]
    assert [parameter.text for parameter in body.base] == [*first, "mx@elbow", "mz@elbow", "Iyy@elbow"]
    m1, m2 = ARM.mass
    assert body.values[1] == pytest.approx(-m1 * ARM.center[0] - m2 * ARM.length)
    turned = read_body(written(tmp_path, ARM.urdf()), rotors=True)
    assert turned.names[-1] == "rotor@elbow"  # shows beside its link where another link moves it
    assert turned.base[2].text == "Iyy@shoulder + 0.2025 m@elbow + rotor@shoulder"


def test_mjcf_gives_the_same_body(tmp_path, body, motion):
    (m1, m2), (c1, c2), (i1, i2) = ARM.mass, ARM.center, ARM.inertia
    text = f"""<mujoco model="two"><worldbody><body name="upper"><joint name="shoulder" axis="0 -1 0"/>
      <inertial pos="0 0 {-c1}" mass="{m1}" diaginertia="{i1} {i1} {i1 / 10}"/>
      <body name="fore" pos="0 0 {-ARM.length}"><joint name="elbow" axis="0 -1 0" armature="0.01"/>
      <inertial pos="0 0 {-c2}" mass="{m2}" diaginertia="{i2} {i2} {i2 / 10}"/></body></body></worldbody></mujoco>"""
    other = read_body(written(tmp_path, text, "arm.xml"))
    q, v, a = motion
    rotor = np.array([0.0, 0.01])
    told = body.torque(q, v, a) @ body.values + rotor * a
    assert other.joints == body.joints and other.rotors
    assert np.abs(other.torque(q, v, a) @ other.values - told).max() < 1e-9


def chain(count, place="0 0 -0.1"):
    """URDF of links in a row, each turning about its own axis."""
    text = '<robot name="chain"><link name="base"/>'
    for k in range(count):
        text += (
            f'<link name="link{k}"><inertial><origin xyz="{place}"/><mass value="1"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{k}" type="continuous"><parent link="{f"link{k - 1}" if k else "base"}"/>'
            f'<child link="link{k}"/><origin xyz="0 0.02 -0.3"/><axis xyz="{k % 2} {(k + 1) % 2} 0"/></joint>'
        )
    return text + "</robot>"


def test_a_long_chain_has_its_base_parameters(tmp_path):
    """7 of each link, less those that turn and lie as the first: Mayeda, Yoshida and Osuka, IEEE TRA 6(3), 1990."""
    count = 24
    body = read_body(written(tmp_path, chain(count)))
    q, v, a = np.random.default_rng(1).uniform(-1, 1, (3, 20, count))
    assert len(body.base) == 7 * count - 4
    whole = body._torque(q, v, a) @ body.standard_values
    np.testing.assert_allclose(body.torque(q, v, a) @ body.values, whole, atol=1e-6 * np.abs(whole).max())
