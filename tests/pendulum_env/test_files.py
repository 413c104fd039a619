"""Files that are written whole, to places that were checked."""

import json
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.files import check_output, format_json, write_whole
from pendulum_env.recording import Recording, RecordingError, write_recording
from tests.disks import full_after


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a.txt"
    for text in ("old", "new ±"):
        write_whole(path, text)
        assert path.read_text(encoding="utf-8") == text
    assert list(tmp_path.iterdir()) == [path]


def test_numbers_that_are_not_finite_become_null():
    content = {"a": [1e-320, np.float64(0.1), np.inf, -np.inf, np.nan, "NaN"], "b": 1 / 3}
    assert json.loads(format_json(content)) == {"a": [1e-320, 0.1, None, None, None, "NaN"], "b": 1 / 3}


def test_a_write_that_fails_or_a_disk_that_is_full_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "\ud800")
    with full_after(1000), pytest.raises(OSError, match="too large") as caught:
        write_whole(path, "new" * 1000)
    assert caught.value.filename == str(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["run.csv.gz", "run.parquet"])
def test_a_recording_for_which_there_is_no_room_is_not_written(tmp_path, name):
    rng = np.random.default_rng(0)
    run = Recording(np.arange(3000) / 1000.0, rng.normal(size=3000), rng.normal(size=3000), name="run")
    told = rf"{name}: cannot be written .*: choose another place"
    with full_after(20_000), pytest.raises(RecordingError, match=told):
        write_recording(run, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_links_are_followed(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    write_whole(link, "new")
    assert link.is_symlink() and target.read_text() == "new"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_nobody_may_read_what_they_could_not_read_before(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "old")
    path.chmod(0o600)
    write_whole(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600 and path.read_text() == "new"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_devices_are_written_to_and_not_replaced_and_one_that_is_full_is_told():
    write_whole(os.devnull, "gone")
    assert not Path(os.devnull).is_file()
    with pytest.raises(OSError, match="No space left on device"):
        write_whole("/dev/full", "text")


def test_places_that_cannot_be_written_are_refused(tmp_path):
    assert check_output(str(tmp_path / "a.txt")) == tmp_path / "a.txt"
    with pytest.raises(OSError, match="is a folder"):
        check_output(tmp_path)
    with pytest.raises(OSError, match=r"there is no folder .*nowhere: create it first"):
        check_output(tmp_path / "nowhere" / "a.txt")
