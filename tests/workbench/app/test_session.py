"""Sessions and what they know, without a browser."""

import io
import json
import os
import shlex
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from dash import dcc, html

from estimators import add
from estimators.data.matches import find_matches
from estimators.signals.residual import AXES
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model
from pendulum_env.recording import Recording, RecordingError, Source, write_recording
from pendulum_env.recording.study import read_sources
from pendulum_env.settings import use_writer
from tests import slow
from tests.cases import diagnosed
from tests.estimators.diagnosis.test_experiment import first as wagged
from tests.notes import list_notes
from tests.patience import PATIENCE
from tests.workbench.app.plants import (
    assert_same_export,
    drop,
    encode_url,
    fit_state,
    loaded,
    record_pendulum,
    reload_session,
    upload,
    write_source,
)
from workbench.app import demo
from workbench.app.card import ColumnCard, ColumnChoice, describe_unit, write_choice
from workbench.app.downloads import make_file, write_commands, write_study_text
from workbench.app.jobs import Job, Workers
from workbench.app.page.server import make_app
from workbench.app.panels import describe_state, show_timing
from workbench.app.session import Session, Sessions
from workbench.app.stages import add as add_stage
from workbench.app.stages import data, diagnose, export, model
from workbench.app.state import FITTING, NO_CHOICES, SearchChoices, State
from workbench.app.uploads import clean_name, unpack
from workbench.cli import main
from workbench.errors import InputError
from workbench.narrator.diagnosis import write_diagnosis
from workbench.report.data import ReportData
from workbench.report.matches import make_rivals
from workbench.report.numbers import make_parameters
from workbench.report.story import make_story

IDS = ["0" * 32, "1" * 32]
HOSTILE = ["../../etc/passwd.csv", "..\\..\\run.csv", "C:run.csv", "..", "", "a\0b.csv", "x" * 5000 + ".csv.gz"]


@pytest.fixture(scope="module")
def swing() -> Recording:
    return record_pendulum("swing", 1, 10.0)


@pytest.fixture(scope="module")
def state(swing: Recording) -> State:
    """A session's that looks for two effects alone."""
    return fit_state(State((loaded(swing),), choices=SearchChoices(only="stribeck,quadratic_drag")))


# ------------------------------------------------------------------------------------------------ files


@pytest.mark.parametrize("name", HOSTILE)
def test_an_upload_lies_in_its_folder_whatever_its_name(tmp_path, name):
    file = unpack(tmp_path, name, encode_url(b"x"))
    assert file.resolve().parent == tmp_path.resolve() and file.read_bytes() == b"x"
    assert len(file.name.encode()) < 200 and file.name.isprintable()
    assert clean_name("Montag früh (1).csv.gz") == "Montag früh (1).csv.gz"


def test_an_upload_that_is_damaged_is_refused(session):
    session.run_action(lambda: session.load_uploads([("run.csv", "data:text/csv;base64,!!!!")], unwrap=False))
    assert "did not arrive whole" in session.notice and session.state.loaded == ()


def test_of_several_files_those_that_can_be_read_stay(session, swing, tmp_path):
    good = write_source(replace(swing, name="good"), tmp_path).file.read_bytes()
    files = [
        (name, encode_url(content)) for name, content in (("good.csv", good), ("bad.csv", b"1,2,3"), ("worse.txt", b""))
    ]
    session.run_action(lambda: session.load_uploads([*files, files[0]], unwrap=False))
    assert [one.id for one in session.state.loaded] == ["good.csv"]
    assert all(f"{name}: " in session.notice for name in ("bad.csv", "worse.txt", "good.csv"))
    assert session.notice.count("; ") == 2 and str(session.folder) not in session.notice


def test_the_page_says_where_it_undoes_jumps(session, swing, tmp_path):
    content = write_source(replace(swing, position=np.mod(swing.position, 2 * np.pi)), tmp_path).file.read_bytes()
    for unwrap in ([], ["unwrap"]):
        files = [("swing.csv", encode_url(content))]
        session.run_action(lambda files=files, unwrap=unwrap: session.load_uploads(files, bool(unwrap)))
        assert len(session.state.loaded) == len(unwrap) and ("unwrap" in session.notice) != bool(unwrap)
    session.run_action(lambda: session.hold_out("swing.csv", True))
    assert session.state.steps == () and "every recording is held out" in session.state.failure_reason


