"""Files that are written whole, to places that were checked."""

import os
from pathlib import Path

import pytest

from pendulum_env.files import check_output, write_whole


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "a.txt"
    for text in ("old", "new ±"):
        write_whole(path, text)
        assert path.read_text(encoding="utf-8") == text
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "\ud800")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_links_are_followed(tmp_path):
    target, link = tmp_path / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    write_whole(link, "new")
    assert link.is_symlink() and target.read_text() == "new"


def test_devices_are_written_to_and_not_replaced():
    write_whole(os.devnull, "gone")
    assert not Path(os.devnull).is_file()


def test_places_that_cannot_be_written_are_refused(tmp_path):
    assert check_output(str(tmp_path / "a.txt")) == tmp_path / "a.txt"
    with pytest.raises(OSError, match="is a folder"):
        check_output(tmp_path)
    with pytest.raises(OSError, match=r"there is no folder .*nowhere: create it first"):
        check_output(tmp_path / "nowhere" / "a.txt")
