"""Which column is which quantity: by its name, and by what a user says of it."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pendulum_env.recording import RecordingError, read_recording, vocabulary
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.expression import Expression, normalise_name, parse_expression
from tests.notes import list_notes

UNITS = {normalise_name(unit): unit for unit in ("rad", "deg", "rad/s", "N m", "A", "counts", "min-1")}
NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc", "Z"), exclude_characters=" "), min_size=1, max_size=12)
NUMBERS = st.floats(1e-6, 1e6).map(repr) | st.integers(1, 10**6).map(str) | st.just("pi")
FACTORS = st.lists(st.tuples(st.sampled_from(["*", "/", "*-", "/-"]), NUMBERS).map("".join), max_size=4).map(tuple)
UNIT = st.none() | st.sampled_from(list(UNITS.values()))
OFFSETS = st.tuples(st.tuples(st.sampled_from("+-"), NUMBERS).map("".join), UNIT) | st.just((None, None))
EXPRESSIONS = st.builds(
    lambda name, unit, factors, offset, is_negative: Expression(name, unit, factors, *offset, is_negative),
    NAMES, UNIT, FACTORS, OFFSETS, st.booleans(),
)  # fmt: skip


@given(expression=EXPRESSIONS, others=st.lists(NAMES, max_size=3), column=st.floats(-1e3, 1e3))
def test_what_is_written_is_read_back_and_does_what_python_makes_of_it(expression: Expression, others, column) -> None:
    sign = "-" if expression.is_negative else ""
    expected = eval(f"{sign}{column!r}{''.join(expression.factors)}{expression.offset or ''}", {"pi": math.pi})
    assert expression.gain * column + expression.shift == pytest.approx(expected, rel=1e-9, abs=1e-9)
    text = str(expression)
    assume(not any(name != expression.name and text.lstrip("- ").startswith(name.lstrip("-")) for name in others))
    assume(not expression.name.startswith("-") and text not in others)
    assert parse_expression(text, [*others, expression.name], UNITS) == expression


@pytest.mark.parametrize(
    ("headers", "quantities"),
    [
        ("t,q,u", "time position torque"),
        ("Time [s],q [rad],tau [N m]", "time position torque"),
        ("time_s,pos_rad,vel_rad/s,tau_Nm", "time position velocity torque"),
        ("timestamp,theta,omega,effort", "time position velocity torque"),
        ("time,meas_pos,meas_vel,meas_tau,des_pos,des_tau", "time position velocity torque reference"),
        ("mode,t,angle (rad),dq,torque (N·m)", "- time position velocity torque"),
        ("Timestamp,θ,qd,τ,temperature", "time position velocity torque temperature"),
        # of known programs
        ("__time,/arm/position[0],/arm/velocity[0],/arm/effort[0]", "time position velocity torque"),
        ("__time,/joint_states/elbow/position,/joint_states/elbow/effort", "time position torque"),
        ("__time,/joint_states/position/elbow,/joint_states/effort/elbow", "time position torque"),
        ("time,signals.theta,signals.tau", "time position torque"),
        ("timestamp,observation.state[0],action[0],tau,episode_index", "time position reference torque segment"),
        ("t,pos_estimate,vel_estimate,torque_estimate", "time position velocity torque"),
        ("time,joint.position (deg),out.torque [Nm]", "time position torque"),
    ],
)
def test_quantities_are_found_by_the_names_that_people_and_programs_give_them(headers: str, quantities: str) -> None:
    found = {column.index: quantity for quantity, column in find_columns(headers.split(",")).items()}
    assert found == {index: quantity for index, quantity in enumerate(quantities.split()) if quantity != "-"}


def test_no_name_has_two_meanings() -> None:
    meanings: dict[str, set[tuple[str, float, bool]]] = {}
    for stem, (quantity, rank) in vocabulary._list_stems():
        for unit, factor in {"": 1.0, **vocabulary.UNITS[quantity]}.items():
            meanings.setdefault(stem + unit, set()).add((quantity, factor, rank))
    assert {name: meaning for name, meaning in meanings.items() if len(meaning) > 1} == {}


def test_units_that_people_are_told_of_are_understood() -> None:
    for quantity, names in vocabulary.UNIT_NAMES.items():
        for unit in names.split(", "):
            named = {"time": "t", "position": "q", "torque": "tau"} | {quantity: f"x:{unit}*2"}
            assert find_columns(["t", "q", "tau", "x"], named)[quantity].unit is not None


def test_names_of_columns_come_first_and_the_longest_is_meant() -> None:
    headers = ["a", "a-b", "-a", "a:deg", "a*2"]
    assert [parse_expression(text, headers, UNITS).name for text in headers] == headers
    assert parse_expression("a-b*3", headers, UNITS) == Expression("a-b", factors=("*3",))
    assert parse_expression("a-1", headers, UNITS) == Expression("a", offset="-1")
    assert parse_expression("- a", headers, UNITS) == Expression("a", is_negative=True)
    assert parse_expression("a : rad/s / 6 + 1 : deg", headers, UNITS) == Expression("a", "rad/s", ("/6",), "+1", "deg")


@pytest.mark.parametrize(
    ("text", "column", "expected"),
    [
        ("torque=current:mA*0.091", 2000.0, 0.182),
        ("torque=current:A*0.091*6+0.01:Nm", 2.0, 1.102),
        ("position=-motor_angle/6", 3.0, -0.5),
        ("position=motor_angle:deg-1:rad", 180.0, math.pi - 1),
        ("position=enc:counts/4096/6-0.25:rev", 4096.0 * 6, 1.5 * math.pi),
        ("position=enc*2*pi/4096", 1024.0, math.pi / 2),
        ("velocity=speed:rpm/6", 60.0, 2 * math.pi / 6),
        ("velocity=speed:counts/s/4096", 4096.0, 2 * math.pi),
        ("time=clock*1e-3", 1000.0, 1.0),
        ("position=x:mm", 20.0, 0.02),
        ("torque=force:N", 20.0, 20.0),
        ("torque=-/joints/effort[1]*2", 3.0, -6.0),
    ],
)
def test_columns_become_si(text: str, column: float, expected: float) -> None:
    headers = ["clock", "motor_angle", "enc", "speed", "current", "i [mA]", "x", "force", "/joints/effort[1]"]
    quantity, _, expression = text.partition("=")
    named = {"time": "clock", "position": "x:m", "torque": "force:N"} | {quantity: expression}
    found = find_columns(headers, named)[quantity]
    assert found.scale * column + found.offset == pytest.approx(expected)


HEADERS = "time,q,enc,tau,current,duty,iq_measured"
JOINTS = ",".join(f"/joint_states/{what}[{joint}]" for what in ("position", "effort") for joint in range(3))
CURRENTS = ["iq", "Current [A]", "/motor/iq_measured", "PWM"]


@pytest.mark.parametrize(
    ("headers", "named", "match"),
    [
        ("time,q,position,torque", {}, "'q' and 'position' could both be position"),
        ("time,x,torque", {}, "for position among 'time', 'x', 'torque': name the columns time,position,torque"),
        ("time,position_a,position_b,torque_a,torque_b", {}, "for 'a', 'b': an arm needs --robot"),
        ("time,position [counts],torque", {}, "no column for position"),
        ("time,q,tau_cmd,u", {}, "'tau_cmd' and 'u' could both be torque: say which with --columns torque=NAME"),
        (f"__time,{JOINTS}", {}, "could all be position: say which with --columns"),
        ("t,q,tau", {"angle": "q"}, "unknown quantity 'angle'; known: enabled, load_torque, position"),
        ("t,q,tau", {"position": "Q"}, "no column is named 'Q', which is to be position, among 't', 'q', 'tau'"),
        ("t,q,tau", {"velocity": "q"}, "no column for position"),
        ("cpu_time,q,tau", {}, "'cpu_time' may be it, as in --columns time=cpu_time"),
        ("a[0],a[1],tau", {}, "as in --columns 'time=a.0.,position=NAME'"),
        *((f"t,q,{name}", {}, "no column for torque.*needs a gain, as in --columns 'torque=") for name in CURRENTS),
        (
            HEADERS,
            {"torque": "current"},
            "column 'current' without a gain: write --columns 'torque=current:A[*]0.1'",
        ),
        (HEADERS, {"torque": "duty:duty"}, "cannot be column 'duty' without a gain"),
        (HEADERS, {"position": "enc"}, "write --columns position=enc:counts/4096 with the counts of a turn"),
        (HEADERS, {"position": "q*?"}, "can be unknown only where it is a current"),
        (HEADERS, {"torque": "current*?"}, "unknown only where it is a current: write torque=current:A[*][?]"),
        (
            HEADERS,
            {"torque": "current:A*2+1"},
            "offset in .* needs a unit of its own: .*[+]1:Nm",
        ),
        (
            HEADERS,
            {"torque": "current:Foo*2"},
            "'Foo' of torque is not known: use one of Nm, mNm, kNm, Ncm, A, mA, V, mV, duty, %",
        ),
        (HEADERS, {"position": "q*1e999"}, "are finite, gains are not 0"),
        (HEADERS, {"position": "q**2"}, r"'\*\*2' behind column 'q' is not understood: write NAME:UNIT"),
        (HEADERS, {"position": "q:V" + "/6+0.1:Nm" * 100_000}, "unit 'V' of position is not known"),  # at once
    ],
)
def test_what_is_no_column_or_makes_no_sense_is_one_sentence(headers: str, named: dict[str, str], match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        find_columns(headers.split(","), named)


def test_a_current_of_unknown_gain_stays_one() -> None:
    time = np.arange(2000) / 500
    log = {"time": time, "position": np.sin(time), "current": 1e3 * np.cos(time)}
    recording = read_recording(log, columns={"torque": "-current:mA*?"})
    assert recording.torque_unit == "A"
    np.testing.assert_allclose(recording.torque, -np.cos(time))
    assert "torque is in A, its gain to be found" in list_notes(recording)


def test_the_motor_current_is_proposed_before_other_currents_and_the_duty():
    headers = "time,position,duty_cycle,current_in,current_motor".split(",")
    with pytest.raises(RecordingError, match="torque=current_motor:A"):
        find_columns(headers)


@pytest.mark.parametrize(
    ("unit", "torque"),  # [N m]
    [
        ("cNm", 0.01),
        ("N mm", 0.001),
        ("kgf.cm", 9.80665 / 100),
        ("kgcm", 9.80665 / 100),
        ("oz-in", 9.80665 * 0.45359237 / 16 * 0.0254),
        ("lbf in", 9.80665 * 0.45359237 * 0.0254),
        ("ft-lb", 9.80665 * 0.45359237 * 0.3048),
        ("ft-lbs", 9.80665 * 0.45359237 * 0.3048),
        ("in lbs", 9.80665 * 0.45359237 * 0.0254),
        ("kgf m", 9.80665),
        ("kgm", 9.80665),
        ("gf cm", 9.80665 / 1e5),
        ("gcm", 9.80665 / 1e5),
    ],
)
def test_torque_converts_from_units_of_datasheets(unit: str, torque: float) -> None:
    time = np.arange(1000) / 100
    log, drive = {"time": time, "position": np.sin(time)}, np.cos(3 * time)
    by_name, by_option = {f"tau [{unit}]": drive}, {"tau": drive}
    for recording in (
        read_recording(log | by_name),
        read_recording(log | by_option, columns={"torque": f"tau:{unit}"}),
    ):
        np.testing.assert_allclose(recording.torque, torque * drive, rtol=1e-12)


@pytest.mark.parametrize(
    ("column", "named", "is_read"),  # a speed alone is integrated
    [
        ("torque_raw", {"torque": "torque_raw"}, False),
        ("tau lsb", {"torque": "tau lsb"}, False),
        ("speed_rpm", {"position": "speed_rpm"}, True),
        ("velocity", {"position": "velocity"}, True),
    ],
)
def test_columns_of_another_quantity_or_without_unit_are_read_with_a_unit_or_gain_alone(
    column: str, named: dict[str, str], is_read: bool
) -> None:
    time = np.arange(1000) / 100
    log = {"time": time, "position": np.sin(time), "torque": np.cos(3 * time)}
    (quantity,) = named
    log[column] = log.pop(quantity)
    for columns in (named,) if is_read else ({}, named):
        with pytest.raises(RecordingError):
            read_recording(log, columns=columns)
    recording = read_recording(log, columns={quantity: f"{column}*0.5"})
    np.testing.assert_allclose(getattr(recording, quantity), 0.5 * log[column], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("clock", "position", "other"), [("time", "position", "thr"), ("t", "theta", "th"), ("t", "q", "tmin")]
)
def test_short_names_of_other_quantities_are_no_second_clock(clock: str, position: str, other: str) -> None:
    time = np.arange(1000) / 100
    log = {clock: time, position: np.sin(time), "torque": np.cos(3 * time), other: np.ones(1000)}
    np.testing.assert_allclose(read_recording(log).time, time, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("header", "factor"),
    [("t [h]", 3600.0), ("t (min)", 60.0), ("time_h", 3600.0), ("Time (hr)", 3600.0), ("elapsed min", 60.0)],
)
def test_time_in_hours_or_minutes_is_read_by_a_unit_apart_from_its_name(header: str, factor: float) -> None:
    time = np.arange(1000) / 100
    log = {header: time / factor, "position": np.sin(time), "torque": np.cos(3 * time)}
    np.testing.assert_allclose(read_recording(log).time, time, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "factor"), [("velocity", 1.0), ("speed [rpm]", 30 / np.pi), ("dq [deg/s]", 180 / np.pi)]
)
def test_a_speed_alone_is_integrated(header: str, factor: float) -> None:
    time = 3.0 + np.arange(2000) / 500
    log = {"time": time, header: factor * 2 * np.cos(2 * time), "torque": np.sin(3 * time)}
    recording = read_recording(log)
    np.testing.assert_allclose(recording.position, np.sin(2 * time) - np.sin(2 * time[0]), atol=1e-5)
    np.testing.assert_allclose(recording.velocity, 2 * np.cos(2 * time), atol=1e-9)
    assert recording.has_integrated_position
    assert not read_recording(log | {"position": np.sin(2 * time)}).has_integrated_position
    with pytest.raises(RecordingError, match="no column for position"):  # counts need their number in a turn
        read_recording(log | {"position [counts]": np.round(1000 * np.sin(2 * time))})


def test_a_joint_named_rotation_is_not_read_in_turns() -> None:
    headers = ["time", "position_Rotation", "goal_Rotation", "position_Pitch", "goal_Pitch"]
    columns = find_columns(headers, {"position": "position_Rotation", "reference": "goal_Rotation"}, "torque")
    assert columns["position"].scale == columns["reference"].scale == 1.0
    assert find_columns(["t", "position [rotation]", "tau"])["position"].scale == pytest.approx(2 * np.pi)
