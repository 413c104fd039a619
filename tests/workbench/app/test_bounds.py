"""What a page may ask of the server's disk, memory and time; and what it hears when something has gone meanwhile."""

import base64
import json
import os
import shutil
import signal
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import Recording, write_recording
from tests.patience import PATIENCE

pytest.importorskip("dash")

from plotly.utils import PlotlyJSONEncoder

from tests.fuzzing import Page
from workbench.app import session as session_module
from workbench.app import sessions as sessions_module
from workbench.app.jobs import Job, Worker, Workers
from workbench.app.session import Session
from workbench.app.sessions import Sessions
from workbench.app.stages import data

HOSTILE = "<img src=x onerror=alert(1)>"
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def session(tmp_path):
    folder = tmp_path / "session"
    folder.mkdir()
    return Session(folder)


def content(tmp_path, name="run.csv"):
    at = np.arange(400) / 100.0
    write_recording(Recording("run", at, np.sin(3 * at), np.cos(3 * at)), tmp_path / name)
    return (tmp_path / name).read_bytes()


def upload(session, name, body):
    session.act(lambda: session.receive([(name, f"data:;base64,{base64.b64encode(body).decode()}")], unwrap=False))


def test_files_of_a_session_take_so_much_of_the_disk_and_no_more(session, tmp_path, monkeypatch):
    body = content(tmp_path)
    monkeypatch.setattr(session_module, "SPACE", 2.5 * len(body))
    for name in ("a.csv", "b.csv", "c.csv"):
        upload(session, name, body)
    assert "c.csv: " in session.notice and "of files are enough: remove one first" in session.notice
    assert sorted(file.name for file in session.folder.iterdir()) == ["a.csv", "b.csv"]
    session.act(lambda: session.remove("a.csv"))
    upload(session, "c.csv", body)
    assert session.notice == ""


def test_a_disk_without_room_is_told_before_it_is_full(session, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**12, 10**12, 50_000_000))
    upload(session, "a.csv", content(tmp_path))
    assert session.notice.startswith("a.csv: there is no room left on the disk")
    assert list(session.folder.iterdir()) == []


def test_recordings_of_a_session_are_so_long_and_no_longer(session, tmp_path, monkeypatch):
    monkeypatch.setattr(session_module, "MOST_SAMPLES", 700)
    for name in ("a.csv", "b.csv"):
        upload(session, name, content(tmp_path))
    assert session.notice == "700 samples are enough: remove a recording first"
    assert [file.name for file in session.folder.iterdir()] == ["a.csv"]


def test_sessions_that_nobody_asks_for_end_and_so_do_too_many(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(sessions_module.time, "monotonic", lambda: now[0])
    sessions = Sessions()
    old, kept = sessions.of("0" * 32), sessions.of("1" * 32)
    now[0] = 0.9 * sessions_module.IDLE
    assert sessions.of("1" * 32) is kept
    now[0] = 1.1 * sessions_module.IDLE
    assert sessions.of("1" * 32) is kept and not old.folder.exists()
    assert sessions.of("0" * 32) is not old
    many = [sessions.of(f"{k:032x}") for k in range(16, 16 + sessions_module.MOST_SESSIONS)]
    assert not kept.folder.exists() and all(one.folder.exists() for one in many)
    sessions.close()


def test_a_folder_that_was_cleaned_up_is_made_anew(tmp_path):
    sessions = Sessions()
    session = sessions.of("0" * 32)
    shutil.rmtree(session.folder.parent)
    upload(session, "a.csv", content(tmp_path))
    assert session.notice == "" and len(session.state.loaded) == 1
    shutil.rmtree(session.folder.parent, ignore_errors=True)
    assert sessions.of("1" * 32).folder.is_dir()
    sessions.close()


def test_a_file_that_has_vanished_is_a_sentence_and_no_failure(tmp_path):
    page = Page()
    try:
        upload(page.session, "run.csv", content(tmp_path))
        page.session.find("run.csv").file.unlink()
        for one in page.callbacks:
            if not one.get("clientside_function"):
                assert page.ask(one, [1] * 9) in (200, 204)
        answer = page.client.post("/_dash-update-component", json={"output": "nothing.at_all", "inputs": []})
        assert answer.status_code == 400
    finally:
        page.close()


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_a_worker_that_is_killed_is_a_sentence():
    workers = Workers()
    worker = workers._spare = Worker()
    os.kill(worker._process.pid, signal.SIGKILL)
    told = []
    job = Job("Diagnosing", len, workers, lambda *_: None, lambda _, why: told.append(why))
    workers.take = lambda: worker  # it died just after it was found to be alive
    worker._process.join()
    job.start()
    assert job.over.wait(PATIENCE)
    assert told == ["the work ended unexpectedly: try again"]
    workers.close()


def test_names_of_files_and_columns_are_text(session, tmp_path):
    """A browser shows what is a child of a component as text; markup would have to be asked for, and is nowhere."""
    lines = content(tmp_path).decode().splitlines()
    lines[0] = f"time,{HOSTILE},<script>alert(1)</script>"
    upload(session, f"{HOSTILE}.csv", "\n".join(lines).encode())
    (card,) = session.cards
    assert "<" not in card.file.name
    shown = json.dumps(data.show(session), cls=PlotlyJSONEncoder)
    assert json.dumps(HOSTILE)[1:-1] in shown  # its name is there
    assert "DangerouslySetInnerHTML" not in shown and "dangerously_allow_html" not in shown
    source = "".join(path.read_text() for path in Path(data.__file__).parent.parent.rglob("*.py"))
    assert "dangerously_allow_html" not in source and "DangerouslySetInnerHTML" not in source