def servo(swing: Recording) -> bytes:
    """The same swing as a servo with a gearbox logs it: angle of the motor, its current, time in ms."""
    rows = zip(1e3 * swing.time, np.degrees(-6 * swing.position), swing.torque / 0.091, strict=True)
    text = "".join(f"{t:.9g},{q:.12g},run,{i:.12g}\n" for t, q, i in rows)
    return f"clock,motor angle,mode,current\n{text}".encode()


SERVO = [
    ColumnChoice("time", "ms"),
    ColumnChoice("position", "deg", "*-1/6"),
    ColumnChoice(),
    ColumnChoice("torque", "A", "0.091"),
]


def test_what_is_said_of_one_file_holds_for_those_that_wait_with_the_same_columns(session, swing):
    other = b"t,q,q2,current\n" + b"".join(b"%d,%d,0,0\n" % (k, k) for k in range(200))
    for name, content in (("a.csv", servo(swing)), ("other.csv", other), ("b.csv", servo(swing))):
        upload(session, name, content)
    wrong = [*SERVO[:3], ColumnChoice("torque")]
    session.run_action(lambda: session.apply_card(session.cards[0].set_choices(wrong, False)))
    assert "'current' without a gain" in session.cards[0].error and len(session.cards) == 3 and not session.state.loaded
    session.run_action(lambda: session.apply_card(session.cards[0].set_choices(SERVO, False)))
    assert [one.id for one in session.state.loaded] == ["a.csv", "b.csv"]
    assert [card.source.file.name for card in session.cards] == ["other.csv"]


def test_columns_of_a_loaded_recording_can_be_named_anew(session, swing, tmp_path):
    file = write_source(replace(swing, velocity=np.gradient(swing.position, swing.time)), tmp_path).file
    upload(session, "swing.csv", file.read_bytes())
    session.run_action(lambda: session.open_card("swing.csv"))
    (card,) = session.cards
    roles = dict(zip(card.preview.headers, card.choices, strict=True))
    assert {name: choice.role for name, choice in roles.items()} == {name: name for name in roles} and card.error == ""
    roles |= {"velocity": ColumnChoice(), "torque": ColumnChoice("torque", "", "*2")}
    asked = card.set_choices([roles[name] for name in card.preview.headers], False)
    session.run_action(lambda: session.apply_card(asked))
    (one,) = session.state.loaded
    assert one.recording.velocity is None
    np.testing.assert_allclose(one.recording.torque, 2 * swing.torque, atol=1e-9)


@pytest.mark.parametrize(
    ("role", "text", "said"),
    [
        ("position", "phi [deg]:rev", "rev (named)"),
        ("time", "clock", "s (assumed)"),
        ("torque", "iq", "not clear yet"),  # a current is no torque
        ("torque", "iq*0.091", "N m (after gain)"),
    ],
)
def test_the_card_says_in_which_unit_a_column_is_understood(role, text, said):
    assert describe_unit(role, text, ("clock", "phi [deg]", "w_rpm", "iq")) == said


def test_an_end_waits_for_no_answer_that_takes_long():
    sessions, held, let_go = Sessions(), Event(), Event()
    session = sessions.find_session("0" * 32)

    def answer() -> None:
        session.run_action(lambda: (held.set(), let_go.wait(PATIENCE)))

    answering, closing = Thread(target=answer), Thread(target=sessions.close)
    answering.start()
    assert held.wait(PATIENCE)
    closing.start()
    closing.join(PATIENCE / 3)
    assert not closing.is_alive()
    let_go.set()
    answering.join()


