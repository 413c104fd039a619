"""Where work on many cases is done: in processes of this computer, or on a Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING

from workbench.mistakes import InputError
from workbench.processes import attend, interrupts_wait

if TYPE_CHECKING:
    from distributed import Client, Worker


@contextmanager
def connected(address: str | None, workers: int, memory: float | None = None) -> Iterator[Client]:
    """Client of the cluster at an address, or of one that lives as long as this: no process is left behind.

    Args:
        address: of a scheduler, as `tcp://host:8786`; None starts processes here.
        workers: number of processes to start here.
        memory: that each of them may take [MB]; an equal share of this computer's if it is not given.

    Raises InputError if Dask is not installed, or there is no such cluster.
    """
    if find_spec("distributed") is None:
        raise InputError("several processes need Dask, of the extra fleet: pip install 'pendulum-ident[fleet]'")
    import dask
    from distributed import Client
    from distributed.utils import silence_logging_cmgr

    if address is not None:
        try:
            client = Client(address, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(f"there is no Dask cluster at {address}: {error}") from None
        with silence_logging_cmgr(logging.CRITICAL), client:
            yield client
        return
    with dask.config.set({"distributed.worker.profile.enabled": False}):  # 200 MB in each that nobody looks at
        with interrupts_wait():  # a cluster that is half begun cannot be closed
            client = Client(
                n_workers=workers,
                threads_per_worker=1,  # the work computes in Python most of the time
                memory_limit="auto" if memory is None else int(1e6 * memory),
                preload="workbench.cluster",
                dashboard_address="127.0.0.1:0",  # for nobody else, and beside other clusters
                silence_logs=logging.CRITICAL,  # what went wrong is told by who asked for the work
            )
        with client:
            yield client


def dask_setup(worker: Worker) -> None:
    """Called by Dask in each worker that is begun here: Ctrl-C is left to the command, which ends its workers."""
    attend()
