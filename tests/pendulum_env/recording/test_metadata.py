"""Rows of metadata between names and data, and names behind a percent sign."""

import numpy as np

from pendulum_env.recording import read_recording

TIME = np.arange(300) / 100
ROWS = [f"{10 * k}\t{np.sin(t):.6f}\t{np.cos(t):.6f}" for k, t in enumerate(TIME)]


def test_rows_that_describe_the_columns_are_no_data(tmp_path):
    path = tmp_path / "scope.csv"
    metadata = ["Comment\t\t", "SampleTime\t10\t10", "Device\t5.44.12.1\t", "Unit\trad\t"]
    path.write_text("\n".join(["Clock\tActual Position\tActual Torque", *metadata, "", *ROWS]) + "\n")
    read = read_recording(path, columns={"time": "Clock:ms"})
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    np.testing.assert_allclose(read.position, np.sin(TIME), atol=1e-6)


def test_names_behind_a_percent_sign_have_seconds_and_nanoseconds(tmp_path):
    path = tmp_path / "DataRecorder.log"
    seconds = [f"{1000 + int(t)} {round(t % 1 * 1e9)} {np.sin(t):.6f} {np.cos(t):.6f}" for t in TIME]
    path.write_text("\n".join(["%TimeInSec TimeInNanoSec position torque", *seconds]) + "\n")
    read = read_recording(path)
    np.testing.assert_allclose(read.time - read.time[0], TIME, atol=1e-6)
