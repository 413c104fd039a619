"""Surveys: what is done once, what goes wrong, what is found, and the page."""

import argparse
import errno
import json
import os
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimators import diagnose
from pendulum_env.recording import RecordingError, read_recording, write_recording
from tests import slow
from tests.patience import PATIENCE, wait_until
from tests.workbench.pages import Page, values, whole
from workbench.cli import main
from workbench.commands.survey import configure
from workbench.mistakes import InputError
from workbench.survey import Dataset, Fleet, find_cases, survey, work
from workbench.survey import dataset as stored
from workbench.survey.fleet import Joint
from workbench.survey.page import headline, write_fleet_report
from workbench.survey.tables import tables

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")  # comes with it

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
USUAL = {"inertia": (0.09, 1e-4, "kg m^2"), "coulomb": (0.9, 2e-3, "N m")}


def stub(case, settings):
    """Findings that stand in the file itself; with what a worker meets, if the file says so."""
    text = case.source.file.read_text()
    if text.startswith("corrupt"):
        raise RecordingError(f"{case.source.file}: it is damaged: export it again")
    if text.startswith("full"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if text.startswith("fault"):
        raise ZeroDivisionError("nobody thought of this")
    if text.startswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    told = json.loads(text) if text.startswith("{") else {}
    theta = {name: (told.get(name, value), std, unit) for name, (value, std, unit) in USUAL.items()}
    effects = told.get("effects", [])
    gains = {**dict.fromkeys(("stribeck", "cogging"), -1.0), **told.get("gains", {})}
    return dict(
        verdict="missing" if effects else "nothing",
        headline="Something" if effects else "Nothing is missing",
        score=0.9 if effects else None,
        selected=effects,
        ambiguous=[],
        candidates=[
            {"effect": id, "verdict": "selected" if id in effects else "rejected", "score": 0.1, "gain": gain,
             "gain_error": 2.0, "variants": 2}
            for id, gain in gains.items()
        ],
        parameters=[{"name": n, "value": v, "std": s, "unit": u} for n, (v, s, u) in theta.items()],
        torque_unit="N m", noise_floor=0.01, torque_rms=0.01, position_rms=1e-3, samples=100, duration=1.0,
        diagnosis="{}",
    )  # fmt: skip


def cases(*names, options=()):
    parser = argparse.ArgumentParser()
    configure(parser)
    arguments = parser.parse_args([*map(str, names), "-o", "-", *options])
    return find_cases([str(name) for name in names], arguments, arguments.names)


def write(folder, joint, week, **told):
    robot, _, name = joint.rpartition("/")
    path = folder / robot / name / f"{BEGAN + timedelta(weeks=week):%Y-%m-%d}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(told))
    return path


@pytest.fixture(scope="module")
def client():
    with distributed.Client(
        processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0", protocol="tcp://"
    ) as client:
        yield client


@pytest.fixture
def folder(tmp_path):
    """Recordings of two joints, three weeks each."""
    for joint in ("arm/elbow", "arm/wrist"):
        for week in range(3):
            write(tmp_path / "data", joint, week, coulomb=0.9 + 0.001 * week)
    return tmp_path / "data"


def result(dataset):
    """All of a dataset but what a clock or a process tells."""
    rows = dataset.rows()
    return [{k: v for k, v in row.items() if k not in ("seconds", "finished")} for row in rows]


def test_a_survey_that_was_broken_off_goes_on_to_the_same_result(folder, tmp_path, client):
    whole, broken = Dataset(tmp_path / "whole"), Dataset(tmp_path / "broken")
    survey(cases(folder), whole, client, look=stub)

    def stop(tally):
        if tally.through == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        survey(cases(folder), broken, client, look=stub, tell=stop)
    kept = len(broken.rows(["name"]))
    assert kept >= 2
    (broken.folder / "cases" / ".torn.parquet.part").write_bytes(b"PAR1")  # what a kill -9 may leave
    tally = survey(cases(folder), broken, client, look=stub)
    assert (tally.new["done"], tally.known.total()) == (6 - kept, kept)
    assert result(broken) == result(whole)


def test_a_second_run_does_what_is_new_changed_or_asked_otherwise(folder, tmp_path, client, monkeypatch):
    dataset = Dataset(tmp_path / "out")
    survey(cases(folder), dataset, client, look=stub)
    assert survey(cases(folder), dataset, client, look=stub).known["done"] == 6
    for week in (3, 4):
        write(folder, "arm/elbow", week)
    assert survey(cases(folder), dataset, client, look=stub).new["done"] == 2
    changed = write(folder, "arm/wrist", 0, coulomb=1.2)
    tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.known.total()) == (1, 7)
    os.utime(changed, (0, 0))  # touched, and the same inside: it is read once more, and not diagnosed
    tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.known.total()) == (0, 8)
    assert survey(cases(folder, options=["--unwrap"]), dataset, client, look=stub).new["done"] == 8
    monkeypatch.setattr(work, "version", lambda: "99")  # as a newer program sees the rows of this one
    assert survey(cases(folder, options=["--unwrap"]), dataset, client, look=stub).new["done"] == 8
    assert len(dataset.rows(["name"])) == 8


