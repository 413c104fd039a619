"""Adapters that installed packages offer: found by name, and no mistake in them ends more than the reading of a rig."""

import pytest

from pendulum_env.backends.hardware.config import ConfigError, EncoderSettings, load, mark_checked
from pendulum_env.backends.hardware.drive import BUILT_IN, find_adapter, list_adapters, register
from pendulum_env.errors import UserError
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


ADAPTER = """
from dataclasses import dataclass, field

@dataclass(frozen=True, slots=True)
class Slots:
    address: str = ""
    device: str = "slots"

@dataclass(frozen=True)
class Nested:
    more: Slots = field(default_factory=Slots)
    device: str = "nested"

class WithSlots:
    settings = Slots

class WithTable:
    settings = Nested
"""


@pytest.mark.parametrize(("adapter", "table"), [("WithSlots", "{}"), ("WithTable", "[lab.more]\n{}")])
def test_the_check_holds_for_the_settings_of_any_adapter_until_they_change(tmp_path, monkeypatch, adapter, table):
    install(tmp_path, monkeypatch, "lab", ADAPTER, {"lab": f"lab:{adapter}"})

    def most(address: str) -> float:
        path = rig(tmp_path, "lab", table.format(f"address = '{address}'") + "\n[limits]\ntorque = 5.0")
        return load(path).max_torque

    assert most("left") == 2.0
    mark_checked(load(tmp_path / "rig.toml"))
    assert most("left") == 5.0
    assert most("right") == 2.0


@pytest.mark.parametrize("settings", [None, 3, EncoderSettings()])
def test_an_adapter_without_a_dataclass_of_settings_is_not_registered(settings):
    with pytest.raises(UserError, match=r"the adapter 'bench' \(Bench\) has no dataclass 'settings': see docs"):
        register("bench", type("Bench", (), {"settings": settings}))
    assert "bench" not in list_adapters()


def test_nothing_takes_the_place_of_a_built_in_adapter(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "other", "", {"serial": "other:Serial"})
    assert list_adapters()["serial"] is BUILT_IN["serial"]
    pytest.importorskip("serial")
    with pytest.raises(ValueError, match="'serial' is taken"):
        register("serial", find_adapter("serial"))
