"""Surveys: what is diagnosed, what is skipped, what fails, and the tables."""

import argparse
import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from benchmarks.two_link import TwoLink
from estimators import diagnose
from pendulum_env.recording import RecordingError, read_recording, write_recording
from tests.patience import PATIENCE, wait_until
from tests.workbench.surveys import BEGAN, surveyed_rows
from workbench.cli import main
from workbench.commands.survey import configure
from workbench.errors import InputError
from workbench.processes import open_local_workers
from workbench.survey.diagnosis import Settings, make_rows
from workbench.survey.recordings import TABLES, find_recordings
from workbench.survey.run import DIED, RESULTS, run_survey
from workbench.survey.table import find_series, write_table

FEW = ("stribeck", "quadratic_drag", "spring")


def arguments(folder, *options):
    parser = argparse.ArgumentParser()
    configure(parser)
    return parser.parse_args([str(folder), "-o", "-", *options], argparse.Namespace(plugin=None))


def write(folder, machine, week, **values):
    path = folder / machine / f"{BEGAN + timedelta(weeks=week):%Y-%m-%d}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values))
    return path


def read_values(source, settings):
    """Stand in for a diagnosis: the parameters are the content of the file, which may also ask for a failure."""
    text = source.file.read_text()
    if text == "damaged":
        raise RecordingError("it is damaged: export it again")
    if text == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    parameters = {name: {"value": value, "std": 0.004, "unit": "N m"} for name, value in json.loads(text).items()}
    row = {"joint": "", "effects": "", "selected": [], "unexplained": False, "biased": False, "error_unit": "N m"}
    errors = dict.fromkeys(
        ("error_before", "error_after", "noise_floor", "position_rms_before", "position_rms_after"), 0.01
    )
    return {"start": None, "rows": [row | errors | {"parameters": parameters}]}


class Counted:
    """Diagnoses, counted; an interrupt comes in place of the one after `most`."""

    def __init__(self, most=1000):
        self.done, self.most = [], most

    def __call__(self, source, settings):
        if len(self.done) == self.most:
            raise KeyboardInterrupt
        self.done.append(source.file.name)
        return read_values(source, settings)


def run(folder, output, *task, options=(), start=ThreadPoolExecutor, workers=1):
    asked = arguments(folder, *options)
    found = find_recordings(folder, asked)
    return run_survey(
        found, Settings.from_arguments(asked), output, start, workers, **({"task": task[0]} if task else {})
    )


@pytest.fixture
def folder(tmp_path):
    """Recordings of two machines, three weeks each."""
    for machine in ("arm", "leg"):
        for week in range(3):
            write(tmp_path / "data", machine, week, coulomb=0.9 + 0.001 * week, inertia=0.1 * (machine == "leg"))
    return tmp_path / "data"


def test_new_and_changed_files_and_other_options_alone_are_diagnosed_again(folder, tmp_path):
    rows = run(folder, tmp_path / "out", Counted())
    assert run(folder, tmp_path / "out", Counted(most=0)) == rows and len(rows) == 6
    write(folder, "arm", 3, coulomb=1.0)
    changed = write(folder, "leg", 0, coulomb=1.2)
    os.utime(folder / "arm/2026-01-12.csv", (0, 0))  # its content is the same
    (folder / "leg/2026-01-12.csv").rename(folder / "leg/2026-01-13.csv")
    task = Counted()
    rows = run(folder, tmp_path / "out", task)
    assert sorted(task.done) == [changed.name, "2026-01-26.csv"] and len(rows) == 7
    assert "leg/2026-01-13.csv" in {row["recording"] for row in rows}
    task = Counted()
    run(folder, tmp_path / "out", task, options=("--fix", "gravity=2"))
    assert len(task.done) == 7