def many(folder, count):
    """A dataset of so many files, in which five of seven cases each are looked at once more."""
    dataset = Dataset(folder)
    dataset.create()
    for k in range(count):
        when = BEGAN + timedelta(seconds=k)
        dataset.append([
            {"name": f"case{(k + j) % 7}", "reason": str(k), "status": "refused", "date": BEGAN, "finished": when}
            for j in range(5)
        ])  # fmt: skip
    return dataset


def test_many_files_become_one_with_the_last_row_of_each_case(tmp_path):
    dataset = many(tmp_path, stored.FILES + 1)
    before = dataset.rows()
    dataset.merge()
    assert len(dataset.parts) == 1 and dataset.rows() == before
    assert [row["name"] for row in before] == [f"case{k}" for k in range(7)]
    assert pq.read_metadata(dataset.parts[0]).num_rows == 7  # what is past has gone
    assert {row["reason"] for row in before} == {str(stored.FILES - 2), str(stored.FILES - 1), str(stored.FILES)}


def test_a_dataset_that_is_merged_while_it_is_read_loses_no_row(tmp_path, monkeypatch):
    dataset, read = many(tmp_path, stored.FILES + 1), stored._read
    before = dataset.rows(["name", "reason"])

    def merged_before(path, columns):
        monkeypatch.setattr(stored, "_read", read)
        dataset.merge()
        return read(path, columns)

    monkeypatch.setattr(stored, "_read", merged_before)
    assert dataset.rows(["name", "reason"]) == before and len(dataset.parts) == 1


def test_files_stay_where_the_disk_has_no_room_for_their_merging_and_one_that_is_damaged_does(tmp_path, monkeypatch):
    dataset = many(tmp_path, stored.FILES + 1)
    damaged, *others = dataset.parts
    damaged.write_bytes(b"PAR1")
    with monkeypatch.context() as patch:
        patch.setattr(Dataset, "_write", full)
        dataset.merge()
    assert dataset.parts == [damaged, *others]
    dataset.merge()
    assert damaged in dataset.parts and len(dataset.parts) == 2


