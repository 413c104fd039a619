"""Files that anybody may have written: read, or refused in one sentence, within bounds of memory."""

import gzip
import io
import json
import os
import re
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from agents.network import SHIPPED, Network
from pendulum_env.files import write_whole
from pendulum_env.reading import (
    DEPTH,
    DIGITS,
    Unreadable,
    Value,
    parse_toml,
    read_arrays,
    read_json,
    read_own,
    read_toml,
    shown,
)
from pendulum_env.recording import read_recording
from tests import slow
from tests.fuzzing import ANYTHING, READERS, changed, check, written
from tests.patience import PATIENCE


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=60)
@given(data=st.data())
def test_whatever_is_in_a_file_it_is_read_or_refused_in_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    """Good files with bytes replaced, cut out and put in, and mere bytes."""
    ending, read, good = READERS[name]
    path = tmp_path_factory.getbasetemp() / f"fuzz{ending}"
    path.write_bytes(data.draw(changed(good(path))))
    check(read, path)


@pytest.mark.parametrize("name", ["model", "diagnosis"])
@settings(max_examples=200)
@given(data=st.data())
def test_a_document_with_any_value_anywhere_is_read_or_refused_in_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    ending, read, good = READERS[name]
    path = tmp_path_factory.getbasetemp() / f"{name}{ending}"
    content = json.loads(good(path))
    place: Any = content
    while True:  # down to a place that is replaced
        keys = list(place) if isinstance(place, dict) else range(len(place))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.integers(0, 3)) == 0:
            place[key] = data.draw(ANYTHING)
            break
        place = place[key]
    path.write_text(json.dumps(content))
    check(read, path)


@pytest.mark.parametrize("name", READERS)
def test_what_is_changed_above_is_read_as_it_is(tmp_path: Path, name: str) -> None:
    ending, read, good = READERS[name]
    path = tmp_path / f"good{ending}"
    path.write_bytes(good(path))
    assert read(path) is not None


# ------------------------------------------------------------------------------------------------------- documents


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[" * 100_000 + "]" * 100_000, f"line 1: nests more than {DEPTH} deep"),
        ('{"a":\n' * 100_000, f"line {DEPTH + 1}: nests more than {DEPTH} deep"),
        ('{"a": {"b": [0, 1%s]}}' % ("0" * 300), rf"a\.b\[1\] has more than {DIGITS} digits"),
        ('{"a": "b\\u0000"}', r"a holds 'b\\x00', which is no text"),
        ('{"a": ["\\ud800"]}', r"a\[0\] holds '\\ud800', which is no text"),
        ('{"\\u0000": 1}', r"\\x00 holds '\\x00', which is no text"),
        ("{", "is not JSON; a hint"),
        ("", "is not JSON; a hint"),
        ("\ufffe\0", "is not JSON; a hint"),
        (" " * 5_000_001, "holds 5 MB, of which at most 5 MB are read"),
    ],
)
def test_json_that_no_one_meant_is_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(Unreadable, match=rf"a\.json: {match}"):
        read_json(path, "a hint")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a = " + "[" * 100_000, f"line 1: nests more than {DEPTH} deep"),
        ("a = 1\n" + "a." * 40_000 + "b = 1", f"line 2: nests more than {DEPTH} deep: write fewer dots"),
        ("[" + "a . " * 40 + "b]", f"line 1: nests more than {DEPTH} deep: write fewer dots"),
        ("a = " + "9" * 5000, f"holds a number of more than {DIGITS} digits"),
        ("[b]\na = " + "9" * 400, rf"b\.a has more than {DIGITS} digits"),
        ('port = "/dev/tty\\u0000"', r"port holds '/dev/tty\\x00', which is no text"),
        ("a = ", "is not TOML"),
    ],
)
def test_toml_that_no_one_meant_is_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(Unreadable, match=rf"a\.toml: {match}"):
        read_toml(path)


@pytest.mark.parametrize(
    "text",
    [
        "a = '" + "[" * 100 + "'",
        'a = "' + '\\"{' * 100 + '"',
        "a = 1 # " + "[" * 100,
        'a = """\n' + "[" * 100 + '\n"" """',
        "a = '''" + "[." * 100 + "'''",
        "a = [" + "[1.5, 2.5], " * 100 + "]",
        "a = '" + "b." * 100 + "'",
    ],
)
def test_brackets_and_dots_in_texts_nest_nothing(text: str) -> None:
    assert list(parse_toml(text)) == ["a"]
    assert shown(parse_toml(text))