def test_an_interrupted_survey_continues_to_the_same_rows(folder, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(folder, tmp_path / "out", Counted(most=4))
    task = Counted()
    assert run(folder, tmp_path / "out", task) == run(folder, tmp_path / "other", Counted())
    assert len(task.done) == 2


@pytest.mark.parametrize(
    "content",
    [b'{"rows": [', b"[]", b'{"start": null, "rows": []}', b"\xff"],
)
def test_a_result_that_is_damaged_is_made_again(folder, tmp_path, content):
    rows = run(folder, tmp_path / "out", Counted())
    file = next((tmp_path / "out" / RESULTS).iterdir())
    file.write_bytes(content)
    task = Counted()
    assert run(folder, tmp_path / "out", task) == rows and len(task.done) == 1


def test_recordings_of_one_file_each_have_their_own_result(tmp_path):
    (tmp_path / "run.csv").write_text("{}")
    for study, columns in (("a", "q"), ("b", "angle")):
        (tmp_path / study).mkdir()
        ranges = "".join(
            f'[[recording]]\nfile = "../run.csv"\ncolumns = {{position = "{columns}"}}\nrange = {part}\n'
            for part in ("[0.0, 1000000.1]", "[1000000.1, 1000000.2]", "[1000000.15, 1000000.3]")[: 1 + (study == "b")]
        )
        (tmp_path / study / "study.toml").write_text(ranges)

    def task(source, settings):
        own = f"{source.columns['position']} {source.range}"
        return read_values(source, settings) | {"rows": [{**read_values(source, settings)["rows"][0], "effects": own}]}

    first = run(tmp_path, tmp_path / "out", task)
    assert len({row["effects"] for row in first}) == len(first) == 3
    assert run(tmp_path, tmp_path / "out", Counted(most=0)) == first


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a signal of Unix")
def test_a_worker_that_is_killed_costs_its_recording_alone(folder, tmp_path):
    (folder / "arm/2026-01-12.csv").write_text("deadly")
    rows = run(folder, tmp_path / "out", read_values, start=open_local_workers, workers=2)
    assert {row["recording"]: row.get("error") for row in rows} == {
        f"{machine}/{day}.csv": DIED if (machine, day) == ("arm", "2026-01-12") else None
        for machine in ("arm", "leg")
        for day in ("2026-01-05", "2026-01-12", "2026-01-19")
    }


# ------------------------------------------------------------------------------------------------------ recordings


def test_folders_are_machines_and_names_have_dates(tmp_path):
    for name in ("arm1/elbow/2026-03-01.csv", "arm1/2026-03-02/run.csv", "arm2/run_20260303T1405.npz", "x.csv", "a.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = find_recordings(tmp_path, arguments(tmp_path))
    told = {own.name: (own.machine, f"{own.date:%m-%d %H:%M}") for own in found if own.dated_by == "name"}
    assert told == {
        "arm1/elbow/2026-03-01.csv": ("arm1/elbow", "03-01 00:00"),
        "arm1/2026-03-02/run.csv": ("arm1", "03-02 00:00"),
        "arm2/run_20260303T1405.npz": ("arm2", "03-03 14:05"),
    }
    (other,) = (own for own in found if own.dated_by == "file")
    assert (other.name, other.machine) == ("x.csv", tmp_path.name)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no recording"):
        find_recordings(tmp_path / "empty", arguments(tmp_path / "empty"))


def test_a_study_says_how_its_recordings_are_read(folder):
    (folder / "arm/study.toml").write_text(
        '[[recording]]\nfile = "2026-01-05.csv"\nunwrap = true\nrange = [2.0, 4.0]\n'
    )
    told = {own.name: own.source.unwrap for own in find_recordings(folder, arguments(folder))}
    assert told.pop("arm/2026-01-05.csv#2-4") and len(told) == 5 and not any(told.values())


def test_a_clock_that_counts_from_1970_gives_the_date(tmp_path, swing):
    start = datetime(2026, 2, 3, 12, tzinfo=UTC)
    rows = np.column_stack([swing.time + start.timestamp(), swing.position, swing.torque])
    (tmp_path / "data").mkdir()
    np.savetxt(tmp_path / "data" / "run.csv", rows, "%.9f", ",", header="time,position,torque", comments="")
    (row,) = run(tmp_path / "data", tmp_path / "out", options=("--only", "spring"))
    assert row["dated_by"] == "clock" and abs(row["date"] - start) < timedelta(seconds=1)


@pytest.mark.parametrize("start", [1e12, 4e9, -1e300])  # milliseconds, a date to come, and no date
def test_a_clock_without_a_credible_date_leaves_the_date_of_the_name(folder, tmp_path, start):
    rows = run(folder, tmp_path / "out", lambda *given: read_values(*given) | {"start": start})
    assert {row["dated_by"] for row in rows} == {"name"} and rows[0]["date"] == BEGAN


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("2026-03-01_2500Hz.csv", datetime(2026, 3, 1, tzinfo=UTC)),
        ("20260301-4711.csv", datetime(2026, 3, 1, tzinfo=UTC)),
        ("20260301_140599.csv", datetime(2026, 3, 1, tzinfo=UTC)),
        ("2026-03-01_14-05-30-2.csv", datetime(2026, 3, 1, 14, 5, 30, tzinfo=UTC)),
        ("2026-02-31_2026-03-01T1405.csv", datetime(2026, 3, 1, 14, 5, tzinfo=UTC)),
        ("serial_29991231.csv", None),
    ],
)
def test_numbers_beside_a_date_are_no_time_and_dates_to_come_no_dates(tmp_path, name, date):
    (tmp_path / name).touch()
    (found,) = find_recordings(tmp_path, arguments(tmp_path))
    assert (found.dated_by == "name") == (date is not None) and date in (found.date, None)


