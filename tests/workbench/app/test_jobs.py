"""Work in other processes."""

import functools
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from estimators.progress import Progress, forward, no_progress
from pendulum_env.physics import plugin
from pendulum_env.reading import room_for
from tests.patience import PATIENCE, wait_until
from workbench.app.jobs import LOST, Job, Pace, Workers
from workbench.mistakes import InputError

PLUGIN = '''
from dataclasses import dataclass
from pendulum_env.physics import Column, Term, register


@register
@dataclass(frozen=True)
class OfAFile(Term):
    """Damping that grows with the cube of the speed."""

    id, law, kind = "of_a_file", "c q'^3", "dissipative"

    @property
    def columns(self):
        return (Column("of_a_file", "N m s^3/rad^3", force=lambda x: x.velocity**3),)
'''


def count(to: int, tell: Progress) -> int:
    for k in range(to):
        tell(f"step {k}", k / to)
    return to


def refuse(tell: Progress) -> None:
    raise InputError("the data are too few")


def sleep(tell: Progress) -> None:
    tell("sleeping", 0.2)
    time.sleep(3600)


def longest_file(tell: Progress) -> int:
    import resource

    return resource.getrlimit(resource.RLIMIT_FSIZE)[0]


def vanish(tell: Progress) -> None:
    raise SystemExit


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    workers = Workers()
    workers.warm()
    yield workers
    workers.close()


class Witness:
    """A job and what came of it."""

    def __init__(self, task: Any, workers: Workers) -> None:
        self.outcome: list[Any] = []
        self.job = Job("a job", task, workers, lambda _, result: self.outcome.append(result), self._failed)
        self.job.start()

    def _failed(self, _: Job, why: str) -> None:
        self.outcome.append(why)

    def wait(self) -> Any:
        assert self.job.over.wait(PATIENCE)
        assert not self.job.running
        return self.outcome[0]


def test_a_worker_does_one_task_after_the_other(workers: Workers) -> None:
    first = Witness(functools.partial(count, 3), workers)
    assert first.wait() == 3
    assert first.job.pace.what == "step 2"
    assert Witness(refuse, workers).wait() == "the data are too few"
    assert Witness(functools.partial(count, 2), workers).wait() == 2


def test_a_cancelled_job_ends_at_once_and_comes_to_nothing(workers: Workers) -> None:
    witness = Witness(sleep, workers)
    wait_until(lambda: witness.job.pace.what == "sleeping")
    witness.job.cancel()
    assert not witness.job.running and witness.outcome == []
    assert Witness(functools.partial(count, 1), workers).wait() == 1  # another takes its place


@pytest.mark.slow
def test_a_file_of_effects_that_has_gone_is_told_and_the_worker_lives_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "gone.py"
    monkeypatch.setattr(plugin, "_loaded", {file: ()})
    workers = Workers()
    workers.warm()
    assert str(Witness(functools.partial(count, 1), workers).wait()).startswith(f"{file}: ")
    file.write_text(PLUGIN)
    assert Witness(functools.partial(count, 1), workers).wait() == 1
    workers.close()


def test_a_worker_that_dies_is_told(workers: Workers) -> None:
    assert Witness(vanish, workers).wait() == LOST[1]


def test_progress_never_falls_though_a_search_starts_over() -> None:
    pace = Pace()
    assert pace.left is None
    shares, tell = [], forward(pace.tell)
    for _ in range(3):
        for k in range(10):
            tell(f"effect {k}", k / 10)
            shares.append(pace.share)
    assert shares == sorted(shares) and 0.4 < shares[9] <= 0.5 < shares[-1] < 1
    assert pace.left is not None and pace.left >= 0


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_a_worker_that_is_begun_while_a_file_is_read_has_none_of_its_limits() -> None:
    workers, results = Workers(), []
    job = Job("", longest_file, workers, lambda job, result: results.append(result), lambda job, why: None)
    before = longest_file(no_progress)
    with room_for(1e9):
        assert longest_file(no_progress) == 1e9
        starting = Thread(target=job.start)
        starting.start()
        starting.join(0.3)
    starting.join(PATIENCE)
    assert job.over.wait(PATIENCE)
    workers.close()
    assert results == [before]
