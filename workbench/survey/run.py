"""The survey itself: cases go to Dask's workers, rows come back and are written as they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from pendulum_env._typing import JSON
from workbench.mistakes import InputError
from workbench.survey.cases import Case
from workbench.survey.dataset import Dataset
from workbench.survey.work import Look, Settings, examined, look, row_of, trouble

if TYPE_CHECKING:
    from distributed import Client

KNOWN = ("name", "status", "reason", "hash", "settings", "verdict", "report")
DIED = "its worker died, of too little memory perhaps: give workers more (--memory), or shorten the recording"


@dataclass
class Tally:
    """What became of the cases so far."""

    total: int = 0  # cases that this run was asked for
    known: Counter[str] = field(default_factory=Counter)  # by status, of cases that an earlier run looked at
    new: Counter[str] = field(default_factory=Counter)  # by status, of those that this run looked at
    troubles: list[tuple[str, str]] = field(default_factory=list)  # name and reason of each refused or failed

    @property
    def through(self) -> int:
        """Cases that are through."""
        return self.known.total() + self.new.total()

    def count(self, row: JSON, among: Counter[str]) -> None:
        """Count one more, among those that are known or new."""
        among[row["status"]] += 1
        if row["status"] != "done":
            self.troubles.append((row["name"], row["reason"]))


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

    Only names and findings travel: workers read the files themselves. However this ends, what was written stays, and
    the next run goes on from there.

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
    settings, tally, todo = settings or Settings(), Tally(len(cases)), []
    dataset.create()
    dataset.merge()  # what a run that was broken off has left
    known = {row["name"]: row for row in dataset.rows(KNOWN)}
    for case in cases:
        before = known.get(case.name)
        if before is not None and settings.is_answered(case, before):
            tally.count(before, tally.known)
        else:
            todo.append(case)
    tell(tally)
    for rows in _batches(todo, client, settings, look) if todo else ():
        dataset.append(rows)
        for row in rows:
            tally.count(row, tally.new)
            tell(tally)
    dataset.merge()
    return tally


def _batches(
    todo: Sequence[Case], client: Client | Callable[[], Client], settings: Settings, look: Look
) -> Iterator[list[JSON]]:
    """Rows of cases as workers finish them, all that there are by then; what is left in the end is called back.

    What a worker does not survive, Dask gives to another, and in the end blames all that its workers had when they
    died. So each of these is tried once more, alone.
    """
    from distributed import Client, KilledWorker, as_completed

    client = client if isinstance(client, Client) else client()
    work = partial(examined, settings=settings, look=look)
    # Dask warns of a message with more cases, which is large
    futures = dict(zip(client.map(work, todo, pure=False, batch_size=1000), todo, strict=True))
    suspects = []
    try:
        for batch in as_completed(list(futures)).batches():
            rows = []
            for future in batch:
                case = futures.pop(future)
                if future.status == "finished":
                    rows.append(future.result())
                elif future.status != "error":
                    raise InputError("the cluster has gone: what was written stays, run again to go on")
                elif len(todo) > 1:
                    suspects.append(case)
                else:
                    error = future.exception()
                    error = OSError(DIED) if isinstance(error, KilledWorker) else error
                    rows.append(row_of(case, settings) | trouble(error, case))
            if rows:
                yield rows
    finally:
        client.cancel(list(futures), force=True)
    for case in suspects:
        yield from _batches([case], client, settings, look)
