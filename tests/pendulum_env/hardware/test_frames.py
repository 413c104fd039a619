"""The serial protocol on the wire, by what its documentation promises."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendulum_env.backends.hardware import frames


def test_the_crc_is_the_one_that_is_named():
    assert frames.compute_crc(b"123456789") == 0x29B1


@pytest.mark.parametrize(
    ("data", "wire"),
    [
        (b"\0", b"\x01\x01"),
        (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
        (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
    ],
)
def test_cobs_by_the_examples_of_its_article(data, wire):
    assert frames.decode(wire) == frames.decode(frames.encode(data)) == data
    assert 0 not in frames.encode(data)


@given(st.binary(max_size=253))
def test_cobs_takes_out_zeros_and_nothing_else(data):
    assert 0 not in frames.encode(data)
    assert frames.decode(frames.encode(data)) == data


@given(st.binary(max_size=200), st.integers(1, 50))
def test_whatever_comes_is_cut_without_an_error_and_a_whole_frame_after_it_is_found(noise, cut):
    splitter = frames.Splitter()
    stream = noise + b"\0" + frames.pack(frames.READ, 7)
    found = [values for k in range(0, len(stream), cut) for values in splitter.feed(stream[k : k + cut])]
    assert found[-1] == (frames.READ, 7)


def test_a_damaged_frame_is_dropped():
    """COBS may make more of them than there were, and what slips through is one in 65,536 of these."""
    rng = np.random.default_rng(0)
    good = frames.pack(frames.TORQUE, 3, -1_500_000)
    for _ in range(3000):
        bad = bytearray(good[:-1])
        for bit in rng.choice(8 * len(bad), rng.integers(1, 4), replace=False):
            bad[bit // 8] ^= 1 << bit % 8
        assert not list(frames.Splitter().feed(bytes(bad) + b"\0"))