def test_a_value_is_told_with_its_key_and_never_at_length() -> None:
    data = Value("the model", "", {"a": {"b": [1, "x" * 10_000, 10**400, {"c": [[]]}]}})
    items = data["a"]["b"].items()
    assert items[0].number(0, 1) == 1.0
    for fault, match in [
        (lambda: items[0].number(2, 3), r"^'a\.b\[0\]' of the model is 1: it has to be a finite number from 2 to 3$"),
        (lambda: items[0].number(1, 3, above=True), "a number above 1, up to 3"),
        (lambda: items[1].number(), r"^'a\.b\[1\]' of the model is 'x{56}\.\.\.: it has to be"),
        (lambda: items[1].text(), "a text of up to 200 characters"),
        (lambda: items[2].number(), "is a number of more than 18 digits"),
        (lambda: items[3].text(), "is a table: it has to be a text"),
        (lambda: data["a"]["c"], "^the model lacks 'c' under 'a'$"),
        (lambda: data["c"], "^the model lacks 'c'$"),
        (lambda: items[0]["c"], r"'a\.b\[0\]' of the model is 1: it has to be a table"),
        (lambda: data.items(), "^the model is a table: it has to be a list"),
        (lambda: data["a"]["b"].items(3), "is a list of 4: at most 3 are read"),
    ]:
        with pytest.raises(Unreadable, match=match):
            fault()


# ------------------------------------------------------------------------------------------------- regular files only


@pytest.mark.parametrize("name", READERS)
def test_a_device_a_pipe_and_a_folder_are_refused_at_once(tmp_path: Path, name: str) -> None:
    ending, read, _ = READERS[name]
    pipe, link, folder = (tmp_path / f"{what}{ending}" for what in ("pipe", "link", "folder"))
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    folder.mkdir()
    for path, reason in [(pipe, "it is a device or a pipe"), (link, "it is a device or a pipe"), (folder, "directory")]:
        with pytest.raises(ValueError, match=reason):
            read(path)
    sparse = tmp_path / f"sparse{ending}"
    with sparse.open("wb") as file:
        file.truncate(100 * 10**9)  # takes no room
    with pytest.raises(ValueError, match="holds 100 GB, of which at most"):
        read(sparse)


@pytest.mark.skipif(not Path("/proc/kmsg").exists(), reason="a file of Linux")
@pytest.mark.parametrize("name", READERS)
def test_a_file_that_waits_for_what_the_system_will_say_is_refused_at_once(tmp_path: Path, name: str) -> None:
    ending, read, _ = READERS[name]
    path = tmp_path / f"made{ending}"
    path.symlink_to("/proc/kmsg")  # a regular file
    with pytest.raises(ValueError, match="the system makes it up"):
        read(path)


@pytest.mark.skipif(not hasattr(os, "statvfs"), reason="a call of Unix")
def test_a_file_system_that_gives_no_answer_is_told_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(path: object) -> None:
        raise OSError(116, "Stale file handle")

    monkeypatch.setattr(os, "statvfs", gone)
    path = tmp_path / "a.json"
    path.touch()
    with pytest.raises(Unreadable, match=r"a\.json: cannot be read \(Stale file handle\): check the path"):
        read_json(path, "a hint")


# ---------------------------------------------------------------------------------------------------------- memory


def header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def bomb_npz(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "position", "torque"):
            archive.writestr(f"{name}.npy", header((10**9,)))


def bomb_gzip(path: Path) -> None:
    rows = gzip.compress(b"0.001,0.5,1.5\n" * 700_000)
    path.write_bytes(gzip.compress(b"time,position,torque\n") + rows * 1200)  # 12 GB


def bomb_line(path: Path) -> None:
    path.write_bytes(gzip.compress(b"time,position,torque\n0,0,0\n1,") + gzip.compress(bytes(10_000_000)) * 40)


def bomb_parquet(path: Path) -> None:
    table = pa.table({name: np.zeros(10_000_000) for name in ("time", "position", "torque")})  # a run of zeros: 2 kB
    with pq.ParquetWriter(path, table.schema) as writer:
        for _ in range(3):
            writer.write_table(table, row_group_size=10_000_000)


def bomb_mat(path: Path) -> None:
    packed = zlib.compress(b"\x0e\0\0\0" + b"\xff\xff\xff\x7f" + bytes(510_000_000), 1)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + b"\x0f\0\0\0" + len(packed).to_bytes(4, "little") + packed)


def bomb_hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    pack = zlib.compressobj(1)
    once = pack.compress(bytes(10_000_000)) + pack.flush(zlib.Z_FULL_FLUSH)
    with h5py.File(path, "w") as file:
        for name in ("time", "position", "torque"):
            dataset = file.create_dataset(name, (1000,), "f8", chunks=(1000,), compression="gzip")
            dataset.id.write_direct_chunk((0,), once + once[2:] * 200)  # 2 GB


