"""Progress of work that goes in rounds of which nobody knows the number."""

from hypothesis import given
from hypothesis import strategies as st

from estimators.progress import forward


@given(st.lists(st.lists(st.floats(0, 0.99), min_size=1), max_size=12))
def test_progress_never_runs_back_and_ends_with_the_work(rounds):
    shares: list[float] = []
    progress = forward(lambda what, share: shares.append(share))
    for shown in rounds:
        for share in sorted(shown):
            progress("working", share)
    assert shares == sorted(shares)
    assert all(share < 1.0 for share in shares)
    progress("done", 1.0)
    assert shares[-1] == 1.0
