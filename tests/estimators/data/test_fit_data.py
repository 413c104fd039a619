"""Preprocessing: what was done to recordings is kept with them, and can be done again."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimators import align
from estimators.checks.homogeneity import Disagreement
from estimators.data.fit_data import FitData
from estimators.decisions.criterion import Criterion, TimingLimits
from estimators.weak_form.contacts import count_contacts
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording, write_recording
from tests.cases import recording

LATE = 4  # samples


def late(good: Recording) -> Recording:
    torque = np.r_[np.full(LATE, good.torque[0]), good.torque[:-LATE]]
    return replace(good, name=f"{good.name}, late", torque=torque)


@cache
def mixed() -> FitData:
    """A recording in time, and one whose torque was logged late."""
    good = recording("moving")
    return FitData.from_recordings([good, late(good)]).with_timing()


def test_each_recording_is_timed_by_itself_where_they_differ():
    in_time, behind = mixed().timing.alignments
    assert not in_time.is_found and behind.delay == pytest.approx(LATE / mixed().recordings[1].rate, rel=0.05)
    (finding,) = mixed().timing.find(is_late=True)
    assert finding.recordings == ("moving, late",) and finding.is_late and not finding.is_corrected


def test_held_out_recordings_tell_the_timing_of_the_log_too():
    good = recording("moving")
    still = late(good).slice(0, 400)  # too short to tell
    assert not FitData.from_recordings([still]).with_timing().timing.has_moved
    assert all(one.is_late for one in FitData.from_recordings([still], [late(good)]).with_timing().timing.alignments)


def test_align_corrects_recordings_and_files_as_a_diagnosis_does(tmp_path):
    good = recording("moving")
    write_recording(late(good), tmp_path / "late.csv")
    for given in ([late(good), late(good.slice(0, 4000))], str(tmp_path / "late.csv")):
        found = align(given)
        assert all(law.delay == pytest.approx(LATE / good.rate, rel=0.05) for law in found.alignments)
        assert [finding.is_corrected for finding in found.findings] == [True] and "late" in str(found)
        error = np.abs(found.recordings[0].torque - good.torque[: len(found.recordings[0])])
        assert error.max() < 0.05 * np.abs(late(good).torque - good.torque).max()
    assert str(align(good)) == "Torque and motion are in time."


def test_a_stricter_criterion_needs_clearer_evidence_of_late_torque():
    criterion = Criterion(timing=TimingLimits(z_score=1e3))
    logged = FitData.from_recordings([late(recording("moving"))], criterion=criterion)
    assert not logged.with_timing().timing.has_delay
    assert logged.parts[0].recordings == logged.recordings


def test_what_is_said_of_recordings_goes_with_them_when_others_are_left_out():
    assert mixed().without_outliers([]) is mixed()
    first, second = (Disagreement(number, "", (), ()) for number in (1, 2))
    left = mixed().without_outliers([second])
    assert left.timing.find(is_late=True) == () and not left.timing.has_moved
    assert mixed().without_outliers([first]).timing.find(is_late=True)[0].recordings == ()


def test_data_that_come_from_another_process_are_prepared_again_alike():
    data = FitData.from_recordings([recording("bouncing")]).with_contacts(BASE)
    again = pickle.loads(pickle.dumps(data))
    assert count_contacts(data.parts[0].data) >= 2
    for one, other in zip(data.parts, again.parts, strict=True):
        np.testing.assert_array_equal(one.data.torque.recorded, other.data.torque.recorded)
        assert count_contacts(one.data) == count_contacts(other.data)
