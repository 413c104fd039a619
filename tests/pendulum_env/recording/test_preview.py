"""What is in a file before its columns mean anything."""

from pathlib import Path

import numpy as np

from pendulum_env.recording.columns import guess_columns
from pendulum_env.recording.preview import read_preview

TIME = np.arange(200) / 100


def test_every_column_is_seen_as_it_stands_in_the_file(tmp_path: Path) -> None:
    rows = "".join(f"{t:.2f};run;{k % 7},5;\n".replace(".", ",") for k, t in enumerate(TIME))
    (tmp_path / "a.csv").write_text("clock;mode;Winkel [deg];free\n" + rows)
    seen = read_preview(tmp_path / "a.csv")
    assert seen.headers == ("clock", "mode", "Winkel [deg]", "free")
    clock, mode, angle, free = seen.values
    np.testing.assert_allclose(clock, TIME)
    np.testing.assert_allclose(angle, np.arange(200) % 7 + 0.5)
    assert mode is None and np.isnan(free).all()


def test_matrices_and_what_is_no_series_are_told_apart(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, x=np.arange(400.0).reshape(200, 2), gain=3.0, name="run")
    seen = read_preview(tmp_path / "a.npz")
    assert seen.headers == ("t", "x[0]", "x[1]", "gain", "name")
    assert [None if x is None else len(x) for x in seen.values] == [200, 200, 200, None, None]
    np.testing.assert_array_equal(seen.values[2], np.arange(1.0, 400.0, 2))


def test_columns_are_guessed_by_their_names_where_one_alone_is_likely() -> None:
    guessed = guess_columns(["time_ms", "q", "q_meas", "iq", "dq [deg/s]"])
    assert guessed == {"time": "time_ms", "torque": "iq", "velocity": "dq [deg/s]"}