def full(self, table):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_that_no_survey_wrote_is_one_row_that_says_so(folder, tmp_path, client):
    dataset = Dataset(tmp_path / "out")
    survey(cases(folder), dataset, client, look=stub)
    parts = dataset.folder / "cases"
    (parts / "torn.parquet").write_bytes(b"PAR1")
    pq.write_table(pa.table({"a": [1]}), parts / "other.parquet")
    own = next(row for row in dataset.rows() if row["status"] == "done")
    pq.write_table(pa.Table.from_pylist([own | {"date": 2**60}]), parts / "late.parquet")  # [us]
    os.mkfifo(parts / "pipe.parquet")  # which reading would wait for
    bombs = {"rows": (2_000_000, "x"), "texts": (4_000, "x" * 1_000_000)}  # 4 GB in 100 kB
    for name, (count, text) in bombs.items():
        column = pa.DictionaryArray.from_arrays(np.zeros(count, np.int32), [text])
        bomb = {field.name: pa.nulls(count, field.type) for field in stored.SCHEMA} | {"name": column}
        pq.write_table(pa.table(bomb), parts / f"{name}.parquet", compression="zstd")
        assert (parts / f"{name}.parquet").stat().st_size < 200_000
    strange = (
        *({"date": None}, {"status": "weird"}, {"verdict": "weird"}, {"selected": None}, {"report": "a\0b"}),
        *({"parameters": [None]}, {"candidates": [{"effect": None, "verdict": "selected"}]}),
        {"candidates": [{"effect": "spring", "verdict": "rejected", "gain": 1.0, "gain_error": 1.0, "variants": -1}]},
    )
    dataset.append({**own, **one, "name": f"cases/{k}"} for k, one in enumerate(strange))
    absurd = [{"name": "inertia", "value": 1e308, "std": 1e-308, "unit": ""}]
    bare = dict.fromkeys(("headline", "robot", "joint", "kind", "torque_rms"))
    dataset.append([{**own, **bare, "name": "bare", "parameters": absurd}])
    spoilt = [row["reason"] for row in dataset.rows() if row["name"].startswith("cases/")]
    assert spoilt == [stored.SPOILT] * 14
    assert survey(cases(folder), dataset, client, look=stub).known["done"] == 6
    write_fleet_report(tmp_path / "fleet.html", Fleet.of(dataset))
    assert Page((tmp_path / "fleet.html").read_text()).text.count("it is damaged, or no survey wrote it") == 14


def test_what_goes_wrong_with_one_case_is_marked_and_costs_no_other(folder, tmp_path, client):
    elbow = folder / "arm" / "elbow"
    for name, text in (("2026-01-05", "corrupt"), ("2026-01-12", "full"), ("2026-01-19", "fault")):
        (elbow / f"{name}.csv").write_text(text)
    dataset = Dataset(tmp_path / "out")
    tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.new["refused"], tally.new["failed"]) == (3, 1, 2)
    rows = {row["name"]: row for row in dataset.rows(["name", "status", "reason"])}
    assert rows["arm/elbow/2026-01-05.csv"]["status"] == "refused"
    assert rows["arm/elbow/2026-01-05.csv"]["reason"] == "it is damaged: export it again"
    assert "No space left" in rows["arm/elbow/2026-01-12.csv"]["reason"]
    assert "ZeroDivisionError: nobody thought of this" in rows["arm/elbow/2026-01-19.csv"]["reason"]
    (elbow / "2026-01-12.csv").unlink()
    write(folder, "arm/elbow", 1)
    again = survey(cases(folder), dataset, client, look=stub)
    assert (again.new["done"], again.new["failed"], again.known.total()) == (
        1,
        1,
        4,
    )  # what the file cannot mend is tried again
    assert [name for name, _ in again.troubles] == ["arm/elbow/2026-01-05.csv", "arm/elbow/2026-01-19.csv"]


def test_a_full_disk_ends_the_survey_and_what_was_written_stays(folder, tmp_path, client, monkeypatch):
    dataset, some = Dataset(tmp_path / "out"), cases(folder)[:3]
    survey(some, dataset, client, look=stub)
    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left on device"):
        patch.setattr(Dataset, "_write", full)
        survey(cases(folder), dataset, client, look=stub)
    tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.known.total()) == (3, 3)


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_its_case_at_most(folder, tmp_path):
    (folder / "arm/elbow/2026-01-05.csv").write_text("deadly")
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),  # Dask tries no second time: quicker
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        dataset = Dataset(tmp_path / "out")
        tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.new["failed"]) == (5, 1)
    (name, reason) = tally.troubles[0]
    assert name == "arm/elbow/2026-01-05.csv" and reason.startswith("its worker died")


