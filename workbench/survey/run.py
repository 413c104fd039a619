"""The survey itself: cases go to Dask's workers, rows come back and are written as they come."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

from pendulum_env._typing import JSON
from workbench.mistakes import InputError, sentence
from workbench.survey.cases import Case
from workbench.survey.dataset import CROWD, Dataset, Row
from workbench.survey.work import Look, Settings, examined, look, lost, stamp, version

if TYPE_CHECKING:
    from distributed import Client, Future

Todo = tuple[Case, str | None]  # a case, and the hash of the content that is known of it

AHEAD = 4  # cases for each thread that are with the cluster at a time: none waits, and Ctrl-C has little to call back
BATCH = 200  # rows in one file of the dataset at most
WAIT = 1.0  # [s] until rows are written: what a killed survey loses at most
POLL = 0.02  # [s] between two looks whether a case is through
UNWRITTEN = 2000  # rows that are kept while the disk is full; some ten kB each
DIED = "its worker died, of too little memory perhaps: give workers more (--memory), or shorten the recording"


@dataclass
class Tally:
    """What became of the cases so far.

    Attributes:
        total: cases that this run was asked for.
        unchanged: those that an earlier run had done.
        refused_before: those of them that it had refused.
        done, refused, failed: those of this run.
        troubles: name and reason of each that was refused or failed in this run, or refused before and is as it was.
    """

    total: int = 0
    unchanged: int = 0
    refused_before: int = 0
    done: int = 0
    refused: int = 0
    failed: int = 0
    troubles: list[tuple[str, str]] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Share of the cases that are through."""
        return self.through / self.total if self.total else 1.0

    @property
    def through(self) -> int:
        """Cases that are through."""
        return self.unchanged + self.done + self.refused + self.failed

    def count(self, row: Row | None) -> None:
        """Count one more."""
        status = "unchanged" if row is None else str(row["status"])
        setattr(self, status, getattr(self, status) + 1)
        if row is not None and status != "done":
            self._name(row)

    def count_known(self, row: Row) -> None:
        """Count one that an earlier run had done."""
        self.unchanged += 1
        if row["status"] == "refused":
            self.refused_before += 1
            self._name(row)

    def _name(self, row: Row) -> None:
        self.troubles.append((str(row["name"]), str(row["reason"])))


def survey(
    cases: Sequence[Case],
    dataset: Dataset,
    client: Client | Callable[[], Client],
    settings: Settings | None = None,
    *,
    look: Look = look,
    tell: Callable[[Tally], None] = lambda tally: None,
) -> Tally:
    """Look at every case that is new or changed, and keep what is found.

    Only names and findings travel: workers read the files themselves. What a worker does not survive, Dask gives to
    another; what none survives is marked as failed. However this ends, what was written stays, and the next run goes
    on from there.

    Args:
        cases: to look at.
        dataset: where rows go.
        client: of the Dask cluster, or what makes one: called only if there is something to do.
        settings: of the diagnoses.
        look: what is done with a case; a diagnosis.
        tell: called after each case with the tally so far.

    Raises:
        InputError: if the cluster is lost.
        OSError: if rows cannot be written.
    """
    settings = settings or Settings()
    dataset.create()
    tally, writer = Tally(len(cases)), Writer(dataset)
    todo = _todo(cases, _known(dataset), settings, tally)
    tell(tally)
    try:
        for row in _rows(todo, client, settings, look, writer.flush) if todo else ():
            tally.count(row)
            if row is not None:
                writer.add(row)
            tell(tally)
    finally:
        writer.close()
    dataset.merge()
    return tally


def _known(dataset: Dataset) -> dict[str, JSON]:
    """What the dataset knows of each case, as far as it decides whether it is new or changed."""
    columns = ("name", "status", "reason", "hash", "size", "changed", "version", "settings", "verdict", "report")
    return {row["name"]: row for row in dataset.rows([*columns, "robot", "joint", "kind", "date"])}


def _todo(cases: Sequence[Case], known: dict[str, JSON], settings: Settings, tally: Tally) -> list[Todo]:
    """Cases that are not known to be as they were, each with the hash of the content that it had."""
    waiting: list[Todo] = []
    for case in cases:
        before = known.get(case.name)
        if before is None or not _same_question(case, before, settings):
            waiting.append((case, None))
        elif not _same_file(case.source.file, before):
            waiting.append((case, before["hash"]))
        else:
            tally.count_known(before)
    return waiting


def _same_question(case: Case, before: JSON, settings: Settings) -> bool:
    """Whether a case was looked at by this version as it would be now, and is not to be tried again."""
    page = before["report"] is not None or not settings.asks_for_page(before["verdict"])
    return (
        before["status"] in ("done", "refused")
        and (before["version"], before["settings"]) == (version(), settings.mark(case))
        and (page or before["status"] == "refused")
        and all(before[label] == getattr(case, label) for label in ("robot", "joint", "kind", "date"))
    )