def test_tables_of_surveys_are_no_recordings(tmp_path):
    for name in ("run.csv", "out/survey.csv", "out/survey.parquet"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [own.name for own in find_recordings(tmp_path, arguments(tmp_path))] == ["run.csv"]


# ----------------------------------------------------------------------------------------------------------- trends


@pytest.fixture
def rows():
    return surveyed_rows()


def test_a_drift_and_a_jump_are_named_with_their_sizes_and_nothing_else(rows, tmp_path):
    found = find_series(rows)
    for own in found:
        own.mark_changes()
    named = {(own.machine, own.parameter): own for own in found if own.change}
    assert {key: own.change for key, own in named.items()} == {
        ("drifts", "coulomb"): "drift",
        ("jumps", "inertia"): "jump",
    }
    low, high = named["drifts", "coulomb"].trend.interval
    assert low < 0.01 < high
    write_table(tmp_path, rows)
    table = pq.read_table(tmp_path / "survey.parquet").to_pylist()
    drifts = {row["machine"]: row["coulomb_drift_per_week"] for row in table}
    assert drifts == {"drifts": pytest.approx(0.01, rel=0.1), "jumps": None, "stays": None}
    (jump,) = (row for row in table if row["inertia_jump"] is not None)
    assert (jump["machine"], jump["date"]) == ("jumps", BEGAN + timedelta(weeks=8))
    assert abs(jump["inertia_jump"] - 0.05) < 3 * named["jumps", "inertia"].trend.jump.std < 0.01
    assert all((row["coulomb_p_value"] < 0.01) == (row["machine"] == "drifts") for row in table)


def test_estimates_beside_other_effects_are_another_series(rows):
    moved = [
        row | {"selected": ["spring", "stribeck"], "effects": "stribeck, spring"}
        if row["machine"] == "jumps" and row["date"] >= BEGAN + timedelta(weeks=8)
        else row
        for row in rows
    ]
    found = {(own.machine, own.parameter, own.effects): own for own in find_series(moved)}
    assert [key for key, own in found.items() if own.change] == [("drifts", "coulomb", "")]
    assert [len(found["jumps", "inertia", effects].rows) for effects in ("", "spring, stribeck")] == [8, 4]


def test_biased_and_unknown_estimates_are_in_no_trend(rows):
    biased = [row | {"biased": row["machine"] == "drifts"} for row in rows]
    unknown = {"inertia": {"value": None, "std": None, "unit": "kg m^2"}}
    given = [row | {"parameters": row["parameters"] | (unknown if row["machine"] == "jumps" else {})} for row in biased]
    found = {(own.machine, own.parameter) for own in find_series(given)}
    assert found == {("jumps", "coulomb"), ("stays", "coulomb"), ("stays", "inertia")}


def test_a_row_has_no_value_of_an_unknown_parameter_and_says_what_is_biased(swing):
    found = diagnose(swing, only=FEW)
    first, second, *_ = found.model.estimates
    assert not make_rows(found)[0]["biased"] and None not in make_rows(found)[0]["parameters"][first].values()
    *steps, last = found.steps
    found = replace(found, steps=(*steps, replace(last, model=last.model.mark_biased().mark_unknown([first]))))
    (row,) = make_rows(found)
    assert row["biased"] and (row["parameters"][first]["value"], row["parameters"][first]["std"]) == (None, None)
    assert row["parameters"][second]["value"] == found.model.estimates[second].value


# ------------------------------------------------------------------------------------------------------ the command


@pytest.fixture
def recordings(tmp_path, swing):
    """A good recording and a damaged one."""
    (tmp_path / "data" / "elbow").mkdir(parents=True)
    write_recording(swing, tmp_path / "data" / "elbow" / "2026-03-01.csv")
    (tmp_path / "data" / "elbow" / "2026-03-08.csv").write_text("time,position,force\n1,2,3\n")
    return tmp_path / "data"


def test_the_command_writes_tables_of_diagnoses_and_of_a_damaged_file(recordings, run_command):
    command = ["survey", str(recordings), "-o", str(recordings / "out"), "--only", ",".join(FEW), "--workers", "1"]
    told = run_command(*command)
    assert "0 known from before, 1 diagnosed, 1 failed" in told and "no column for torque" in told
    good, damaged = pq.read_table(recordings / "out" / "survey.parquet").to_pylist()
    assert damaged["error"].startswith("no column for torque among") and damaged["inertia"] is None
    found = diagnose(read_recording(recordings / "elbow" / "2026-03-01.csv"), only=FEW)
    for name, own in found.model.estimates.items():
        assert (good[name], good[f"{name}_std"]) == (own.value, own.std)
    assert good["effects"] == ", ".join(found.selected) and good["error"] is None
    assert good["error_after"] == found.steps[-1].errors["holdout"].torque_rms
    flat = pyarrow.csv.read_csv(recordings / "out" / "survey.csv")
    assert flat.column_names == list(good) and flat["inertia"].to_pylist() == [good["inertia"], None]
    told = run_command(*command)  # the tables are no recordings
    assert "2 recordings of 1 machine: 1 known from before, 0 diagnosed, 1 failed" in told


def test_a_survey_of_failures_alone_fails(recordings, tmp_path, capsys):
    (recordings / "elbow" / "2026-03-01.csv").unlink()
    assert main(["survey", str(recordings), "-o", str(tmp_path / "out"), "--workers", "1"]) == 2
    assert "no recording could be diagnosed" in capsys.readouterr().err
    (row,) = pq.read_table(tmp_path / "out" / "survey.parquet").to_pylist()
    assert row["error"].startswith("no column for torque")


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_table(recordings, tmp_path, run_command):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        for output, where in (("there", ["--scheduler", cluster.scheduler_address]), ("here", ["--workers", "1"])):
            run_command("survey", str(recordings), "-o", str(tmp_path / output), "--only", ",".join(FEW), *where)
    there, here = (pq.read_table(tmp_path / output / TABLES[0]) for output in ("there", "here"))
    assert there.equals(here) and there.num_rows > 0


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--fix", "inertai=1"], "inertai"),
        (["--robot", "{arm}", "--only", "stribeck@elbwo"], "elbwo"),
        (["--robot", "{arm}", "--fix", "gravity=2"], "--fix is for pendulums"),
    ],
)
def test_what_would_fail_for_every_recording_is_said_at_once(recordings, tmp_path, capsys, options, why):
    arm = tmp_path / "arm.urdf"
    arm.write_text(TwoLink().urdf())
    options = [option.format(arm=arm) for option in options]
    assert main(["survey", str(recordings), "-o", str(tmp_path / "out"), *options]) == 2
    told = capsys.readouterr()
    assert why in told.err and told.err.count("\n") == 1 and told.out == ""


@pytest.mark.realtime
@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_ctrl_c_ends_all_processes_and_keeps_what_is_done(tmp_path, recordings):
    psutil = pytest.importorskip("psutil")
    first, output = recordings / "elbow" / "2026-03-01.csv", tmp_path / "out"
    text = first.read_text()
    for day in range(100):  # more than are done before the interrupt comes
        first.with_name(f"{day}.csv").write_text(text + "\n" * day)
    command = [sys.executable, "-m", "workbench.cli", "survey", str(recordings), "-o", str(output), "--workers", "1"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        wait_until(lambda: (output / RESULTS).is_dir() and any((output / RESULTS).glob("*.json")))
        children = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        told = process.communicate(timeout=PATIENCE)[0]
    assert process.returncode == 130 and "run again to continue" in told and "Traceback" not in told
    assert psutil.wait_procs(children, timeout=PATIENCE)[1] == []
    assert 0 < len(list((output / RESULTS).iterdir())) < 100
