"""Adapters that installed packages offer: found by name, and no mistake in them ends more than the reading of a rig."""

import pytest

from pendulum_env.backends.hardware.adapter import BUILT_IN, list_adapters
from pendulum_env.backends.hardware.config import ConfigError, load
from tests.pendulum_env.packages import install, install_bench


def rig(folder, adapter, table=""):
    path = folder / "rig.toml"
    path.write_text(f'adapter = "{adapter}"\n[{adapter}]\n{table}\n')
    return path


def test_a_package_offers_an_adapter_with_settings_which_an_unknown_one_is_told_with(tmp_path, monkeypatch):
    install_bench(tmp_path, monkeypatch)
    config = load(rig(tmp_path, "bench", 'address = "left"\nrated_torque = 3.0'))
    assert (config.link.address, config.link.rated_torque, config.link.device) == ("left", 3.0, "bench left")
    with pytest.raises(ConfigError, match=r"'bench.rated_torque': Expected float >= 0.001"):
        load(rig(tmp_path, "bench", 'address = "left"\nrated_torque = 0'))
    with pytest.raises(ConfigError, match=r"unknown adapter 'bensh': did you mean bench\? Known: bench, nidaq"):
        load(rig(tmp_path, "bensh"))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import a_library_that_is_not_installed", "ModuleNotFoundError: No module named 'a_library"),
        ("raise SystemExit(1)", "SystemExit"),
        ("class Broken: settings = 3", "has no dataclass 'settings'"),
        ("", "AttributeError: module 'broken' has no attribute 'Broken'"),
    ],
)
def test_an_adapter_that_cannot_be_loaded_is_one_sentence_with_its_package(tmp_path, monkeypatch, text, why):
    install(tmp_path, monkeypatch, "broken", text, {"broken": "broken:Broken"})
    with pytest.raises(ConfigError, match=r"rig.toml: the adapter 'broken' ") as failed:
        load(rig(tmp_path, "broken"))
    assert why in str(failed.value) and "broken:Broken" in str(failed.value)
    assert len(str(failed.value).splitlines()) == 1


def test_nothing_takes_the_place_of_a_built_in_adapter(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "other", "", {"serial": "other:Serial"})
    assert list_adapters()["serial"] is BUILT_IN["serial"]
