"""Run of a survey in worker processes, with a cache of results.

The file name of a result is a hash of the recording's content and the settings. A later run reuses it, even if the
recording was moved. Failed recordings are not cached.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pendulum_env._typing import JSON
from pendulum_env.files import format_json, write_whole
from pendulum_env.recording import Source
from pendulum_env.settings import use_writer
from workbench.errors import InputError, write_option
from workbench.survey.diagnosis import Settings, describe_error, diagnose_source, hash_content, read_result
from workbench.survey.recordings import SurveyedRecording
from workbench.survey.table import label_rows

RESULTS = "recordings"  # folder of the results
DIED = "its worker process was killed: memory may be too small, give fewer --workers or a shorter recording"

Task = Callable[[Source, Settings], JSON]  # as `diagnose_source`, picklable
Start = Callable[[int], AbstractContextManager[Executor]]  # starts a number of workers


def run_survey(
    recordings: Sequence[SurveyedRecording],
    settings: Settings,
    output: Path,
    start: Start,
    workers: int,
    report_progress: Callable[[int, int], None] = lambda completed, total: None,
    task: Task = diagnose_source,
) -> list[JSON]:
    """Diagnose every recording without a result, and return the rows of all recordings, see `label_rows`.

    Results stay in the folder `output`, also after an error. `report_progress` is called with the numbers of
    finished and of all recordings. Raises OSError if a result cannot be written, and InputError if the cluster is lost.
    """
    (output / RESULTS).mkdir(parents=True, exist_ok=True)
    hashes = [hash_content(recording.source.file) for recording in recordings]
    keys = [settings.make_key(recording.source, content) for recording, content in zip(recordings, hashes, strict=True)]
    files = [output / RESULTS / f"{key}.json" for key in keys]
    # by index in `recordings`, as names are not unique
    results: dict[int, JSON] = {k: kept for k, file in enumerate(files) if (kept := read_result(file)) is not None}
    report_progress(len(results), len(recordings))

    def keep(k: int, result: JSON) -> None:
        if "error" not in result and hashes[k] is not None:
            write_whole(files[k], format_json(result))
        results[k] = result
        report_progress(len(results), len(recordings))

    todo = {k: recording.source for k, recording in enumerate(recordings) if k not in results}
    _diagnose_all(todo, settings, start, workers, task, keep)
    return [row for k, recording in enumerate(recordings) for row in label_rows(recording, results[k], hashes[k])]


def _diagnose_all(
    todo: Mapping[int, Source],
    settings: Settings,
    start: Start,
    workers: int,
    task: Task,
    keep: Callable[[int, JSON], None],
) -> None:
    """Diagnose recordings, and pass each result to `keep`.

    A killed worker ends the whole pool. The unfinished recordings then run one by one: the first without a result is
    the cause and gets an error; the others run in parallel again.
    """
    count = workers
    while todo:
        completed = set()
        with start(count) as executor:
            futures = {}
            with suppress(BrokenExecutor):  # a worker was killed during submission
                for k, source in todo.items():
                    futures[executor.submit(task, source, settings)] = k
            for future in as_completed(futures):
                k = futures[future]
                try:
                    result = future.result()
                except BrokenExecutor:
                    continue
                except CancelledError:
                    raise InputError("the Dask cluster is lost: results are kept, run again to continue") from None
                except Exception as error:  # Dask raises its own error for a killed worker
                    result = {"error": describe_error(error, todo[k])}
                keep(k, result)
                completed.add(k)
        todo = {k: source for k, source in todo.items() if k not in completed}
        if todo and count == 1:
            killer, *remaining = todo
            keep(killer, {"error": DIED})
            todo, count = {k: todo[k] for k in remaining}, workers
        else:
            count = 1


@contextmanager
def open_cluster(address: str) -> Iterator[Executor]:
    """Connect to the Dask scheduler at an address; its workers need the files under the same paths.

    Raises InputError if Dask is not installed, or the scheduler cannot be reached.
    """
    if find_spec("distributed") is None:
        raise InputError("--scheduler needs Dask, of the extra fleet: pip install 'pendulum-ident[fleet]'")
    distributed: Any = import_module("distributed")  # slow to import
    try:
        client = distributed.Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise InputError(f"there is no Dask cluster at {address}: {error}") from None
    with client:
        client.run(use_writer, write_option)  # messages name options
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)