def bomb_excel(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sharedStrings.xml", "<sst><si><t>" + "y" * 1_000_000 + "</t></si></sst>")
        archive.writestr("xl/worksheets/sheet1.xml", '<c r="A1" t="s"><v>0</v></c>' * 10_000)


def bomb_ods(path: Path) -> None:
    text = f'<table:table-cell office:value-type="string"><text:p>{"y" * 1_000_000}</text:p></table:table-cell>'
    row = f'<table:table-row table:number-rows-repeated="10000">{text}</table:table-row>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("content.xml", f"<table:table>{row}</table:table>")


def bomb_header(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("time.npy", b"\x93NUMPY\x02\0" + (10**9).to_bytes(4, "little") + b" " * 400_000_000)


BOMBS = {
    "a.npz": (bomb_npz, "it holds 24 GB or more when unpacked, of which at most 500 MB are read: shorten it, or allow"),
    "a.csv.gz": (bomb_gzip, "it holds 50. MB or more when unpacked, of which at most 500 MB are read"),
    "b.csv.gz": (bomb_line, "a line is longer than 1048576 characters"),
    "a.parquet": (bomb_parquet, "it holds 720 MB or more when unpacked"),
    "a.mat": (bomb_mat, "when unpacked, of which at most 500 MB are read"),
    "a.xlsx": (bomb_excel, "it holds 10 GB or more when unpacked, of which at most 500 MB are read"),
    "a.ods": (bomb_ods, "it holds 10 GB or more when unpacked, of which at most 500 MB are read"),
    "header.npz": (bomb_header, r"header\.npz: .*is damaged, or no NPZ archive \("),
    "name.csv": (lambda path: path.write_text(f"time{'[' * 1_000_000},a\n0,0\n"), "no column for position, torque"),
    "a.h5": (bomb_hdf5, "of which at most 8 kB are read: dataset '/time' is damaged, save it again"),
}
READ = """
import contextlib, resource, sys
resource.setrlimit(resource.RLIMIT_DATA, (4_000_000_000,) * 2)  # libraries set much aside that they never use
from pendulum_env.recording import read_recording
from scipy.io import loadmat  # before what is measured
with contextlib.suppress(ImportError):
    import h5py
def most():  # kB that were in use
    status = open("/proc/self/status").read().split()
    return int(status[status.index("VmHWM:") + 1])
before = most()
try:
    read_recording(sys.argv[1])
except ValueError as error:
    print(error)
print(most(), most() - before)
"""


def told_and_most(path: Path) -> tuple[str, int, int]:
    """What is said of a file, the most memory that was in use, and how much of it for reading [kB]."""
    run = subprocess.run(
        [sys.executable, "-c", READ, path], capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    told, most = run.stdout.splitlines()
    assert run.stderr == ""
    all_of_it, reading = map(int, most.split())
    return told, all_of_it, reading


@pytest.mark.parametrize("name", slow.but(["b.csv.gz", "a.npz", "a.parquet", "a.xlsx"], BOMBS))
def test_what_unpacks_to_gigabytes_is_refused_before_it_fills_the_memory(tmp_path: Path, name: str) -> None:
    make, match = BOMBS[name]
    path = tmp_path / name
    make(path)
    told, most, _ = told_and_most(path)
    assert re.search(match, told)
    assert most < 1_000_000
    path.unlink()


@pytest.mark.parametrize("ending", [".npz", ".mat", ".h5"])
def test_arrays_are_in_memory_once(tmp_path: Path, ending: str) -> None:
    """So that a file just below the limit takes less than a gigabyte."""
    path, arrays = tmp_path / f"still{ending}", {name: np.zeros(3_000_000) for name in ("time", "position", "torque")}
    if ending == ".npz":
        np.savez(path, **arrays)
    elif ending == ".mat":
        savemat(path, arrays, do_compression=True)
    else:
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, values in arrays.items():
                file.create_dataset(name, data=values, chunks=(100_000,), compression="gzip")
    told, _, reading = told_and_most(path)
    assert "in every row" in told
    assert 1024 * reading < 1.6 * sum(array.nbytes for array in arrays.values())


def test_the_limit_of_a_recording_is_an_option(tmp_path: Path) -> None:
    for ending in (".csv", ".csv.gz", ".npz", ".parquet"):
        path = tmp_path / f"run{ending}"
        written(path)
        with pytest.raises(
            ValueError, match=r"of which at most 2 kB are read: shorten it, or allow more by --max-size"
        ):
            read_recording(path, largest=2000)
        assert len(read_recording(path, largest=30_000)) == 300


def test_an_archive_with_too_long_a_list_of_contents_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(20_000):
            archive.writestr(f"weight{k}.npy", b"")
    with pytest.raises(Unreadable, match=r"many\.npz: lists .* of contents, of which at most 1 MB are read"):
        read_arrays(path, "a hint")


# -------------------------------------------------------------------------------------------------------- policies


def edited(**changes: object) -> Callable[[dict[str, Any]], None]:
    """Replace arrays, or take them out where None."""

    def edit(arrays: dict[str, Any]) -> None:
        for name, value in changes.items():
            if value is None:
                del arrays[name]
            else:
                arrays[name] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (edited(weight0=None), "it lacks weight0"),
        (edited(bias1=None), "it lacks bias1"),
        (edited(constraint=None), "its constraint is ''"),
        (edited(constraint=np.array("peek")), "its constraint is 'peek', none of peak, rms"),
        (edited(levels=np.array([np.nan] * 5)), "levels holds a number that is not finite"),
        (edited(levels=np.array([-2.0, -0.5, 0.0, 0.5, 1.0])), "a level is beyond 1"),
        (edited(levels=np.array(["a"] * 5)), "levels has type '<U1'"),
        (edited(levels=np.zeros(4)), "outputs and levels differ in number"),
        (edited(levels=np.zeros((5, 1))), "levels has type .* and shape"),
        (edited(weight0=np.zeros((64, 3))), "weight0 has shape"),
        (edited(weight1=np.zeros((64, 63))), r"weight1 has shape \(64, 63\), where \(64, 64\) follows"),
        (edited(weight1=np.full((64, 64), np.inf)), "weight1 holds a number that is not finite"),
        (edited(weight1=np.full((64, 64), 1e30)), r"weight1 holds a number that is not finite, or beyond 1e\+06"),
        (edited(bias0=np.zeros((64, 1))), "bias0 has type"),
        (edited(bias0=np.zeros(0)), "bias0 has type"),
        (edited(bias0=np.zeros(64, dtype=complex)), "bias0 has type 'complex128'"),
    ],
)
def test_what_makes_no_policy_is_refused_with_the_reason(tmp_path: Path, edit: Any, match: str) -> None:
    with np.load(SHIPPED / "peak.npz") as file:
        arrays = dict(file)
    edit(arrays)
    path = tmp_path / "policy.npz"
    np.savez(path, **arrays)
    with pytest.raises(Unreadable, match=rf"policy\.npz: is no policy: {match}"):
        Network.load(path)


def test_a_policy_cut_or_with_a_flipped_byte_is_never_used(tmp_path: Path) -> None:
    path, good = tmp_path / "policy.npz", (SHIPPED / "peak.npz").read_bytes()
    want = Network.load(SHIPPED / "peak.npz")
    rng = np.random.default_rng(0)
    for place in rng.integers(len(good), size=60):
        path.write_bytes(good[:place])
        with pytest.raises(Unreadable):
            Network.load(path)
        path.write_bytes(good[:place] + bytes([good[place] ^ 1 << int(rng.integers(8))]) + good[place + 1 :])
        try:
            got = Network.load(path)
        except Unreadable:
            continue
        for ours, theirs in zip((*got.weights, *got.biases), (*want.weights, *want.biases), strict=True):
            np.testing.assert_array_equal(ours, theirs)  # a bit that means nothing, as of a date


def test_nothing_is_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, weight0=np.array([print], dtype=object))
    with pytest.raises(Unreadable, match="Object arrays cannot be loaded"):
        Network.load(path)


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of Unix")
def test_what_runs_when_it_is_read_has_to_be_this_users_own(tmp_path, monkeypatch):
    path = tmp_path / "training.pkl"
    write_whole(path, b"content", private=True)
    assert read_own(path) == b"content"
    assert path.stat().st_mode & 0o777 == 0o600
    for mode in (0o620, 0o602):
        path.chmod(mode)
        with pytest.raises(Unreadable, match=r"others may write to it, .*: chmod go-w it"):
            read_own(path)
    path.chmod(0o600)
    monkeypatch.setattr(os, "getuid", lambda: os.stat(path).st_uid + 1)
    with pytest.raises(Unreadable, match="belongs to another user"):
        read_own(path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(Unreadable, match="it is no file"):
        read_own(pipe)
    with pytest.raises(Unreadable, match="No such file"):
        read_own(tmp_path / "nowhere")
