"""Documents, their values, and policies: read, or refused in one sentence."""

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from msgspec import Struct

from agents.network import POLICY_FOLDER, Network
from pendulum_env.errors import FileError
from pendulum_env.files import write_whole
from pendulum_env.reading import DIGITS, Number, Text, convert, read_json, read_own, read_toml
from pendulum_env.recording import read_recording

# ------------------------------------------------------------------------------------------------------- documents


JSON, TOML = (lambda path: read_json(path, "a hint"), ".json"), (read_toml, ".toml")


@pytest.mark.parametrize(
    ("kind", "text", "match"),
    [
        (JSON, "[" * 100_000 + "]" * 100_000, "is not JSON; a hint"),
        (JSON, '{"a": 1%s}' % ("0" * 300), f"holds a number of more than {DIGITS} digits"),
        (JSON, '{"a": ["b\\u0000"]}', r"holds 'b\\x00', which is no text"),
        (JSON, '{"\\ud800": 1}', r"holds '\\ud800', which is no text"),
        (JSON, '{"a": 1%s}' % ("0" * 5000), "is not JSON; a hint"),
        (TOML, "a = " + "[" * 100_000, r"is not TOML \(maximum recursion"),
        (TOML, "a = [" + "9" * 400 + "]", f"holds a number of more than {DIGITS} digits"),
        (TOML, 'a = "\\u0000"', r"holds '\\x00', which is no text"),
    ],
)
def test_a_document_that_no_one_meant_is_refused(tmp_path: Path, kind: Any, text: str, match: str) -> None:
    (read, ending), path = kind, tmp_path / f"a{kind[1]}"
    path.write_text(text)
    with pytest.raises(FileError, match=rf"a\{ending}: {match}"):
        read(path)


class Inner(Struct, forbid_unknown_fields=True):
    size: Number
    word: Literal["on", "off"] | None = None
    sign: Literal[1, -1] = 1
    names: tuple[Text, ...] = ()
    sizes: dict[str, Number] = {}


class Outer(Struct):
    inner: list[Inner]


@pytest.mark.parametrize(
    ("key", "inner", "match"),
    [
        ("", {}, r"^'inner\[1\]' lacks 'size'$"),
        ("", 3, r"^'inner\[1\]' is 3: expected a table$"),
        ("", {"size": "x" * 10_000}, r"^'inner\[1\].size' is 'x{27}\.\.\.x{28}': expected a number$"),
        ("", {"size": 10**400}, r"^'inner\[1\].size' is 10{27}\.\.\.0{29}: number out of range$"),
        ("", {"size": float("nan")}, r"is nan: expected a number >= -1e\+09$"),
        ("", {"size": 1, "word": "of"}, r"^'inner\[1\].word' is 'of': expected one of off, on$"),
        ("", {"size": 1, "sign": 2}, r"^'inner\[1\].sign' is 2: expected one of -1, 1$"),
        ("", {"size": 1, "names": [{"a": [[]]}]}, r"^'inner\[1\].names\[0\]' is {.*}: expected a text$"),
        ("", {"size": 1, "sizes": {"a": "b"}}, r"^'inner\[1\].sizes' is {'a': 'b'}: expected a number$"),
        ("model", {"size": 1, "sise": 1}, r"^'model.inner\[1\]': unknown key 'sise': did you mean size\?"),
        ("model", {}, r"^'model.inner\[1\]' lacks 'size'$"),
    ],
)
def test_a_value_that_cannot_be_is_told_with_its_key(key: str, inner: Any, match: str) -> None:
    with pytest.raises(FileError, match=match):
        convert({"inner": [{"size": 1}, inner], "of a later version": 3}, Outer, key)


# ----------------------------------------------------------------------------------------------------------- files


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices of Unix")
def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "link.csv").symlink_to("/dev/zero")
    for name in ("pipe.csv", "link.csv"):
        with pytest.raises(ValueError, match=rf"{name}: cannot be read \(it is a folder, a device or a pipe\)"):
            read_recording(tmp_path / name)


# -------------------------------------------------------------------------------------------------------- policies


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (dict(weight0=None), "it lacks weight0"),
        (dict(constraint=np.array("peek")), "its constraint is 'peek', none of peak, rms"),
        (dict(levels=np.array([np.nan] * 5)), "levels holds something else than numbers up to 1e"),
        (dict(levels=np.array([-2.0, -0.5, 0.0, 0.5, 1.0])), "a level is beyond 1"),
        (dict(levels=np.zeros(4)), "its layers, outputs and levels do not follow"),
        (dict(bias0=np.zeros((64, 1))), "bias0 has 2 axes, where 1 is needed"),
        (dict(bias0=np.full(64, np.longdouble("1e4000"))), "bias0 holds something else"),
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


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of Unix")
def test_what_runs_when_it_is_read_has_to_be_this_users_own(tmp_path, monkeypatch):
    path = tmp_path / "training.pkl"
    write_whole(path, b"content", private=True)
    assert read_own(path) == b"content"
    assert path.stat().st_mode & 0o777 == 0o600
    for mode in (0o620, 0o602):
        path.chmod(mode)
        with pytest.raises(FileError, match=r"others may write to it, .*: chmod go-w it"):
            read_own(path)
    path.chmod(0o600)
    monkeypatch.setattr(os, "getuid", lambda: os.stat(path).st_uid + 1)
    with pytest.raises(FileError, match="belongs to another user"):
        read_own(path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(FileError, match="it is no file"):
        read_own(pipe)
    with pytest.raises(FileError, match="No such file"):
        read_own(tmp_path / "nowhere")