def test_work_goes_on_from_the_study_the_model_and_the_recordings_that_were_saved(session, swing, tmp_path):
    upload(session, "run.csv", servo(swing))
    session.run_action(lambda: session.apply_card(session.cards[0].set_choices(SERVO, False)))
    turned = replace(swing, name="check", position=np.mod(swing.position, 2 * np.pi))
    held_out = replace(write_source(turned, tmp_path, held_out=True), unwrap=True)
    session.run_action(lambda: session.load([held_out]))
    state = session.state
    state = state.add_step(add(state.model, "stribeck", state.data.recordings, state.data.holdout))
    again = reload_session(state, tmp_path / "again")
    assert again.notice == "" and not again.cards and write_study_text(again.state) == write_study_text(state)
    for old, new in zip(state.loaded, again.state.loaded, strict=True):
        assert new.id == old.id and new.held_out == old.held_out
        assert new.recording.torque_unit == old.recording.torque_unit
        for name in ("time", "position", "torque"):
            np.testing.assert_array_equal(getattr(new.recording, name), getattr(old.recording, name))
    assert again.state.model.effects == ("stribeck",)
    assert again.state.model.theta == pytest.approx(state.model.theta, rel=1e-3)
    assert again.last_change == "start from model.json"
    again.run_action(again.undo)
    assert again.state.model.effects == () and len(again.state.loaded) == 2
    upload(alone := Session(tmp_path / "alone"), "study.toml", write_study_text(state).encode())
    assert "drop both here together" in alone.notice and alone.state.loaded == ()


def test_a_study_may_use_several_ranges_of_a_file(session, swing, tmp_path):
    parts = (("fit", 0, 6), ("holdout", 6, 9))
    text = "".join(f'[[recording]]\nfile="runs/swing.csv"\nrole="{role}"\nrange=[{a},{b}]\n' for role, a, b in parts)
    contents = {"swing.csv": write_source(swing, tmp_path).file.read_bytes(), "study.toml": text.encode()}
    files = [(name, encode_url(content)) for name, content in contents.items()]
    session.run_action(lambda: session.load_uploads(files, unwrap=False))
    assert session.notice == "" and [one.held_out for one in session.state.loaded] == [False, True]
    assert [one.id for one in session.state.loaded] == ["swing.csv", "swing.csv (2)"]
    assert sum(one.recording.duration for one in session.state.loaded) == pytest.approx(9.0, abs=0.01)
    (tmp_path / "study.toml").write_text(write_study_text(session.state))
    assert [source.range for source in read_sources(tmp_path / "study.toml")] == [(0, 6), (6, 9)]
    upload(session, "study.toml", b"[[recording]]")
    assert session.notice.startswith("study.toml: 'recording[0]': Object missing required field file")


def test_what_a_session_begins_with_is_read_as_the_user_asked_and_left_where_it_is(swing, tmp_path):
    source = write_source(swing, tmp_path)
    source.file.write_text(source.file.read_text().replace("position", "Spalte"))
    sessions = Sessions([replace(source, columns={"position": "Spalte"})])
    session = sessions.find_session(IDS[0])
    np.testing.assert_allclose(session.state.loaded[0].recording.position, swing.position)
    session.run_action(lambda: session.remove("swing.csv"))
    assert session.state.loaded == () and source.file.exists()
    sessions.close()
    sessions = Sessions([source])  # it is asked about where columns are not clear
    session = sessions.find_session(IDS[0])
    assert session.notice == "" and session.state.loaded == () and "Spalte" in session.cards[0].preview.headers
    sessions.close()


@pytest.fixture(scope="module")
def late() -> Recording:
    """Nothing hidden, but for torque that was logged 8 ms late."""
    rng = np.random.default_rng(3)
    good = record(None, excitation("paper", rng, 10.0), 10.0, 500.0, rng=rng, name="late")
    return replace(good, torque=np.r_[np.zeros(4), good.torque[:-4]])


def test_torque_that_is_logged_late_is_said_and_corrected_for_all_that_follows(session, late):
    session.state = fit_state(State((loaded(late),)))
    said = str(show_timing(session))
    assert "The torque is logged " in said and "ms late" in said and "'do': 'align'" in said
    before = session.state
    session.run_action(lambda: data.ACTIONS["align"](session, "", {}))
    after = session.state
    assert "corrected in all that follows" in str(show_timing(session))
    errors = [one.steps[-1].errors["holdout"].torque_rms for one in (before, after)]
    assert errors[1] < 1.15 * after.result.floors[""] < 0.5 * errors[0]
    session.run_action(lambda: session.add_recordings(loaded(replace(late, name="again"), held_out=True)))
    assert session.state.is_aligned and all("aligned: " in list_notes(one)[-1] for one in session.state.recordings)


# ------------------------------------------------------------------------------------------------ sessions


