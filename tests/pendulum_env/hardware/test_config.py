"""rig.toml: what is wrong is named."""

from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from pendulum_env.backends.hardware.config import ConfigError, DaqSettings, SerialSettings, load, mark_checked

PLAIN = 'adapter = "serial"\n[serial]\nport = "/dev/ttyACM0"\n'
DOCUMENTED = Path(__file__).parents[3] / "docs" / "hardware.md"


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "rig.toml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("adapter = ", "is not TOML"),
        ("", "Object missing required field adapter"),
        ('adapter = "can"\n', "unknown adapter 'can'; known: nidaq, serial"),
        ('adapter = "serial"\n[serial]\n', "'serial': Object missing required field port"),
        (PLAIN + "[limit]\ntorque = 3\n", "unknown key 'limit': did you mean limits"),
        (PLAIN + "[limits]\ntorqe = 3\n", "'limits': unknown key 'torqe': did you mean torque"),
        (PLAIN + "[limits]\ntorque = 20\n", "'limits.torque': Expected float <= 15"),
        (PLAIN + "[limits]\nunchecked_torque = 3\n", "'limits.unchecked_torque': Expected float <= 2"),
        (PLAIN + "[encoder]\nsign = 0\n", "'encoder.sign' is 0: expected one of -1, 1"),
        (PLAIN + "[limits]\nsoft_velocity = 40\n", "limits.soft_velocity is above limits.hard_velocity"),
        (PLAIN + "[limits]\ngap = 0.001\n", "limits.gap is below two periods of 0.001 s"),
        (PLAIN + "[rest]\ntimeout = 0.2\n", "rest.timeout is not above rest.seconds"),
        (PLAIN + "[limits]\ngap = 0.1\n", "limits.gap is above limits.watchdog"),
    ],
)
def test_a_mistake_is_named_with_its_file_and_key(written, text, said):
    with pytest.raises(ConfigError, match="rig.toml: .*" + said):
        load(written(text))


def test_the_check_allows_more_torque_until_the_wiring_changes(written):
    path = written(PLAIN + "[limits]\ntorque = 5.0\n")
    assert load(path).max_torque == 2.0
    mark_checked(load(path))
    assert load(path).max_torque == 5.0
    assert load(written(PLAIN + "[limits]\ntorque = 7.0\n")).max_torque == 7.0  # no wiring
    for change in ("[encoder]\nsign = -1\n", "[encoder]\ncounts = 4096\n", "baud = 9600\n"):
        assert load(written(PLAIN + change)).max_torque == 2.0
    assert load(written("torque_sign = -1\n" + PLAIN)).max_torque == 2.0


def test_the_documented_configuration_is_whole_and_has_the_defaults(written):
    """The page shows every table and key; what it shows as usual is what comes without it."""
    block = DOCUMENTED.read_text().split("```toml\n")[1].split("```")[0]
    shown = load(written(block))
    tables = {name: table for name, table in vars(shown).items() if is_dataclass(table) and name != "link"}
    for name, kind in {**tables, "serial": SerialSettings, "nidaq": DaqSettings}.items():
        table = block.split(f"[{name}]\n")[1].split("\n[")[0]
        for field in fields(kind):
            assert f"\n{field.name} = " in "\n" + table, f"{name}.{field.name}"
    for key in ("adapter", "rate", "torque_sign", "realtime", "log"):
        assert f"\n{key} = " in "\n" + block
    plain = load(written(PLAIN))
    for name in ("encoder", "limits", "fault", "rest"):
        assert getattr(shown, name) == getattr(plain, name)
