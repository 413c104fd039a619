"""Work in other processes."""

import functools
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

from estimators.progress import Progress
from pendulum_env.physics import plugin
from tests.patience import PATIENCE, wait_until
from tests.pendulum_env.physics.test_limits import PLUGIN
from workbench import processes
from workbench.errors import InputError
from workbench.processes import LOST, Job, TaskEnd, Workers, open_local_workers


def count(to: int, tell: Progress) -> int:
    for k in range(to):
        tell(f"step {k}", k / to)
    return to


def refuse(tell: Progress) -> None:
    raise InputError("the data are too few")


def sleep(tell: Progress) -> None:
    tell("sleeping", 0.2)
    time.sleep(3600)


def vanish(tell: Progress) -> None:
    os.kill(os.getpid(), signal.SIGTERM)  # also Windows knows it


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workers]:
    monkeypatch.setattr(processes, "LIBRARIES", ())  # which take a second to load, and none of these tasks needs
    workers = Workers()
    yield workers
    workers.close()


class Witness:
    """A job and what came of it."""

    def __init__(self, task: Any, workers: Workers) -> None:
        self.outcome: list[TaskEnd] = []
        self.job = Job("a job", task, workers, lambda _, word: self.outcome.append(word))

    def wait(self) -> TaskEnd:
        assert self.job.over.wait(PATIENCE)
        assert not self.job.running
        return self.outcome[0]


def test_a_job_ends_with_its_result_or_with_a_sentence(workers):
    workers.warm()
    first = Witness(functools.partial(count, 3), workers)
    assert first.wait() == TaskEnd(3) and first.job.what == "step 2"
    assert Witness(refuse, workers).wait() == TaskEnd(why="the data are too few")
    assert Witness(vanish, workers).wait() == TaskEnd(why=LOST)
    workers.warm()
    assert workers._spare is not None
    workers._spare.process.kill()  # nor is one that dies while it waits any trouble
    workers._spare.process.join()
    assert Witness(functools.partial(count, 1), workers).wait() == TaskEnd(1)


def test_a_cancelled_job_ends_at_once_and_comes_to_nothing(workers):
    witness = Witness(sleep, workers)
    wait_until(lambda: witness.job.what == "sleeping")
    witness.job.cancel()
    assert not witness.job.running and witness.outcome == []
    wait_until(lambda: not witness.job._worker.process.is_alive())


def test_local_workers_end_in_the_middle_of_a_task():
    with pytest.raises(KeyboardInterrupt), open_local_workers(1) as executor:
        assert executor.submit(abs, -1).result(PATIENCE) == 1
        late = executor.submit(time.sleep, 2 * PATIENCE)
        raise KeyboardInterrupt
    wait_until(late.done)


@pytest.mark.slow
def test_a_file_of_effects_that_has_gone_is_told(tmp_path, monkeypatch, workers):
    file = tmp_path / "gone.py"
    monkeypatch.setattr(plugin, "_loaded", {file: ()})
    told = Witness(functools.partial(count, 1), workers).wait()
    assert told.why.startswith(f"{file}: ")
    file.write_text(PLUGIN)
    workers.close()  # also the one that waits, and has read what was there
    assert Witness(functools.partial(count, 1), workers).wait() == TaskEnd(1)