def test_nothing_is_done_while_a_job_works_on_the_state(session):
    class Slow:
        running = True

    session.job = Slow()  # type: ignore[assignment]
    upload(session, "run.csv", b"")
    assert session.notice == "wait for what is running, or cancel it first"
    assert session.state.loaded == ()


@pytest.mark.parametrize("id", [None, "../../etc", "0" * 31, "0" * 33, "A" * 32, {"a": 1}])
def test_only_ids_open_sessions(id):
    sessions = Sessions()
    with pytest.raises(InputError, match="load it again"):
        sessions.find_session(id)
    sessions.close()


def test_only_this_computer_is_answered():
    app, sessions = make_app()
    client = app.server.test_client()
    assert client.get("/").status_code == 200
    assert client.get("/", headers={"Host": "localhost:8050"}).status_code == 200
    assert client.get("/", headers={"Host": "rebound.example"}).status_code == 403
    for origin in ("https://other.example", "http://localhost:8051", "https://localhost:8050", "null"):
        foreign = {"Host": "localhost:8050", "Origin": origin}
        assert client.post("/_dash-update-component", headers=foreign).status_code == 403
    assert client.get("/", headers={"Host": "localhost:8050", "Origin": "http://localhost:8050"}).status_code == 200
    page = client.get("/")
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    assert "https://" not in page.text and "http://" not in page.text.replace("http://www.w3.org", "")
    assert client.get("/assets/../server.py").status_code == 404
    assert client.get("/assets/%2e%2e/server.py").status_code == 404
    sessions.close()


# ------------------------------------------------------------------------------------------------ states


def test_the_report_tells_the_diagnosis_until_the_ladder_has_all_that_it_calls_for(state, worked):
    assert state.result.candidates == () and state.result.unexplained
    grown = worked["paper"]
    diagnosed = state.add_diagnosis(grown.diagnosis)
    assert diagnosed.model.theta == pytest.approx(state.model.theta, rel=1e-9)
    assert diagnosed.result.selected == diagnosed.suggested_additions == ("stribeck",)
    assert grown.suggested_additions == () and grown.result.steps == grown.steps and not grown.result.unexplained
    recordings = state.data.recordings
    other = grown.add_step(add(grown.model, "quadratic_drag", recordings))  # which the diagnosis does not call for
    assert other.suggested_additions == () and other.result.selected == ("stribeck", "quadratic_drag")
    own = diagnosed.add_step(add(diagnosed.model, "quadratic_drag", recordings))  # in the place of what it calls for
    assert own.suggested_additions == own.result.selected == ("stribeck",)


def test_an_effect_added_by_hand_has_the_verdict_of_the_diagnosis_not_its_name_and_numbers(state, worked):
    """A rejected effect in the place of the one that the diagnosis calls for, beside it, and without a diagnosis."""
    diagnosis, recordings = worked["paper"].diagnosis, state.data.recordings
    drag = add(state.model, "quadratic_drag", recordings)
    own = state.add_diagnosis(diagnosis).add_step(drag)
    _, title, lead = describe_state(own)
    assert title.startswith("Stribeck friction is missing; the diagnosis does not confirm quadratic drag")
    found = [diagnosis.steps[-1].errors["holdout"].torque_rms, drag.after.errors["holdout"].torque_rms]
    by_hand, _, called_for = lead.partition("With Stribeck friction instead: ")
    assert [f"{error:.4g}" in text for text in (called_for, by_hand) for error in found] == [True, False, False, True]
    report = make_file(own, "report")[1].decode()
    assert "Stribeck friction is missing" in report and "Quadratic drag is missing" not in report
    beside = worked["paper"].add_step(add(worked["paper"].model, "quadratic_drag", recordings))
    assert "does not confirm quadratic drag" in describe_state(beside)[1]
    title = make_story(ReportData(beside.result)).title
    assert title.startswith("Stribeck friction is missing") and "does not confirm quadratic drag" in title
    assert "Why Stribeck friction" == make_rivals(ReportData(beside.result)).title
    unsearched = state.add_step(drag)
    assert "missing" not in describe_state(unsearched)[1] + make_story(ReportData(unsearched.result)).title


def test_estimates_of_a_model_that_lacks_an_effect_are_told_as_biased(worked):
    rows = make_parameters(worked["paper"].report_data).content[1].rows
    assert all("biased" in base and "biased" not in final for _, base, final, _ in rows if base)


