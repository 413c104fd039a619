"""`survey`: diagnose each recording in a folder, and write one table with the changes of parameters."""

import argparse
from pathlib import Path

from estimators.arguments import apply_limits, select_effects
from pendulum_env.physics.joints import list_base_terms
from workbench import options
from workbench.errors import InputError, Interrupted
from workbench.inputs import make_body, read_model
from workbench.outputs import report_files
from workbench.processes import open_local_workers
from workbench.survey.diagnosis import Settings
from workbench.survey.recordings import TABLES, find_recordings
from workbench.survey.run import open_cluster, run_survey
from workbench.survey.table import find_series, tabulate_changes, tabulate_recordings, write_table
from workbench.terminal import Terminal

FILE_SUFFIXES = (".html", ".json", ".csv", ".parquet")
PRINTED = 20  # largest number of printed rows


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the folder, options of the diagnoses, and outputs."""
    parser.add_argument(
        "folder",
        metavar="FOLDER",
        help="recordings in it and below it, each diagnosed on its own; the recordings of one folder are of one "
        "machine; a study.toml says how those that it names are read",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        required=True,
        help="folder of the table, survey.parquet and survey.csv; run again to continue",
    )
    options.declare(parser, "--workers")
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="scheduler of a Dask cluster to use instead, as tcp://host:8786 (needs the extra fleet); its workers see "
        "the same files",
    )
    options.declare(parser, *options.READING, "--drive", *options.SEARCH, *options.LIMITS)
    options.add_robot(parser, pendulums=["drive"])


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose recordings without a result, write the table, and print the changes."""
    folder, output = Path(arguments.folder), Path(arguments.output)
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file: name a folder for the table")
    if output.suffix in FILE_SUFFIXES and not output.is_dir():
        raise InputError(f"{output}: is the name of a file: name a folder, which gets survey.csv and survey.parquet")
    _check_options(arguments)
    settings, files = Settings.from_arguments(arguments), find_recordings(folder, arguments)
    start = open_local_workers if arguments.scheduler is None else lambda _: open_cluster(arguments.scheduler)
    counts = []
    with terminal.progress("diagnosing") as progress:

        def show_progress(completed: int, total: int) -> None:
            counts.append(completed)
            progress(f"{completed} of {total}", completed / total)

        try:
            rows = run_survey(files, settings, output, start, arguments.workers, show_progress)
        except KeyboardInterrupt:
            raise Interrupted(f"results are kept in {output}: run again to continue") from None
    n_known, machines = counts[0], len({recording.machine for recording in files})
    failed = sum("error" in row for row in rows)
    terminal.print(
        f"{len(files)} recording{'s' * (len(files) != 1)} of {machines} machine{'s' * (machines != 1)}: {n_known} "
        f"known from before, {len(files) - n_known - failed} diagnosed, {failed} failed"
    )
    series = find_series(rows)
    for estimate_series in series:
        estimate_series.mark_changes()
    write_table(output, rows)
    recordings, changes = tabulate_recordings(rows), tabulate_changes(series)
    terminal.print_heading("Recordings")
    terminal.print_table(recordings.headers, recordings.rows[:PRINTED], recordings.left)
    if len(rows) > PRINTED:
        terminal.print(f"and {len(rows) - PRINTED} more in {output / TABLES[1]}")
    terminal.print_heading("Parameters that change")
    terminal.print_table(*changes) if changes.rows else terminal.print("none")
    report_files([output / name for name in TABLES], terminal)
    if failed == len(rows):
        raise InputError(f"{folder}: no recording could be diagnosed: the table has the reasons")


def _check_options(arguments: argparse.Namespace) -> None:
    """Raise an error for options that would fail for every recording."""
    body = make_body(arguments)
    base = read_model(arguments.model, body).terms if arguments.model else list_base_terms(body)
    effects = select_effects(None, arguments.only, arguments.without, body)
    apply_limits(base, effects, arguments.fixed, arguments.bounds)
