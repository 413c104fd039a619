"""Whatever happens to the helper, its parent says one sentence and goes on."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from pendulum_env import isolated as module
from pendulum_env.isolated import Answer, isolated
from pendulum_env.reading import Unreadable
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import ColumnError
from tests.patience import PATIENCE, wait_until

posix = pytest.mark.skipif(os.name != "posix", reason="signals and limits of Unix")
linux = pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
SAY = (
    "import os\nfrom pendulum_env.isolated import isolated\nprint(isolated(eval, '__import__(\"os\").getpid(), []')[0]"
)


def run(code: str, **options: object) -> Answer:
    """What an expression is in a helper."""
    names = ("ctypes", "numpy", "os", "time")
    return isolated(eval, f"(lambda ctypes, np, os, time: {code})(*map(__import__, {names}))", **options)


def pid() -> int:
    return run("(os.getpid(), [])")[0]


def lives(process: int) -> bool:
    return subprocess.run(["ps", "-o", "stat=", "-p", str(process)], capture_output=True).stdout[:1] not in (b"", b"Z")


def test_records_and_arrays_come_back_as_they_are_whatever_a_library_prints():
    record, arrays = run(
        '(print("hello"), os.write(2, b"!")) and ({"a": ["b", 1.5, None], "c": "\\ud800"}, [np.arange(5.0), '
        'np.array([[1, 2], [3, 4]], dtype=np.int32)[:, ::-1], np.array("peak"), np.empty(0), np.array([np.nan])])'
    )
    assert record == {"a": ["b", 1.5, None], "c": "\ud800"}
    assert [array.tolist() for array in arrays[:4]] == [[0, 1, 2, 3, 4], [[2, 1], [4, 3]], "peak", []]
    assert [array.dtype.kind for array in arrays] == ["f", "i", "U", "f", "f"]
    assert np.isnan(arrays[4]) and all(array.flags.writeable for array in arrays)


def test_one_helper_does_what_comes_one_after_the_other_and_tells_mistakes_as_they_are():
    first = pid()
    with pytest.raises(ColumnError, match="no column for time, position, torque among no columns at all"):
        isolated(find_columns, [])
    assert pid() == first != os.getpid()


@posix
@pytest.mark.parametrize(
    ("code", "match"),
    [
        ("ctypes.string_at(0)", r"what reads it crashed \(SIGSEGV\): it is damaged, or takes more than 1 GB of memory"),
        ("os.kill(os.getpid(), 9)", r"crashed \(SIGKILL\)"),
        ("os.abort()", r"crashed \(SIGABRT\)"),
        ("1 / 0", r"crashed \(exit code 1\)"),
        ("[open(os.devnull) for _ in range(100)]", r"crashed \(exit code 1\)"),
        ("(None, [np.array([print], dtype=object)])", "crashed"),
        (r"os.write(3, b'\x80\x04N.') and os.abort()", "crashed"),  # to the pipe of answers, if it was taken over
        (r"os.write(3, b'[' * 50_000 + b'\n') and os.abort()", "crashed"),
        (r"os.write(3, b'[]\n') and os.abort()", "crashed"),
        (r"os.write(3, b'{\"arrays\": [[\"<f8\", [3]]]}\n1234') and os.abort()", "crashed"),
        (r"os.write(3, b'{\"arrays\": [[\"<f8\", [-3]]]}\n') and os.abort()", "crashed"),
        (r"os.write(3, b'{\"arrays\": [[\"|O\", [1]]]}\n12345678') and os.abort()", "crashed"),
        (r"os.write(3, b'{\"arrays\": [[\"<f8\", [1000000000000]]]}\n')", "it holds 8e[+]03 GB when unpacked"),
    ],
)
def test_a_helper_that_ends_takes_one_file_with_it(code, match):
    with pytest.raises(Unreadable, match=match):
        run(code)
    assert run("(1, [])") == (1, [])


def test_a_helper_begins_with_what_reads_recordings_and_robots_alone():
    for work in ("recording.storage", "arms.robot"):
        isolated(eval, f"(__import__('pendulum_env.{work}'), [])[1:] + ([],)")
    known = set(isolated(eval, "(list(__import__('sys').modules), [])")[0])
    assert {"numpy", "pyarrow", "pendulum_env.arms.robot"} <= known
    assert not known & {"gymnasium", "scipy", "pymunk", "pendulum_env.arms.body", "pendulum_env.physics"}


@posix
def test_a_helper_is_where_its_parent_is_now(tmp_path, monkeypatch):
    pid()  # begins one, here
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        monkeypatch.chdir(folder)
        assert os.path.samefile(run("(os.getcwd(), [])")[0], folder)
    folder.rmdir()
    assert pid()


@posix
def test_a_helper_that_dies_while_it_waits_is_no_fault_of_the_next_file():
    helper = pid()
    os.kill(helper, signal.SIGKILL)
    os.waitid(os.P_PID, helper, os.WEXITED | os.WNOWAIT)  # until all of its threads have ended
    assert run("(1, [])") == (1, [])


@linux
def test_memory_is_bounded():
    with pytest.raises(Unreadable, match="takes more than 600 MB of memory: export it again, or shorten it, or allow"):
        run("(None, [np.ones(90_000_000)])", size=100e6)
    with pytest.raises(Unreadable, match="it holds 200 MB when unpacked, of which at most 100 MB are read: shorten it"):
        run("(None, [np.ones(25_000_000)])", size=100e6)
    assert run("(None, [np.ones(25_000_000)])", size=200e6)[1][0].sum() == 25_000_000


@posix
def test_processor_time_is_bounded_for_each_file(monkeypatch):
    monkeypatch.setattr(module, "BOUNDS", module.Bounds(seconds=1))
    for _ in range(2):
        with pytest.raises(Unreadable, match=r"^it takes more than 1 s to read: write less$"):
            run("sum(iter(int, 1))", remedy="write less")
        assert run("(1, [])") == (1, [])


def test_what_waits_for_ever_is_ended_by_the_clock(monkeypatch):
    monkeypatch.setattr(module, "BOUNDS", module.Bounds(patience=0.05))
    with pytest.raises(Unreadable, match="it takes more than 20 s to read"):
        run("time.sleep(1000)")


def test_a_module_in_the_working_directory_is_not_run(tmp_path):
    for name in ("json", "pickle", "pendulum_env"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    command = [sys.executable, "-P", "-c", f"{SAY})"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=PATIENCE)
    assert done.stdout.strip().isdigit() and done.stderr == ""


WAITING = 'isolated(eval, \'open("begun", "w").close() or __import__("time").sleep(1000)\')'


@posix
@pytest.mark.parametrize(
    ("ending", "sent"),
    [("pass", None), ("os.kill(os.getpid(), 9)", None), (WAITING, signal.SIGINT), (WAITING, signal.SIGKILL)],
)
def test_no_helper_outlives_its_parent(ending, sent, tmp_path):
    command = [sys.executable, "-c", f"{SAY}, flush=True)\n{ending}"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    environment = os.environ | {"PYTHONPATH": os.getcwd()}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, **streams) as parent:
        helper = int(parent.stdout.readline())
        if sent:
            wait_until((tmp_path / "begun").exists)
            parent.send_signal(sent)
    wait_until(lambda: not lives(helper))
