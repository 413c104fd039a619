"""What a user says of a column."""

import math
import re

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pendulum_env.recording import RecordingError, read_recording
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.expression import Expression, letters, parse

UNITS = {letters(unit): unit for unit in ("rad", "deg", "rad/s", "N m", "A", "counts", "min-1")}
NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc", "Z"), exclude_characters=" "), min_size=1, max_size=12)
NUMBERS = st.floats(1e-6, 1e6).map(repr) | st.integers(1, 10**6).map(str) | st.just("pi")
FACTORS = st.lists(st.tuples(st.sampled_from(["*", "/", "*-", "/-"]), NUMBERS).map("".join), max_size=4).map(tuple)


UNIT = st.none() | st.sampled_from(list(UNITS.values()))
OFFSETS = st.tuples(st.tuples(st.sampled_from("+-"), NUMBERS).map("".join), UNIT) | st.just((None, None))
EXPRESSIONS = st.builds(
    lambda name, unit, factors, offset, negative: Expression(name, unit, factors, *offset, negative),
    NAMES, UNIT, FACTORS, OFFSETS, st.booleans(),
)  # fmt: skip


@given(expression=EXPRESSIONS, others=st.lists(NAMES, max_size=3), column=st.floats(-1e3, 1e3))
def test_what_is_written_is_read_back_and_does_what_python_makes_of_it(expression: Expression, others, column) -> None:
    sign = "-" if expression.negative else ""
    expected = eval(f"{sign}{column!r}{''.join(expression.factors)}{expression.offset or ''}", {"pi": math.pi})
    assert expression.gain * column + expression.shift == pytest.approx(expected, rel=1e-9, abs=1e-9)
    text = str(expression)
    assume(not any(name != expression.name and text.lstrip("- ").startswith(name.lstrip("-")) for name in others))
    assume(not expression.name.startswith("-") and text not in others)
    assert parse(text, [*others, expression.name], UNITS) == expression


@given(text=st.text("ab-:*/+?.0123e pi", max_size=20) | st.text(max_size=20))
def test_any_text_is_an_expression_or_one_sentence(text: str) -> None:
    try:
        expression = parse(text, ["a", "a-b", "b*2"], UNITS)
    except RecordingError as error:
        assert "\n" not in str(error) or "\n" in text
    else:
        assert expression.name in ("a", "a-b", "b*2")
        assert math.isfinite(expression.gain) and expression.gain != 0


def test_names_of_columns_come_first_and_the_longest_is_meant() -> None:
    headers = ["a", "a-b", "-a", "a:deg", "a*2"]
    assert [parse(text, headers, UNITS).name for text in headers] == headers
    assert parse("a-b*3", headers, UNITS) == Expression("a-b", factors=("*3",))
    assert parse("a-1", headers, UNITS) == Expression("a", offset="-1")
    assert parse("- a", headers, UNITS) == Expression("a", negative=True)
    assert parse("a : rad/s / 6 + 1 : deg", headers, UNITS) == Expression("a", "rad/s", ("/6",), "+1", "deg")


@pytest.mark.parametrize(
    ("text", "column", "expected"),
    [
        ("torque=current:A*0.091", 2.0, 0.182),
        ("torque=current:mA*0.091", 2000.0, 0.182),
        ("torque=i [mA]*0.091", 2000.0, 0.182),
        ("torque=current:A*0.091*6+0.01:Nm", 2.0, 1.102),
        ("position=-motor_angle/6", 3.0, -0.5),
        ("position=motor_angle:deg/6-90", 540.0, 0.0),
        ("position=motor_angle:deg-1:rad", 180.0, math.pi - 1),
        ("position=enc:counts/4096", 1024.0, math.pi / 2),
        ("position=enc:counts/4096/6-0.25:rev", 4096.0 * 6, 1.5 * math.pi),
        ("position=enc*2*pi/4096", 1024.0, math.pi / 2),
        ("velocity=speed:rpm/6", 60.0, 2 * math.pi / 6),
        ("velocity=speed:counts/s/4096", 4096.0, 2 * math.pi),
        ("time=clock*1e-3", 1000.0, 1.0),
        ("position=x:mm", 20.0, 0.02),
        ("torque=force:N", 20.0, 20.0),
    ],
)
def test_columns_become_si(text: str, column: float, expected: float) -> None:
    headers = ["clock", "motor_angle", "enc", "speed", "current", "i [mA]", "x", "force"]
    quantity, _, expression = text.partition("=")
    named = {"time": "clock", "position": "x:m", "torque": "force:N"} | {quantity: expression}
    found = find_columns(headers, named)[quantity]
    assert found.scale * column + found.offset == pytest.approx(expected)


