"""Files and requests that nobody meant: a minute of what `make fuzz` does at length, and all that it has ever found."""

import hashlib
import os
import shutil
import signal
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pendulum_env.arms import read_body
from pendulum_env.recording import read_recording
from tests import slow
from tests.fuzzing import ALL, CORPUS, Page, ask_anything, chains, changed, check, good, rows, shown, surveyed

for module in ("dash", "distributed", "h5py", "pinocchio", "python_calamine", "rosbags"):
    pytest.importorskip(module)

LONG = [CORPUS / "recording-last-row.ods", CORPUS / "recording-rows.ods"]  # of a million rows and more
FOUND = sorted(CORPUS.glob("*-*"))
MANY = int(os.environ.get("FUZZ", 0))  # examples of each kind, others each time; else a few, always the same
HANG = 10  # [s] that a reader may take, where there are many


def examples(few: int) -> settings:
    return settings(
        max_examples=MANY or few,
        derandomize=not MANY,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


@pytest.mark.parametrize(
    "path", slow.but([path for path in FOUND if path not in LONG], FOUND), ids=lambda path: path.name
)
def test_what_was_found_before_is_read_or_refused_in_one_sentence(path):
    name = path.name.partition("-")[0]
    readers = {known: read for known, (_, read, _) in ALL.items()}
    check(readers.get(name) or readers.get(f"{name}{path.suffix}", read_recording), path)


@contextmanager
def in_time():
    """Fail where a reader hangs, if there are many examples."""

    def fail(*_):
        raise AssertionError(f"it takes more than {HANG} s to read")  # the signal itself would keep no file

    before = signal.signal(signal.SIGALRM, fail) if MANY else None
    signal.alarm(HANG if MANY else 0)
    try:
        yield
    finally:
        signal.alarm(0)
        if MANY:
            signal.signal(signal.SIGALRM, before)


@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@pytest.mark.parametrize("name", ALL)
def test_files_that_were_changed_are_read_or_refused_in_one_sentence(name, tmp_path_factory):
    ending, read, _ = ALL[name]
    path = tmp_path_factory.getbasetemp() / f"fuzz-{os.getpid()}{ending}"

    @examples(15)
    @given(content=changed(good(name)))
    def each(content):
        path.write_bytes(content)
        with in_time():
            check(read, path)

    path.write_bytes(good(name))
    assert read(path) is not None
    try:
        each()
    except BaseException:
        if MANY:  # keep the shortest
            digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
            shutil.copy(path, CORPUS / f"{name.partition('.')[0]}-{digest}{ending}")
        raise


def test_chains_of_joints_are_read_or_refused_in_one_sentence(tmp_path_factory):
    stem = tmp_path_factory.getbasetemp() / f"chain-{os.getpid()}"

    @examples(30)
    @given(made=chains())
    def each(made):
        ending, content = made
        path = stem.with_suffix(ending)
        path.write_bytes(content)
        with in_time():
            check(read_body, path)

    each()


def test_whatever_rows_a_dataset_holds_the_fleets_page_shows_them():
    @examples(15)
    @given(made=rows())
    def each(made):
        with surveyed() as dataset:
            dataset.append(made)
            assert shown(dataset)

    each()


def test_whatever_the_page_asks_for_it_gets_an_answer():
    page = Page()
    try:
        examples(60)(given(data=st.data())(lambda data: ask_anything(page, data)))()
    finally:
        page.close()
