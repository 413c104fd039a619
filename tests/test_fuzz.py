"""A minute of what `make fuzz` does for an hour, and all that it has ever found."""

import os

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pendulum_env.recording import read_recording
from tests.fuzzing import ALL, CORPUS, Page, ask_anything, changed, check, good

for module in ("dash", "h5py", "pinocchio", "python_calamine", "rosbags"):
    pytest.importorskip(module)

FOUND = sorted(CORPUS.glob("*-*"))


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_what_was_found_before_is_read_or_refused_in_one_sentence(path):
    name = path.name.partition("-")[0]
    readers = {known: read for known, (_, read, _) in ALL.items()}
    check(readers.get(name) or readers.get(f"{name}{path.suffix}", read_recording), path)


@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@pytest.mark.parametrize("name", ALL)
def test_files_that_were_changed_are_read_or_refused_in_one_sentence(name, tmp_path_factory):
    ending, read, _ = ALL[name]
    path = tmp_path_factory.getbasetemp() / f"fuzz-{os.getpid()}{ending}"

    @settings(max_examples=25, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(content=changed(good(name)))
    def each(content):
        path.write_bytes(content)
        check(read, path)

    path.write_bytes(good(name))
    assert read(path) is not None
    each()


def test_whatever_the_page_asks_for_it_gets_an_answer():
    page = Page()

    @settings(max_examples=60, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(data=st.data())
    def each(data):
        ask_anything(page, data)

    try:
        each()
    finally:
        page.close()
