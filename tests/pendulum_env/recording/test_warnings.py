"""Warnings in Python: rows that are left out, and units that are uncertain, when a recording is read."""

import re
import warnings
from functools import cache

import numpy as np
import pytest

from estimators import add, compare, diagnose, identify
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.recording import Recording, RecordingWarning, Source, read_recording, read_study
from robots.arms.reading import read_arm_recording
from tests.pendulum_env.recording.test_files import driven

LOST = [100, 300, 301]
LEFT_OUT = r"torque is empty or NaN in 3 data rows \(101, 301 and 302\): left out"


@cache
def run():
    return record(None, excitation("paper", 1), 10.0, rate=200.0, rng=1)


def table(**changed):
    return {"time": run().time, "position": run().position, "torque": run().torque, **changed}


def with_lost_rows():
    torque = run().torque.copy()
    torque[LOST] = np.nan
    return table(torque=torque)


def warned(call, *arguments, **options):
    """Return the texts of all warnings of a call, which are attributed to this file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call(*arguments, **options)
    assert all(entry.category is RecordingWarning and entry.filename == __file__ for entry in caught)
    return result, [str(entry.message) for entry in caught]


def test_a_reader_warns_once_of_the_rows_that_it_leaves_out_with_their_count_and_place(tmp_path):
    with pytest.warns(RecordingWarning, match=f"^monday: {LEFT_OUT}$"):
        recording = read_recording(with_lost_rows(), name="monday")
    assert len(warned(read_recording, with_lost_rows())[1]) == 1
    assert warned(read_recording, table())[1] == []
    assert warned(identify, recording, schemes="energy")[1] == []  # warned of already
    file = tmp_path / "run.csv"
    rows = np.column_stack([*with_lost_rows().values()])
    np.savetxt(file, rows, delimiter=",", header="time,position,torque", comments="")
    with pytest.warns(RecordingWarning, match=f"run.csv: {LEFT_OUT}"):
        read_recording(file)
    (tmp_path / "study.toml").write_text('[[recording]]\nfile = "run.csv"\n')
    with pytest.warns(RecordingWarning, match=f"run.csv: {LEFT_OUT}"):
        read_study(tmp_path / "study.toml")
    assert warned(Source(file).read)[1] == []  # of the command line, which prints notes


def test_every_function_that_reads_a_table_warns_of_its_lost_rows():
    model = identify(table())["energy"].model
    for call in (
        lambda: identify(with_lost_rows(), schemes="energy"),
        lambda: compare(model, with_lost_rows()),
        lambda: add(model, "stribeck", with_lost_rows()),
        lambda: diagnose(with_lost_rows(), library={}),
    ):
        _, texts = warned(call)
        assert len(texts) == 1 and "3 data rows (101, 301 and 302)" in texts[0]
    assert "recording 2: " in warned(lambda: compare(model, [table(), with_lost_rows()]))[1][0]


def test_an_arm_warns_of_lost_rows_of_a_joint():
    torque = run().torque.copy()
    torque[LOST] = np.nan
    columns = {f"{quantity}_{joint}": run().series[quantity] for quantity in ("position", "torque") for joint in "ab"}
    with pytest.warns(RecordingWarning, match=r"torque_a is empty or NaN in 3 data rows"):
        read_arm_recording({"time": run().time, **columns, "torque_a": torque, "torque_b": torque}, ["a", "b"])


def test_degrees_that_a_log_format_takes_for_radians_are_warned_of():
    model = identify(read_recording(table(), columns={"position": "position:rad"}))["energy"].model
    assert warned(compare, model, table())[1] == []
    _, texts = warned(compare, model, table(position=np.degrees(run().position)))
    assert len(texts) == 1
    assert re.search("gravity acts on it as on degrees: read it with .*position:deg", texts[0])


def test_several_notes_are_one_warning():
    lost = with_lost_rows()
    with pytest.warns(RecordingWarning) as caught:
        read_recording(lost | {"position": np.degrees(lost["position"])}, columns={"position": "position:rad"})
    (entry,) = caught
    assert "left out; position runs from" in str(entry.message)


def test_a_recording_of_arrays_warns_where_degrees_are_possible():
    """A spring over radians explains the motion, too, so the arrays are not refused."""
    sweep = driven(lambda time: 40 * np.sin(0.4 * time) * np.sin(2 * time), lambda t, q, v: 9.81 * q + 0.2 * v, 1.0)
    with pytest.warns(RecordingWarning, match="recording 'spring': position runs from .* on which a spring acts"):
        Recording(**sweep, name="spring")