@pytest.fixture(scope="module")
def worked(state: State) -> dict[str, State]:
    """States with a diagnosis and its effect added: from the paper's terms, and from a model file with one more."""
    drag = add(state.model, "quadratic_drag", state.data.recordings).after.model
    begun = fit_state(state.restart(terms=drag.terms, model_file="start.json"))
    states = {}
    for name, one in (("paper", state), ("file", begun)):
        named = one.add_diagnosis(diagnosed(one.data.recordings, base=one.base_terms, **one.choices.effects))
        states[name] = named.add_step(add(one.model, "stribeck", one.data.recordings))
    return states


@pytest.mark.parametrize("begun", slow.but_first(["file", "paper"]))
def test_the_command_line_assert_same_export_model(worked, begun, tmp_path, monkeypatch):
    state = worked[begun]
    write_source(state.data.recordings[0], tmp_path)
    state.steps[0].model.save(tmp_path / "start.json")
    monkeypatch.chdir(tmp_path)
    assert {"stribeck"} <= set(state.model.effects)
    assert_same_export(state)
    assert "Stribeck friction is missing" in Path("report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("held_out", [False, True])
def test_where_identify_fits_more_than_the_workbench_the_page_says_so(session, swing, tmp_path, monkeypatch, held_out):
    recordings = [swing, record_pendulum("check", 2, 4.0)][: 1 + held_out]
    for recording in recordings:
        write_source(recording, tmp_path)
    session.state = fit_state(State(tuple(loaded(one, held_out=one is not swing) for one in recordings)))
    monkeypatch.chdir(tmp_path)
    (line,) = write_commands(session.state).splitlines()
    assert main(shlex.split(line)[1:]) == 0
    agrees = Model.load("model.json").theta == pytest.approx(session.state.model.theta, rel=1e-6)
    assert agrees == held_out
    assert (export.FIT_NOTE in str(export.show(session))) == (not agrees)


def test_with_columns_and_late_torque_a_study_and_align_come_to_the_same_model(session, late, tmp_path, monkeypatch):
    for file, part in zip(("run.csv", "check.csv"), late.split(0.6), strict=True):
        upload(session, file, servo(part))
        session.run_action(lambda: session.apply_card(session.cards[0].set_choices(SERVO, False)))
        (tmp_path / file).write_bytes(servo(part))
    session.run_action(lambda: session.hold_out("check.csv", True))
    session.run_action(lambda: data.ACTIONS["align"](session, "", {}))
    (tmp_path / "study.toml").write_text(write_study_text(session.state))
    monkeypatch.chdir(tmp_path)
    assert write_commands(session.state) == "pendulum-ident identify study.toml --align -o model.json"
    assert export.STUDY_NOTE in str(export.show(session))
    assert_same_export(session.state)


# ------------------------------------------------------------------------------------------------ stages


def test_the_residual_is_drawn_with_the_effects_that_look_most_like_it(session, state):
    session.state = state
    page = html.Div([*model.show_comparison(session), model.show_matches(session)])
    markup = "".join(one.data for one in page._traverse() if isinstance(one, dcc.Store))
    ids = *(f"profile-{axis}" for axis in AXES), *(f"match-{axis}" for axis in AXES), "course-0"
    assert all(f'id="{id}"' in markup for id in ids)
    tries = [one.id["of"] for one in page._traverse() if isinstance(one, html.Button)]
    assert tries[0] == "stribeck" and len(tries) == 3
    case = session.state.report_data
    matches = find_matches(case.parts[0][-1], case.diagnosis.model)[:3]
    assert [match.effect for match in matches] == tries and matches[0].share > 0.8
    assert all(1 >= a.share >= b.share >= 0 for a, b in pairwise(matches))


def test_an_experiment_that_is_suggested_is_saved(session, tmp_path):
    with pytest.raises(InputError, match="the diagnosis suggests no experiment"):
        make_file(session.state, "experiment")
    wagging, found = wagged("a spring at small angles")
    session.run_action(lambda: session.load([write_source(wagging, tmp_path)]))
    session.state = session.state.add_diagnosis(found)
    rows = np.loadtxt(io.BytesIO(make_file(session.state, "experiment")[1]), delimiter=",", skiprows=1)
    assert rows.shape[1] == 2 and np.abs(rows[:, 1]).max() > 1.0


@pytest.mark.parametrize("turn", [1, -1])
def test_names_decide_on_roles_and_the_order_of_an_upload_does_not_matter(tmp_path, turn):
    for name, seed in (("a.train", 1), ("a.holdout", 2), ("latest", 3), ("my_Test", 4), ("validation", 5)):
        write_recording(record_pendulum(name, seed, 3.0, rate=250.0), tmp_path / f"{name}.csv")
    session = Session(tmp_path / "session")
    drop(session, *sorted(tmp_path.glob("*.csv"))[::turn])
    roles = [(item.recording.name, item.held_out) for item in session.state.loaded]
    assert roles == [
        ("a.holdout", True),
        ("a.train", False),
        ("latest", False),
        ("my_Test", True),
        ("validation", True),
    ]
    session.run_action(lambda: session.hold_out("my_Test.csv", False))
    assert not session.state.find("my_Test.csv").held_out
    alone = Session(tmp_path / "alone")
    drop(alone, tmp_path / "a.holdout.csv")
    assert not alone.state.loaded[0].held_out  # something must be fitted
    drop(alone, tmp_path / "a.train.csv")
    assert [item.held_out for item in alone.state.loaded] == [True, False]  # until another is there
    alone.run_action(alone.undo)
    drop(alone, tmp_path / "a.train.csv")
    assert [item.held_out for item in alone.state.loaded] == [True, False]
    alone.run_action(lambda: alone.hold_out("a.holdout.csv", False))
    alone.run_action(lambda: alone.remove("a.train.csv"))
    drop(alone, tmp_path / "latest.csv")
    assert [item.held_out for item in alone.state.loaded] == [False, False]  # a role that the user gave stays
    fitted = Session(tmp_path / "fitted")
    fitted.run_action(lambda: fitted.load([Source(tmp_path / "my_Test.csv", "fit")]))
    drop(fitted, tmp_path / "latest.csv")
    assert [item.held_out for item in fitted.state.loaded] == [False, False]


@pytest.mark.parametrize("content", [b"hello world\nthis is text\n", b"time\n0\n1\n2\n", b"a,b\nx,y\nz,w\n"])
def test_a_text_without_columns_of_numbers_is_refused_without_words_of_the_command_line(session, content):
    upload(session, "notes.txt", content)
    assert session.notice.startswith("notes.txt: ") and not session.cards and not session.state.loaded
    assert "NAME" not in session.notice and "=none" not in session.notice and "--" not in session.notice


def test_binary_data_named_csv_are_refused_without_a_word_in_the_terminal(session, capfd):
    upload(session, "picture.csv", bytes(np.random.default_rng(0).integers(0, 256, 20_000, dtype=np.uint8)))
    assert session.notice and not session.cards and not session.state.loaded
    assert capfd.readouterr() == ("", "")


def test_a_model_has_one_held_out_error_though_an_addition_cuts_other_windows(state):
    addition = add(state.model, "stribeck", state.data.recordings, state.data.holdout)
    elsewhere = {part: replace(errors, torque_rms=9.0) for part, errors in addition.after.errors.items()}
    steps = (replace(step, errors=elsewhere) for step in (addition.before, addition.after))
    grown = state.add_step(replace(addition, **dict(zip(("before", "after"), steps, strict=True))))
    assert grown.steps[0] is state.steps[0]
    for part, errors in grown.steps[1].errors.items():
        assert errors.torque_rms == pytest.approx(addition.after.errors[part].torque_rms, rel=1e-9)


def test_a_free_swing_is_asked_about_and_a_card_can_say_that_nothing_drives_the_joint(tmp_path):
    time = np.arange(0.0, 4.0, 0.01)
    swing = np.column_stack([time, np.exp(-0.1 * time) * np.cos(5 * time), time % 0.7])
    plain, asked = tmp_path / "plain.csv", tmp_path / "asked.csv"
    np.savetxt(plain, swing[:, :2], delimiter=",", header="time,angle", comments="")
    np.savetxt(asked, swing, delimiter=",", header="time,angle,m1", comments="")
    (folder := tmp_path / "session").mkdir()
    session = Session(folder)
    session.load([Source(plain), Source(asked)])
    assert not session.state.loaded and [card.source.file for card in session.cards] == [plain, asked]
    chosen = {"role:0": "time", "role:1": "position"}
    session.apply_card(session.cards[0].fill_form(chosen))
    assert not session.state.loaded and "torque" in session.cards[0].error  # it is asked until somebody says so
    for _ in range(2):
        session.apply_card(session.cards[0].fill_form(chosen | {"free:0": ["free"]}))
    free, other = (item.recording for item in session.state.loaded)
    assert not session.cards and not free.torque.any() and not other.torque.any()
    assert any("free swing" in note for note in list_notes(free))
    (figure,) = data.plot_recording(free, 0, session.state.body)
    assert len(figure.data) == 1 and "yaxis2" not in figure.layout  # nothing to draw of a torque


def test_a_card_begins_with_what_is_said_of_its_columns_and_reads_as_they_do(tmp_path):
    time = np.arange(0.0, 4.0, 0.01)
    file = tmp_path / "run.csv"
    rows = np.column_stack([time, -6 * np.degrees(np.sin(time)) + 180, np.cos(time), np.cos(time)])
    np.savetxt(file, rows, delimiter=",", header="t,motor,i,speed", comments="")
    said = {"position": "-motor:deg/6+30:deg", "torque": "i:A*0.1", "velocity": "none"}
    card = ColumnCard.from_source(Source(file, columns=said))
    first, again = Source(file, columns=said).read(), card.make_source().read()
    np.testing.assert_allclose(again.position, first.position, rtol=1e-12)
    np.testing.assert_allclose(again.torque, first.torque, rtol=1e-12)
    assert again.velocity is None
    both = [replace(choice, role="time") if choice.role == "torque" else choice for choice in card.choices]
    with pytest.raises(RecordingError, match="columns 't' and 'i' are all to be time: choose one"):
        card.set_choices(both, False).make_source()


def test_a_card_knows_the_units_that_the_command_line_knows_and_speaks_of_its_own_choices(session, swing):
    turns = swing.position / (2 * np.pi)
    rows = zip(swing.time, 8 * turns, np.gradient(8 * turns, swing.time), swing.torque, strict=True)
    content = "t,pos_estimate,vel_estimate,Iq_measured\n" + "".join(f"{a},{b},{c},{d}\n" for a, b, c, d in rows)
    before = use_writer(write_choice)
    try:
        upload(session, "odrive.csv", content.encode())
        error = session.cards[0].error
        assert "--columns" not in error and "column Iq_measured as torque in A" in error
        headers = session.cards[0].preview.headers
        assert describe_unit("position", "pos_estimate/8", headers) == "rev (named)"
        choices = [
            ColumnChoice("time"),
            ColumnChoice("position", "", "/8"),
            ColumnChoice("velocity"),
            ColumnChoice("torque", "A", "1"),
        ]
        session.run_action(lambda: session.apply_card(session.cards[0].set_choices(choices, False)))
        assert "column vel_estimate as velocity in rev/s with /8" in session.cards[0].error
        choices[2] = ColumnChoice("velocity", "rev/s", "/8")
        session.run_action(lambda: session.apply_card(session.cards[0].set_choices(choices, False)))
    finally:
        use_writer(before)
    np.testing.assert_allclose(session.state.loaded[0].recording.position, swing.position, atol=1e-6)


ASKED = SearchChoices(
    only="stribeck,quadratic_drag,spring", without="spring", fix="gravity=2.01", bound="viscous=0:0.2"
)


@pytest.fixture
def asked(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session with `swing.csv`, which lies in the working directory as well."""
    monkeypatch.chdir(tmp_path)
    source = write_source(record_pendulum("swing", 1, 10.0), tmp_path)
    session.run_action(lambda: session.load([source]))
    return session


@pytest.fixture
def workers() -> Iterator[Workers]:
    workers = Workers()
    yield workers
    workers.close()


def test_a_worker_fits_the_latest_state_and_a_cancelled_fit_takes_the_change_back(workers, tmp_path):
    session = Session(tmp_path / "session", workers)

    def load(name: str, seed: int) -> None:
        session.run_action(lambda: session.load([write_source(record_pendulum(name, seed, 4.0), tmp_path)]))

    def wait() -> None:
        assert session.job is not None and session.job.over.wait(PATIENCE)

    load("swing", 1)
    assert session.state.failure_reason == FITTING and not session.is_busy()
    load("check", 2)  # ends the first fit
    assert session.state.steps == ()
    wait()
    assert not session.state.failure_reason and len(session.state.data.recordings) == 2
    both = session.state
    load("third", 3)
    session.cancel()
    assert session.state is both and session.job is None
    session.run_action(session.undo)
    wait()
    assert len(session.state.data.recordings) == 1 and session.notice == ""
    session.end()


def tell_process(_) -> int:
    """A task: the process that does it."""
    return os.getpid()


def test_a_process_whose_task_has_ended_does_the_next(workers):
    """Another one would load its libraries first, which takes seconds."""
    processes, ended = list[int](), Event()

    def end(job: Job) -> None:
        processes.append(job.result)
        if len(processes) == 1:  # as the fit that follows an action
            Job("next", tell_process, workers).call_at_end(end)
        else:
            ended.set()

    Job("first", tell_process, workers).call_at_end(end)
    assert ended.wait(PATIENCE) and len(set(processes)) == 1


def test_the_demo_is_two_recordings_that_the_command_line_makes_and_reads(session, tmp_path):
    session.run_action(lambda: demo.start(session))
    assert [item.held_out for item in session.state.loaded] == [False, True]
    for seed, item in enumerate(session.state.loaded, 1):
        command = f"record --seconds {item.recording.duration:.0f} --rate 500 --effect stribeck --seed {seed}"
        assert main([*command.split(), "-o", str(tmp_path / "made.csv")]) == 0
        made = Source(tmp_path / "made.csv").read()
        assert np.abs(made.position - item.recording.position).max() < 1e-5  # rounded
        assert item.held_out or str(item.source.file) in write_commands(session.state)
    session.run_action(lambda: demo.start(session))
    assert len(session.state.loaded) == 2 and "loaded already" in session.notice


@pytest.mark.slow
def test_what_is_asked_for_gives_what_the_command_line_gives(asked):
    for start in (lambda: diagnose.start(asked, ASKED), lambda: add_stage.start(asked, "stribeck")):
        asked.run_action(start)
        assert asked.notice == ""
    base = asked.state.steps[0].model.estimates["gravity"]
    assert (base.value, base.std) == (2.01, 0.0)  # from the first rung on
    found = asked.state.diagnosis
    assert found is not None and {one.effect for one in found.candidates} == {"stribeck", "quadratic_drag"}
    made = asked.state.model.estimates
    assert made["gravity"].value == 2.01 and made["viscous"].value <= 0.2
    assert_same_export(asked.state)
    assert json.loads(Path("diagnosis.json").read_text()) == json.loads(json.dumps(write_diagnosis(found)))


def test_the_ladder_begins_anew_where_other_values_are_known_and_only_there(asked):
    before = asked.state

    def choose(choices: SearchChoices) -> None:
        asked.run_action(lambda: diagnose.choose_search(asked, choices))

    choose(SearchChoices(only="stribeck"))
    assert asked.state.fit is before.fit
    choose(SearchChoices(bound="gravity=:1.5"))
    assert asked.state.model.estimates["gravity"].value == pytest.approx(1.5)
    choose(NO_CHOICES)
    assert asked.state.model.theta == pytest.approx(before.model.theta)


@pytest.mark.parametrize(
    ("field", "wrong"),
    slow.but_first([("only", "stribek"), ("without", "--fix"), ("fix", "gravty=2"), ("bound", "viscous=1:0")]),
)
def test_a_mistake_is_told_in_the_words_of_the_command_line(asked, field, wrong, run_refused):
    before = asked.state
    asked.run_action(lambda: diagnose.choose_search(asked, SearchChoices(**{field: wrong})))
    assert asked.state is before and asked.job is None
    mistake = asked.notice.partition(" Known: ")[0]  # the terminal shortens a long list
    assert mistake != "" and mistake in run_refused("diagnose", "swing.csv", f"--{field}={wrong}")


def test_fields_of_the_form_become_options():
    form = {"ask-only": ["stribeck", "cogging"], "ask-without": None, "ask-fix": " gravity=2 ", "ask-bound": ""}
    assert SearchChoices.from_form(form) == SearchChoices("stribeck,cogging", "", "gravity=2")