def fleet_of(folder, client, told):
    """Fleet of 6 arms with 2 joints each, 12 weeks; `told` gives what stands in a file beyond the usual scatter."""
    rng = np.random.default_rng(0)
    for arm in range(6):
        for joint in ("elbow", "wrist"):
            own = rng.normal(0, 0.01)  # no two joints are alike
            for week in range(12):
                gains = {id: rng.normal(-1.0, 1.5) for id in ("stribeck", "cogging")}
                usual = {"coulomb": 0.9 + own + rng.normal(0, 0.004), "inertia": 0.09 + rng.normal(0, 1e-4)}
                write(folder / "data", f"arm{arm}/{joint}", week, **told(arm, joint, week, usual, gains))
    dataset = Dataset(folder / "out")
    survey(cases(folder / "data"), dataset, client, look=stub)
    return Fleet.of(dataset)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory, client):
    """One drifts, one jumps, one is odd, one gets an effect half-way, and all elbows have a weak one."""

    def told(arm, joint, week, usual, gains):
        usual["coulomb"] += 0.004 * week * (arm == 1 and joint == "elbow")
        usual["inertia"] += 0.02 * (arm == 2 and joint == "wrist")
        usual["inertia"] += 0.003 * (arm == 4 and joint == "elbow" and week >= 8)
        lost = arm == 3 and joint == "wrist" and week >= 6
        gains["cogging"] += 4.0 * (joint == "elbow")
        return {**usual, "gains": gains, "effects": ["stribeck"] if lost else []}

    return fleet_of(tmp_path_factory.mktemp("fleet"), client, told)


def test_drifts_onsets_odd_ones_and_what_all_share_are_found_and_nothing_else(fleet):
    told = {name: table.rows for name, table in tables(fleet).items()}
    assert [row[:2] for row in told["drifting"]] == [("arm1 / elbow", "coulomb")]
    assert [row[:3] for row in told["jumping"]] == [("arm4 / elbow", "inertia", "2026-03-02")]
    assert told["missing"] == [("arm3 / wrist", "stribeck", "6 of 12", "since 2026-02-16", "")]
    assert {row[:2] for row in told["odd"]} == {("arm2 / wrist", "inertia")}
    assert ("all elbow", "cogging") in {row[:2] for row in told["shared"]}
    assert {row[1] for row in told["shared"]} == {"cogging"}
    assert not {row[0] for row in told["shared"]} & {"all wrist", "arm0 / wrist"}


def test_the_page_says_what_was_found_and_loads_nothing(fleet, tmp_path):
    write_fleet_report(tmp_path / "fleet.html", fleet)
    found = whole((tmp_path / "fleet.html").read_text(), links_elsewhere=True)
    headline = "1 of 12 joints drifts, 1 has jumped, 1 differs from its siblings and Stribeck friction is missing in 1"
    assert headline in found.text
    assert "since 2026-02-16" in found.text and "Cogging torque" in found.text
    drawn = next(figure for figure in found.figures if "coulomb" in figure["layout"]["yaxis"]["title"]["text"])
    assert sum(trace.get("showlegend", False) for trace in drawn["data"]) == 1
    assert sum(tag == "tr" for tag, _ in found.tags) > 144


@pytest.mark.slow
def test_a_fleet_in_which_nothing_happens_shows_nothing(tmp_path, client):
    fleet = fleet_of(tmp_path, client, lambda arm, joint, week, usual, gains: {**usual, "gains": gains})
    assert not (fleet.drifting or fleet.jumping or fleet.effects or fleet.odd or fleet.shared)
    assert len(fleet.joints) == 12 and all(row["status"] == "done" for row in fleet.rows)


# ------------------------------------------------------------------------------------------------- names and tables


