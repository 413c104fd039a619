"""Work in other processes."""

import functools
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from estimators.progress import Progress
from pendulum_env.physics import plugin
from tests.patience import PATIENCE, wait_until
from tests.pendulum_env.physics.test_limits import PLUGIN
from workbench.app import jobs
from workbench.app.jobs import LOST, Job, Workers
from workbench.errors import InputError
from workbench.processes import open_local_workers


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


def give_what_does_not_travel(tell: Progress) -> Any:
    return lambda: None


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workers]:
    monkeypatch.setattr(jobs, "LIBRARIES", ())  # which take a second to load, and none of these tasks needs
    workers = Workers()
    yield workers
    workers.close()


def begin(task: Any, workers: Workers, ended: Callable[[Job], None] = lambda job: None) -> Job:
    job = Job("a job", task, workers)
    job.call_at_end(ended)
    return job


def wait(job: Job) -> Any:
    assert job.over.wait(PATIENCE) and not job.running
    return job.result


def test_a_job_ends_with_its_result_or_with_a_sentence(workers):
    workers.start_spare()
    first = begin(functools.partial(count, 3), workers)
    assert wait(first) == 3 and first.progress[0] == "step 2"
    with pytest.raises(InputError, match="the data are too few"):
        wait(begin(refuse, workers))
    for task in (vanish, lambda tell: None, give_what_does_not_travel):  # nor is the next one any trouble
        with pytest.raises(InputError, match=LOST):
            wait(begin(task, workers))
        assert wait(begin(functools.partial(count, 1), workers)) == 1


def test_a_cancelled_job_ends_at_once_and_comes_to_nothing(workers):
    ended = []
    job = begin(sleep, workers, ended.append)
    wait_until(lambda: job.progress[0] == "sleeping")
    children = multiprocessing.active_children()
    job.cancel()
    wait_until(lambda: any(not child.is_alive() for child in children))
    assert not job.running and ended == []
    assert wait(begin(functools.partial(count, 2), workers)) == 2


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
    with pytest.raises(InputError, match=str(file)):
        wait(begin(functools.partial(count, 1), workers))
    file.write_text(PLUGIN)
    workers.close()  # also the one that waits, and has read what was there
    assert wait(begin(functools.partial(count, 1), workers)) == 1
