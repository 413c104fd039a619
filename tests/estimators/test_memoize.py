"""Results of methods are stored by all their arguments."""

from estimators.memoize import memoized


class Counter:
    """Counts the calls that compute."""

    def __init__(self) -> None:
        self.calls = 0

    @memoized
    def add(self, *parts: object, factor: int = 1, also: object = ()) -> tuple[object, ...]:
        self.calls += 1
        return (*parts, factor, *also)


def test_equal_arguments_compute_once():
    counter = Counter()
    for _ in range(2):
        assert counter.add(1, [2, 3], factor=4, also=[5]) == (1, [2, 3], 4, 5)
    assert counter.add(1, (2, 3), also=(5,), factor=4) == (1, [2, 3], 4, 5)  # a list counts as a tuple, in any order
    assert counter.calls == 1


def test_arguments_by_name_are_part_of_the_key():
    counter = Counter()
    assert counter.add(1, factor=2) == (1, 2)
    assert counter.add(1, factor=3) == (1, 3)
    assert counter.add(1) == (1, 1)
    assert counter.add(("factor", 2)) == (("factor", 2), 1)  # no argument by name
    assert counter.calls == 4


def test_objects_do_not_share_results():
    first, second = Counter(), Counter()
    first.add(1), second.add(1)
    assert (first.calls, second.calls) == (1, 1)