def _same_file(file: Path, before: JSON) -> bool:
    """Whether a file has the size and time that it had; where it does not, its content tells."""
    try:
        return all(before[name] == value for name, value in stamp(file).items())
    except OSError:
        return before["hash"] is None


def _rows(
    todo: Sequence[Todo],
    client: Client | Callable[[], Client],
    settings: Settings,
    look: Look,
    idle: Callable[[], None],
) -> Iterator[Row | None]:
    """Rows as workers finish them; `idle` is called while none has."""
    from distributed import Client, KilledWorker

    client = client if isinstance(client, Client) else client()
    suspects: list[Todo] = []
    for (case, known), future in _finished(iter(todo), client, settings, look, idle):
        if future.status == "error" and isinstance(future.exception(), KilledWorker):
            suspects.append((case, known))
        else:
            yield _row(future, case, settings)
    for one in suspects:  # alone: a worker's death is blamed on all that it had
        for (case, _), future in _finished(iter([one]), client, settings, look, idle):
            yield _row(future, case, settings)


def _finished(
    todo: Iterator[Todo], client: Client, settings: Settings, look: Look, idle: Callable[[], None]
) -> Iterator[tuple[Todo, Future[Any]]]:
    """Cases with their futures as these finish, a few for each thread with the cluster at a time."""
    from distributed import as_completed

    waiting: dict[Any, Todo] = {}  # by the key of the future

    def submit(count: int) -> list[Future[Any]]:
        futures = []
        for case, known in islice(todo, count):
            future = client.submit(examined, case, settings, known, look, pure=False)
            waiting[future.key] = case, known
            futures.append(future)
        return futures

    running = as_completed(submit(AHEAD * _threads(client)))
    try:
        while waiting:
            while not running.has_ready():
                idle()
                sleep(POLL)
            for future in running.next_batch(block=False):
                yield waiting.pop(future.key), future
                future.release()
            for future in submit(max(0, AHEAD * _threads(client) - len(waiting))):
                running.add(future)
    finally:
        client.cancel(list(running.futures), force=True)


def _threads(client: Client) -> int:
    """Threads of the cluster, which may grow and shrink."""
    return max(1, sum(client.nthreads().values()))


def _row(future: Future[Any], case: Case, settings: Settings) -> Row | None:
    """Row of a case from its future; raises InputError if the cluster has gone."""
    from distributed import KilledWorker

    if future.status == "finished":
        found: Row | None = future.result()
        return found
    if future.status != "error":
        raise InputError("the cluster has gone: what was written stays, run again to go on")
    error = future.exception()
    reason = DIED if isinstance(error, KilledWorker) else f"{type(error).__name__}: {error}"
    return lost(case, settings, sentence(ValueError(reason)))


class Writer:
    """Writes rows in batches; where the disk is full, it keeps some and tries again."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.rows: list[Row] = []
        self._written = monotonic()
        self._merges = True  # until that fails once: it would take its time again after every file

    def add(self, row: Row) -> None:
        """Take a row, and write what has come together.

        Raises:
            OSError: if nothing could be written for long.
        """
        self.rows.append(row)
        if len(self.rows) >= BATCH:
            self._write()
        else:
            self.flush()

    def flush(self) -> None:
        """Write what has waited long enough."""
        if self.rows and monotonic() - self._written > WAIT:
            self._write()

    def _write(self, last: bool = False) -> None:
        self._written = monotonic()
        try:
            self.dataset.append(self.rows)
            self.rows = []
        except OSError as error:
            if last or len(self.rows) >= UNWRITTEN:
                what = f"{sentence(error)}: {len(self.rows)} cases are not kept: make room and run again"
                raise InputError(f"{self.dataset.folder}: {what}") from error
        else:
            self._merges = self._merges and self.dataset.merge(CROWD)

    def close(self) -> None:
        """Write what is left.

        Raises:
            InputError: if it cannot be written.
        """
        self._write(last=True)


def watch(
    find: Callable[[], Sequence[Case]],
    work: Callable[[Sequence[Case]], Any],
    every: float,
    wait: Callable[[float], None] = sleep,
) -> None:
    """Look for new files again and again, until interrupted; a file that still grows waits until it has come to rest.

    Args:
        find: which cases there are.
        work: what is done with those that have come to rest; it passes over what it knows.
        every: seconds between two looks.
        wait: for so many seconds.
    """
    seen: dict[str, object] = {}
    handed: dict[str, object] = {}
    while True:
        now = {case.name: (case, _stamp(case)) for case in find()}
        still = {name: at for name, (_, at) in now.items() if seen.get(name) == at}
        if any(handed.get(name) != at for name, at in still.items()):
            work([case for name, (case, _) in now.items() if name in still])
            handed = still
        seen = {name: at for name, (_, at) in now.items()}
        wait(every)


def _stamp(case: Case) -> object:
    try:
        return tuple(stamp(case.source.file).values())
    except OSError:
        return None
