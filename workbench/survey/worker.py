"""What Dask runs as a local worker starts."""

from __future__ import annotations

from distributed import Worker

from workbench.processes import attend


def dask_setup(worker: Worker) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the survey, which ends its workers itself."""
    attend()
