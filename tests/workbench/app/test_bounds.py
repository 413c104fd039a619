"""What a page may ask of the server's disk, memory and time; and what it hears when something has gone meanwhile."""

import json
import shutil
import socket
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from plotly.utils import PlotlyJSONEncoder

from tests.patience import PATIENCE
from tests.workbench.app.plants import upload
from tests.workbench.app.requests import Page
from workbench.app.page import server
from workbench.app.session import MAX_SESSIONS, Sessions
from workbench.app.stages import data

HOSTILE = "<img src=x onerror=alert(1)>"


def content():
    rows = "".join(f"{k / 100},{np.sin(k / 33):.9g},{np.cos(k / 33):.9g}\n" for k in range(400))
    return f"time,position,torque\n{rows}".encode()


def test_files_of_all_tabs_lie_in_one_folder_that_goes_with_the_server():
    sessions = Sessions()
    tabs = [sessions.find_session(f"{k:032x}") for k in range(2)]
    for tab in tabs:
        upload(tab, "a.csv", content())
    files = {tab.state.find("a.csv").source.file for tab in tabs}
    folder = tabs[0].folder
    assert len(files) == 2 and all(file.is_relative_to(folder) and file.is_file() for file in files)
    sessions.close()
    assert not folder.exists()


def test_a_request_that_is_too_large_is_refused(page):
    claimed = {"CONTENT_LENGTH": str(server.LARGEST + 1)}
    answer = page.client.post("/_dash-update-component", json={}, environ_overrides=claimed)
    assert answer.status_code == 413


def test_of_too_many_sessions_the_oldest_end():
    sessions = Sessions()
    kept = sessions.find_session("1" * 32)
    many = [sessions.find_session(f"{k:032x}") for k in range(16, 16 + MAX_SESSIONS)]
    kept.run_action(lambda: pytest.fail("it has ended"))
    assert "load the page again" in kept.notice
    assert all(one is sessions.find_session(f"{k:032x}") for k, one in enumerate(many, 16))
    sessions.close()


def test_a_folder_that_was_cleaned_up_is_made_anew(page):
    shutil.rmtree(page.session.folder)
    upload(page.session, "a.csv", content())
    assert page.session.notice == "" and len(page.session.state.loaded) == 1


@pytest.fixture
def page():
    page = Page()
    yield page
    page.close()


def test_a_file_that_has_vanished_is_a_sentence_and_no_failure(page):
    upload(page.session, "run.csv", content())
    page.session.state.find("run.csv").source.file.unlink()
    for one in page.callbacks:
        if not one.get("clientside_function"):
            assert page.ask(one, [1] * 9) in (200, 204)
    answer = page.client.post("/_dash-update-component", json={"output": "nothing.at_all", "inputs": []})
    assert answer.status_code == 400


@pytest.mark.parametrize(
    "begun", [b"GET / HT", b"GET / HTTP/1.1\r\nHost: a", b"POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\n{"]
)
def test_a_request_that_does_not_go_on_is_not_waited_for(monkeypatch, capfd, begun):
    monkeypatch.setattr(server._SilentHandler, "timeout", 0.05)
    here = server.Server()
    thread = Thread(target=here._server.serve_forever)
    thread.start()
    with socket.create_connection(here._server.server_address, PATIENCE) as half:
        half.sendall(begun)
        while half.recv(1000):
            pass  # ends when the server has closed its side
    here._server.shutdown()
    thread.join()
    here.close()
    assert capfd.readouterr().err == ""


def test_a_fault_of_a_callback_is_one_line_on_the_terminal(page, caplog):
    (one,) = [one for one in page.callbacks if one["inputs"][0]["id"] == "upload"]
    assert page.ask(one, [["unwrap"], None, ["data:,"]]) == 200
    (record,) = caplog.records
    assert "TypeError" in record.getMessage() and record.exc_info is None and "\n" not in record.getMessage()


def test_names_of_files_and_columns_are_text(session):
    """A browser shows what is a child of a component as text; markup would have to be asked for, and is nowhere."""
    lines = content().decode().splitlines()
    lines[0] = f"time,{HOSTILE},<script>alert(1)</script>"
    upload(session, f"{HOSTILE}.csv", "\n".join(lines).encode())
    (card,) = session.cards
    assert "<" not in card.source.file.name
    shown = json.dumps(data.show(session), cls=PlotlyJSONEncoder)
    assert json.dumps(HOSTILE)[1:-1] in shown  # its name is there
    assert "DangerouslySetInnerHTML" not in shown and "dangerously_allow_html" not in shown
    source = "".join(path.read_text() for path in Path(data.__file__).parent.parent.rglob("*.py"))
    assert "dangerously_allow_html" not in source and "DangerouslySetInnerHTML" not in source
