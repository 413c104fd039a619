"""Results that several tests share are made once."""

import pickle

from estimators import diagnose
from tests import cases, once


def test_a_recording_asks_for_the_same_result_before_and_after_it_is_used():
    recording = cases.recording("brief")
    before, copy = once._hash([recording]), pickle.loads(pickle.dumps(recording))
    diagnose([recording], only=["stribeck"])
    assert before == once._hash([recording]) == once._hash([copy])
    assert before != once._hash([cases.recording("short")])
