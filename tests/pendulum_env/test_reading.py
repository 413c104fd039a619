"""Documents, their values, and policies: read, or refused in one sentence."""

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from msgspec import Struct

from agents.network import POLICY_FOLDER, Network
from pendulum_env.errors import FileError
from pendulum_env.reading import Number, Text, convert, read_json, read_toml
from pendulum_env.recording import read_recording


@pytest.mark.parametrize(
    ("read", "name", "text", "match"),
    [
        (lambda path: read_json(path, "a hint"), "a.json", "[" * 100_000, "is not JSON; a hint"),
        (read_toml, "a.toml", "a = " + "[" * 100_000, r"is not TOML \(maximum recursion"),
        (read_toml, "b.toml", "a = ", "is not TOML"),
    ],
)
def test_a_text_that_is_no_document_is_refused(tmp_path: Path, read: Any, name: str, text: str, match: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FileError, match=f"{name}: {match}"):
        read(tmp_path / name)


class Inner(Struct, forbid_unknown_fields=True):
    size: Number
    word: Literal["on", "off"] | None = None
    names: tuple[Text, ...] = ()


class Outer(Struct):
    inner: list[Inner]


@pytest.mark.parametrize(
    ("key", "inner", "match"),
    [
        ("", {}, r"^'inner\[1\]': .* missing required field size$"),
        ("", 3, r"^'inner\[1\]': Expected object, got int$"),
        ("", {"size": "x"}, r"^'inner\[1\].size': Expected float, got str$"),
        ("", {"size": 10**400}, r"^'inner\[1\].size': Number out of range$"),
        ("", {"size": float("nan")}, r"^'inner\[1\].size': Expected float >= -1"),
        ("", {"size": 1, "word": "of"}, r"^'inner\[1\].word' is 'of': expected one of off, on$"),
        ("", {"size": 1, "names": [3]}, r"^'inner\[1\].names\[0\]': Expected str, got int$"),
        ("model", {"size": 1, "sise": 1}, r"^'model.inner\[1\]': unknown key 'sise': did you mean size\?"),
        ("model", {}, r"^'model.inner\[1\]': .* missing required field size$"),
    ],
)
def test_a_value_that_cannot_be_is_told_with_its_key(key: str, inner: Any, match: str) -> None:
    with pytest.raises(FileError, match=match):
        convert({"inner": [{"size": 1}, inner], "of a later version": 3}, Outer, key)


# -------------------------------------------------------------------------------------------------------- policies


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (dict(weight0=None), "it lacks weight0"),
        (dict(constraint=np.array("peek")), "its constraint is 'peek', none of peak, rms"),
        (dict(levels=np.array([np.nan] * 5)), "it holds weights beyond"),
        (dict(levels=np.array([-2.0, -0.5, 0.0, 0.5, 1.0])), "it holds weights beyond"),
        (dict(levels=np.zeros(4)), "its layers, outputs and levels do not follow"),
        (dict(bias0=np.zeros((64, 1))), "its layers, outputs and levels do not follow"),
        (dict(bias0=np.full(64, np.longdouble("1e4000"))), "it holds weights beyond"),
    ],
)
def test_what_makes_no_policy_is_refused_with_the_reason(tmp_path: Path, changes: dict[str, Any], match: str) -> None:
    with np.load(POLICY_FOLDER / "peak.npz") as file:
        arrays = dict(file) | changes
    path = tmp_path / "policy.npz"
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(FileError, match=rf"policy\.npz: is no policy: {match}"):
        Network.load(path)


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, weight0=np.array([print], dtype=object))
    with pytest.raises(FileError, match="Object arrays cannot be loaded"):
        Network.load(path)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices of Unix")
def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "link.csv").symlink_to("/dev/zero")
    for name in ("pipe.csv", "link.csv"):
        with pytest.raises(ValueError, match=rf"{name}: cannot be read \(it is a folder, a device or a pipe\)"):
            read_recording(tmp_path / name)
