"""A study: which recordings there are, how they are read, and what they are for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendulum_env.recording import (
    Load,
    Recording,
    RecordingError,
    Source,
    StudyError,
    read_study,
    write_recording,
    write_study,
)
from pendulum_env.recording.study import read_sources
from robots.servos import ServoDrive

ANY = st.characters(exclude_categories=("Cs",), exclude_characters="\0")
TEXT = st.text(ANY, min_size=1, max_size=15).filter(str.strip)
NAMES = st.from_regex(r"[a-z][a-z0-9 äß'#\[\]=.-]{0,8}\.csv", fullmatch=True)
SECONDS = st.floats(0, 1e4)
LOADS = st.builds(Load, st.floats(0, 1e3), st.floats(-1e3, 1e3))
COLUMNS = st.dictionaries(st.sampled_from(["time", "position", "velocity", "torque", "reference"]), TEXT, max_size=4)
RANGES = st.tuples(SECONDS, SECONDS).map(sorted).filter(lambda pair: pair[0] < pair[1]).map(tuple)


DRIVES = [
    None,
    ServoDrive(kp=np.float64(2.5), output="torque"),
    ServoDrive("velocity", "torque", kp=1.0, ki=0.5, rate=500.0),
]
SOURCES = st.builds(
    Source, NAMES.map(Path), st.sampled_from(["fit", "holdout"]), COLUMNS, st.booleans(), st.none() | RANGES,
    st.none() | LOADS, drive=st.sampled_from(DRIVES),
)  # fmt: skip


@settings(max_examples=100)
@given(sources=st.lists(SOURCES, min_size=1, max_size=4, unique_by=lambda source: source.file))
def test_what_is_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, sources: list[Source]) -> None:
    folder = tmp_path_factory.getbasetemp() / "studies"
    folder.mkdir(exist_ok=True)
    sources = [replace(source, file=folder / source.file) for source in sources]
    write_study(sources, folder / "study.toml")
    assert list(read_sources(folder / "study.toml")) == sources


A = "[[recording]]\nfile = 'a.csv'\n"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[columns", "is not TOML"),
        ("", "names no recordings: write"),
        ("[[recordings]]\nfile = 'a.csv'", "unknown key 'recordings': did you mean recording"),
        (f"# bench\n\n{A}\nrol = 'fit'", r"'recording\[0\]': unknown key 'rol': did you mean role"),
        ("[[recording]]\nrole = 'fit'", r"'recording\[0\]': .* missing required field file"),
        (f"{A * 2}role = 'test'", r"toml: 'recording\[1\].role' is 'test': expected one of fit, holdout"),
        (f"{A}range = [3, 1]", r"'recording\[0\]': range is \[3.0, 1.0\]: expected \[from, to\]"),
        (f"{A}load = {{mass = 1}}", "load needs mass and length, or inertia and gravity"),
        (f"{A}[recording.load]\nmass = 1\nlength = -2", r"'recording\[0\].load.length': Expected float >= 0"),
        (f"{A}load = {{inertia = 1, gravity = inf}}", "load.gravity': Expected float <= 1"),
        (f"[columns]\ntorqe = 'tau'\n{A}", "did you mean torque"),
        (f"[columns]\ntorque = 3\n{A}", "'columns.torque': Expected str"),
        (f"{A * 2}role = 'holdout'", "a.csv is named twice"),
        (f"{A}range = [0, 5]\n[[recording]]\nfile = './a.csv'\nrange = [4, 9]", "a.csv is named twice: give"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(StudyError, match=match) as refusal:
        read_sources(path)
    assert str(refusal.value).startswith(str(path))


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two files whose columns are those of a servo, in a folder of their own."""
    time = np.arange(5000) / 500
    for name, factor in (("a", 1.0), ("b", 2.0)):
        motor = -6 * np.degrees(factor * np.sin(time)) + 45
        rows = np.column_stack([1e3 * time, motor, factor * np.cos(time)])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="clock,motor,i", comments="")
    return tmp_path


STUDY = """
[columns]
time = "clock:ms"
position = "-motor:deg/6+7.5"
torque = "i:A*0.5"

[[recording]]
file = "a.csv"
range = [2, 8]
load = {mass = 0.5, length = 0.2}

[[recording]]
file = "b.csv"
role = "holdout"
columns = {torque = "i:A*0.25"}
"""


def test_a_study_reads_its_recordings(bench: Path) -> None:
    (bench / "study.toml").write_text(STUDY)
    study = read_study(bench / "study.toml")
    (a,), (b,) = study.fitted, study.held_out
    assert study.recordings == (a, b)
    assert (a.time[0], a.time[-1], len(a)) == (2.0, pytest.approx(7.998), 3000)
    np.testing.assert_allclose(a.position, np.sin(a.time), atol=1e-9)
    np.testing.assert_allclose(a.torque, 0.5 * np.cos(a.time), atol=1e-9)
    np.testing.assert_allclose(b.torque, 0.25 * 2 * np.cos(b.time), atol=1e-9)
    assert a.load is not None and b.load is None
    assert (a.load.inertia, a.load.gravity) == (pytest.approx(0.5 * 0.2**2), pytest.approx(0.5 * 9.81 * 0.2))
    assert all(part.load == a.load for part in a.segments)


def test_a_study_of_one_recording_may_be_a_plain_table(bench: Path) -> None:
    one = STUDY[: STUDY.rindex("[[recording]]")]
    for text in (one, one.replace("[[recording]]", "[recording]")):
        (bench / "study.toml").write_text(text)
        (a,) = read_study(bench / "study.toml").recordings
        assert (a.name, len(a)) == ("a", 3000)


def test_a_range_needs_samples(bench: Path) -> None:
    (bench / "study.toml").write_text(STUDY.replace("[2, 8]", "[20, 30]"))
    with pytest.raises(RecordingError, match=r"a\.csv: holds no two samples from 20 to 30 s: it lasts 10 s"):
        read_study(bench / "study.toml")


def test_files_below_the_study_are_named_relative_to_it(tmp_path: Path, swing: Recording) -> None:
    (tmp_path / "one" / "data").mkdir(parents=True)
    write_recording(swing, tmp_path / "one" / "data" / "run.csv")
    write_study([Source(tmp_path / "one" / "data" / "run.csv")], tmp_path / "one" / "study.toml")
    (tmp_path / "one").rename(tmp_path / "other")
    (recording,) = read_study(tmp_path / "other" / "study.toml").recordings
    np.testing.assert_array_equal(recording.position, swing.position)