def test_paths_tell_robot_joint_and_date(tmp_path):
    for name in ("arm1/elbow/2026-03-01.csv", "arm1/2026-03-02/wrist.csv", "arm2/wrist/run_20260303T1405.npz", "x.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = {case.name: (case.robot, case.joint, f"{case.date:%m-%d %H:%M}", case.dated_by) for case in cases(tmp_path)}
    assert found["arm1/elbow/2026-03-01.csv"] == ("arm1", "elbow", "03-01 00:00", "name")
    assert found["arm1/2026-03-02/wrist.csv"] == ("arm1", "wrist", "03-02 00:00", "name")
    assert found["arm2/wrist/run_20260303T1405.npz"] == ("arm2", "wrist", "03-03 14:05", "name")
    assert found["x.csv"][:2] == ("", "x") and found["x.csv"][3] == "file"
    (only,) = cases(tmp_path / "arm2", options=["--names", "{joint}_{date}"])
    assert (only.joint, only.date.day) == ("run", 3)
    (tmp_path / "a" / ("a" * 200)).mkdir(parents=True)
    (tmp_path / "a" / ("a" * 200) / "b.csv").touch()
    for pattern, why in (
        ("*a*a*a*{robot}a/{joint}", "more than 4 words and"),
        ("{robot}*/{robot}", "robot is named twice"),
        ("{robot}*a*a***a/c", "does not read as"),  # soon
        ("{arm}", "unknown part of a name 'arm'"),
    ):
        with pytest.raises(ValueError, match=why):
            cases(tmp_path / "a", options=["--names", pattern])


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere links need rights, and names are text")
def test_links_are_called_as_they_are_called_and_what_leads_nowhere_costs_no_other_case(folder, tmp_path, client):
    elbow, store = folder / "arm" / "elbow", tmp_path / "store"
    store.mkdir()
    for day in ("2026-01-12", "2026-01-19"):  # as git-annex keeps what has not changed
        os.rename(elbow / f"{day}.csv", store / f"8f0e{day}.csv")
        (elbow / f"{day}.csv").symlink_to(store / f"8f0e{day}.csv")
    (tmp_path / "here").symlink_to(folder)
    first, *_ = cases(tmp_path / "here")
    assert (first.name, first.robot, first.joint) == ("arm/elbow/2026-01-05.csv", "arm", "elbow")
    (elbow / "loop.csv").symlink_to("loop.csv")
    for name in ("here", "there"):
        (elbow / name).symlink_to(folder)
    os.rename(elbow / "2026-01-05.csv", os.fsencode(elbow) + b"/2026-01-05 \xff\x1b.csv")
    dataset = Dataset(tmp_path / "out")
    tally = survey(cases(folder), dataset, client, look=stub)
    assert (tally.new["done"], tally.new["refused"]) == (6, 1)
    assert [name for name, _ in tally.troubles] == ["arm/elbow/loop.csv"]
    assert {"arm/elbow/2026-01-05 \\udcff\\x1b.csv", "arm/elbow/2026-01-12.csv"} <= {
        row["name"] for row in dataset.rows(["name"])
    }
    assert survey(cases(folder), dataset, client, look=stub).known["done"] == 6


def test_a_table_and_a_study_say_what_no_path_does(tmp_path):
    (tmp_path / "data").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / "data" / name).touch()
    table = tmp_path / "fleet.csv"
    table.write_text(
        "robot,joint,date,file,kind\nr1,j1,2026-03-01,data/a.csv,XL330\nr2,j1,2026-03-02T10:00,data/b.csv,\n"
    )
    first, second = cases(table)
    assert (first.robot, first.joint, first.kind, first.dated_by) == ("r1", "j1", "XL330", "table")
    assert (second.kind, second.date.hour) == ("j1", 10)
    (tmp_path / "data" / "study.toml").write_text('[[recording]]\nfile = "a.csv"\nunwrap = true\nrange = [2.0, 4.0]\n')
    told = {case.name: case.source.unwrap for case in cases(tmp_path / "data")}
    assert told == {"a.csv#2-4": True, "b.csv": False}
    (tmp_path / "data" / "good").mkdir()
    (tmp_path / "data" / "good" / "c.csv").touch()
    (tmp_path / "data" / "study.toml").write_text("[[recording]\n")
    broken, good = sorted(cases(tmp_path / "data"), key=lambda case: case.name != "study.toml")
    assert good.name == "good/c.csv"
    row = work.examined(broken, work.Settings())
    assert row["status"] == "refused" and row["reason"].startswith("is not TOML")
    table.write_text("file,date\ndata/a.csv,yesterday\n")
    with pytest.raises(InputError, match="row 2: 'yesterday' is no date"):
        cases(table)
    table.write_text("file,jiont\ndata/a.csv,j\n")
    with pytest.raises(InputError, match="did you mean joint"):
        cases(table)
    with pytest.raises(InputError, match=r"does not read as \{robot\}/\{date\}"):
        cases(tmp_path / "data", options=["--names", "{robot}/{date}"])
    with pytest.raises(InputError, match="named twice"):
        cases(tmp_path / "data" / "b.csv", tmp_path / "data" / "b.csv")