@pytest.mark.parametrize(
    ("quantity", "text", "match"),
    [
        ("torque", "current", "torque cannot be column 'current' without a gain: write torque=current:A[*]0.1 with"),
        ("torque", "current:A", "cannot be column 'current' without a gain"),
        ("torque", "duty:duty", "cannot be column 'duty' without a gain"),
        ("position", "enc", "write position=enc:counts/4096 with the counts of a turn"),
        ("position", "enc/4096", "write position=enc:counts/4096 with the counts of a turn"),
        ("position", "q*?", "can be unknown only where it is a current"),
        ("torque", "current*?", "can be unknown only where it is a current: write torque=current:A[*][?]"),
        ("torque", "current:A*2+1", "the offset in 'current:A[*]2[+]1' needs a unit of its own: write .*[+]1:Nm"),
        ("torque", "current:A*2+1:A", "is added after the gain: give it in N m"),
        ("torque", "current:Foo*2", "unit 'Foo' of torque is not known: use one of Nm, mNm, Ncm, A, mA, V, duty"),
        ("torque", "curent*2", "no column is named 'curent', which is to be torque"),
        ("position", "q*0", "makes nothing of it"),
        ("position", "q*1e999", "beyond all bounds"),
        ("position", "q**2", r"'\*\*2' behind column 'q' is not understood: write NAME:UNIT"),
        ("position", "q+1*2", "is not understood"),
    ],
)
def test_what_makes_no_sense_is_one_sentence(quantity: str, text: str, match: str) -> None:
    headers = ["time", "q", "enc", "tau", "current", "duty", "iq_measured"]
    with pytest.raises(RecordingError, match=match):
        find_columns(headers, {quantity: text})


@pytest.mark.parametrize(
    "header", ["current", "iq", "Current [A]", "motor_current", "/motor/iq_measured", "duty", "PWM"]
)
def test_a_current_is_never_taken_for_a_torque(header: str) -> None:
    with pytest.raises(RecordingError, match=r"no column for torque.*needs a gain, as in --columns torque="):
        find_columns(["time", "position", header])


def test_a_current_of_unknown_gain_stays_one(tmp_path) -> None:
    time = np.arange(2000) / 500
    np.savez(tmp_path / "run.npz", time=time, position=np.sin(time), current=1e3 * np.cos(time))
    recording = read_recording(tmp_path / "run.npz", columns={"torque": "-current:mA*?"})
    assert recording.torque_unit == "A"
    np.testing.assert_allclose(recording.torque, -np.cos(time))
    assert "torque is in A, its gain to be found" in recording.notes


def test_expressions_are_told_and_applied(tmp_path) -> None:
    time = np.arange(2000) / 500
    columns = {"t": time, "motor": -6 * np.degrees(np.sin(time)) + 30, "i": np.cos(time), "setpoint": np.sin(time)}
    np.savez(tmp_path / "run.npz", **columns)
    named = {"position": "-motor:deg/6+5", "torque": "i:A*0.5"}
    recording = read_recording(tmp_path / "run.npz", columns=named)
    np.testing.assert_allclose(recording.position, np.sin(time), atol=1e-12)
    np.testing.assert_allclose(recording.torque, 0.5 * np.cos(time))
    assert {"position is -motor:deg/6+5", "torque is i:A*0.5"} <= set(recording.notes)


def test_one_of_several_joints_has_to_be_chosen() -> None:
    headers = [f"/joint_states/{what}[{joint}]" for what in ("position", "effort") for joint in range(3)]
    with pytest.raises(RecordingError, match=re.escape("could all be position: say which with --columns")):
        find_columns(["__time", *headers])
    named = {"position": "/joint_states/position[1]", "torque": "-/joint_states/effort[1]*2"}
    columns = find_columns(["__time", *headers], named)
    assert (columns["position"].index, columns["torque"].index, columns["torque"].scale) == (2, 5, -2.0)


def test_a_long_expression_takes_no_more_than_its_length():
    with pytest.raises(RecordingError, match="unit 'V' of position is not known"):
        find_columns(["time", "q", "torque"], {"position": "q:V" + "/6+0.1:Nm" * 100_000})
