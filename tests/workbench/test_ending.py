"""However a command ends, it says so in a line, and nothing that it began goes on without it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pendulum_env.physics import plugin
from pendulum_env.recording import write_recording
from tests import slow
from tests.disks import full_after
from tests.patience import PATIENCE
from workbench.cli import main

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and devices of Unix")

BEGUN = {
    "worker": """
from workbench.app.jobs import Job, Workers
from tests.workbench.test_processes import sleep
from tests.patience import wait_until
if __name__ == "__main__":
    job = Job("a job", sleep, Workers())
    wait_until(lambda: job.progress[0] == "sleeping")
    print("running", flush=True)
    job.over.wait()
""",
    "pool": """
import time
from workbench.processes import open_local_workers
if __name__ == "__main__":
    with open_local_workers(1) as pool:
        pool.submit(int).result()
        print("running", flush=True)
        pool.submit(time.sleep, 1000).result()
""",
}
COMMAND = [sys.executable, "-c", "import sys; from workbench.entry import main; sys.exit(main())"]


def run(redirection: str, *arguments: str, shell: str = "sh") -> subprocess.CompletedProcess[str]:
    line = f'"$@" {redirection}'
    return subprocess.run(
        [shell, "-c", line, shell, *COMMAND, *arguments], capture_output=True, text=True, timeout=PATIENCE
    )


@pytest.mark.parametrize("redirection", slow.but_first([">&- 2>&- <&-", ">&-", "2>&-", ">/dev/null"]))
def test_a_stream_that_is_closed_is_no_mistake(redirection):
    for command in ("effects", "--help"):  # of which argparse would print help elsewhere
        done = run(redirection, command)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def recording(tmp_path, swing):
    write_recording(swing, tmp_path / "run.csv")
    return str(tmp_path / "run.csv")


def test_files_are_written_though_nobody_reads_what_is_said(tmp_path, recording):
    model = tmp_path / "model.json"
    done = run('| true; echo "${PIPESTATUS[0]}"', "identify", recording, "-o", str(model), shell="bash")
    assert (done.stdout, done.stderr) == ("0\n", "") and model.is_file()


@pytest.mark.parametrize(("what", "code"), [("SystemExit(143)", 143), ("SystemExit(0)", 2), ("BaseException('x')", 2)])
def test_what_an_effect_of_a_file_does_wrong_is_told_with_its_line_but_a_signal_is_no_fault_of_it(
    monkeypatch, capsys, tmp_path, what, code
):
    path, module = tmp_path / "mine.py", {}
    exec(compile(f"def law(*_):\n    raise {what}\n", path, "exec"), module)
    monkeypatch.setattr(plugin, "_loaded", {path: ()})
    monkeypatch.setattr("workbench.commands.effects.run", module["law"])
    assert main(["effects"]) == code  # that of a signal is as `entry.py` gives it
    error = capsys.readouterr().err
    assert error.startswith(f"pendulum-ident: {path}, line 2: {what[:9]}" if code == 2 else "")
    assert error.count("\n") == (code == 2)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("redirection", slow.but_first([">/dev/full", ">/dev/full 2>/dev/full"]))
def test_a_standard_output_that_is_full_is_told(redirection):
    done = run(redirection, "effects")
    assert done.returncode == 2
    if "2>" not in redirection:
        assert done.stderr == "pendulum-ident: standard output: No space left on device\n"


@pytest.mark.parametrize("what", slow.but_first(BEGUN))
def test_workers_end_with_a_command_that_is_killed_and_say_nothing(tmp_path, what):
    script = tmp_path / "begun.py"  # a file, as workers import it
    script.write_text(BEGUN[what])
    command = [sys.executable, script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "running\n"
        process.kill()
        assert "Traceback" not in process.communicate(timeout=PATIENCE)[1]  # ends when the last has closed the streams


def test_a_disk_without_room_is_told_and_nothing_is_left(tmp_path, capsys, recording):
    path = tmp_path / "model.json"
    with full_after(100):
        assert main(["identify", recording, "-o", str(path)]) == 2
    assert capsys.readouterr().err == f"pendulum-ident: {path}: File too large\n"
    assert [file.name for file in tmp_path.iterdir()] == ["run.csv"]