@pytest.mark.parametrize("place", ["out", "arm/elbow", "."])
def test_a_survey_is_no_recording_of_the_next_one(folder, client, place):
    names = [case.name for case in cases(folder)]
    survey(cases(folder), Dataset(folder / place), client, look=stub)
    assert [case.name for case in cases(folder)] == names


# ------------------------------------------------------------------------------------------------- the command


def test_the_command_diagnoses_on_a_cluster_and_writes_pages(tmp_path, swing, client, done):
    write_recording(swing, tmp_path / "elbow_2026-03-01.csv")
    (tmp_path / "wrist_2026-03-01.csv").write_text("time,position\n1,2\n")
    there = client.scheduler.address
    out, page = tmp_path / "out", tmp_path / "fleet.html"
    few = ("stribeck", "quadratic_drag", "spring")
    command = ["survey", str(tmp_path), "-o", str(out), "--dask", there, "--only", ",".join(few)]
    command += ["--reports", "all", "--report", str(page)]
    told = done(*command)
    assert "1 diagnosed, 0 known from before, 1 refused, 0 failed" in told and "wrist_2026-03-01.csv: " in told
    rows = Dataset(out).rows()
    assert [row["joint"] for row in rows] == ["elbow", "wrist"]
    first = rows[0]
    theta = {one["name"]: one for one in first["parameters"]}
    assert theta["inertia"]["value"] == pytest.approx(0.08, rel=0.01) and theta["inertia"]["std"] > 0
    alone = diagnose(read_recording(tmp_path / "elbow_2026-03-01.csv"), only=few).json()
    assert json.loads(first["diagnosis"]) == json.loads(json.dumps(alone))  # a case is a diagnosis
    assert {one["effect"] for one in first["candidates"]} == set(few)
    assert any(one["gain"] is not None for one in first["candidates"])
    links = [href for href in values(Page(page.read_text()), "href") if not href.startswith("#")]
    assert len(links) == 1 and all((tmp_path / link).exists() for link in links)
    told = done(*command)
    assert "0 diagnosed, 2 known from before (1 refused), 0 refused" in told and "wrist_2026-03-01.csv: " in told


@pytest.mark.realtime
@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
@pytest.mark.parametrize("moment", slow.but_first(["beginning", "working", "killed"]))
def test_ctrl_c_or_a_kill_ends_all_processes_and_keeps_what_is_done(tmp_path, swing, moment):
    first = tmp_path / "elbow_2026-01-01.csv"
    write_recording(swing, first)
    for month, day in product(range(2, 8), range(1, 29)):  # more than are done before the interrupt comes
        first.with_name(f"elbow_2026-{month:02}-{day:02}.csv").hardlink_to(first)
    dataset = Dataset(tmp_path / "out")
    command = [sys.executable, "-m", "workbench.cli", "survey", str(tmp_path), "-o", str(dataset.folder)]
    with subprocess.Popen(
        [*command, "--workers", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        wait_until(lambda: dataset.folder.exists() if moment == "beginning" else dataset.parts)
        children = psutil.Process(process.pid).children(recursive=True)
        if moment == "killed":
            process.kill()  # the command alone
        else:
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        told = process.communicate(timeout=PATIENCE)[0]
    assert process.returncode == (-signal.SIGKILL if moment == "killed" else 130) and "Traceback" not in told
    assert psutil.wait_procs(children, timeout=PATIENCE)[1] == []
    if moment == "working":
        assert "what is done is kept" in told and 0 < len(dataset.rows(["name"])) < 169


def test_folders_without_end_are_one_line(tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path)
        for _ in range(1200):
            os.mkdir("d")
            os.chdir("d")
    try:
        assert main(["survey", str(tmp_path / "d"), "-o", str(tmp_path / "out")]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    finally:
        subprocess.run(["rm", "-r", tmp_path / "d"], check=True)  # pytest itself cannot


def test_what_no_effect_explains_is_said_of_a_fleet(tmp_path):
    joint = Joint("r", "j", "j", tuple({"verdict": verdict} for verdict in ("nothing", "unexplained", "missing")))
    told = headline(Fleet(tmp_path, joints=(joint,)))
    assert told == "Something that no effect explains is missing in 1 of 3 cases"
