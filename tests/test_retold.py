"""Retold logs: contracts of the benchmark, and retellings that are right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.retold import arms, joints, retellings, servos
from benchmarks.retold.bound import bound_errors
from benchmarks.retold.judging import judge_number, list_remedies
from benchmarks.retold.kinds import KINDS, draw_scenario
from benchmarks.retold.machines import Sensors
from benchmarks.retold.scenario import LEAST_BOUND

SEED = 20261129
QUICK = {  # numbers with their rows
    63: "unit in header", 80: "load sensor", 83: "value fixed", 89: "jitter", 93: "split", 95: "decimal comma",
    97: "further columns", 98: "idle", 101: "both signs", 104: "both signs", 105: "speed by differences",
    107: "decimals", 108: "speed alone", 110: "load sensor", 111: "actuator noise", 116: "value fixed",
    117: "Unix clock", 118: "split", 119: "renamed", 120: "as it is", 121: "Unix clock", 122: "split",
}  # fmt: skip
# (seed, number): row, of a coarse encoder under a controller
SLOW_SWEEPS = {
    (490, 22): "torque filtered", (490, 59): "renamed", (57001, 22): "torque late", (57001, 43): "other zero",
}  # fmt: skip


def read_files(folder, *names):
    scenario = draw_scenario(SEED, 3, *names)
    folder.mkdir()
    scenario.write(folder)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def make_log(kind, row):
    """Make a log of a kind with its run, before its retelling of a row, and the retelling."""
    rng = np.random.default_rng(SEED)
    if kind == "servo":
        servo = servos.draw_machine(rng, "duty", ())
        (run, *_) = servos.run_servo(rng, servo, "smooth goals", servos.draw_sampling(rng, row))
        return servos.log_goals(run, servo, row), run, servos.RETELLINGS[row]
    if kind == "arm":
        run = arms.run_arm(rng, *arms.draw_machine(rng), "multisine", joints.draw_sensors(rng, row, 2.0))
        return arms.log_arm(run), run, arms.RETELLINGS[row]
    run, _ = joints.draw_run(rng, kind, "as it is", "two sines")
    return retellings.log_run(run), run, retellings.RETELLINGS[row]


@pytest.mark.parametrize("kind", KINDS)
def test_a_drawn_scenario_is_reproducible(kind, tmp_path):
    assert read_files(tmp_path / "first", kind) == read_files(tmp_path / "second", kind)


@pytest.mark.parametrize("kind", ["pendulum", "motor", "servo", "arm"])
def test_columns_of_a_retelling_have_equal_lengths(kind):
    for row in KINDS[kind].rows:
        log, run, retell = make_log(kind, row)
        retold = retell(log, run, np.random.default_rng(1))
        assert len({len(values) for values in retold.columns.values()}) == 1, row


def test_a_split_log_has_all_of_its_rows(tmp_path):
    log, *_ = make_log("pendulum", "as it is")
    first, second = (Path(file).read_text().splitlines() for file in replace(log, cuts=(0.4,)).write(tmp_path))
    assert first[0] == second[0] and len(first) + len(second) - 2 == len(log.columns["time"])


def test_the_bound_is_small_for_sines_and_infinite_for_a_constant_torque():
    rng = np.random.default_rng(SEED)
    sensors = Sensors(500.0, 20.0, counts=1_000_000)
    pendulum, motor = (joints.draw_machine(rng, kind) for kind in ("pendulum", "motor"))
    assert max(bound_errors([joints.run_machine(rng, pendulum, "multisine", sensors)]).values()) < LEAST_BOUND
    run = joints.run_machine(rng, motor, "constant", sensors)
    late = slice(-len(run.recording.time) // 4, None)  # at constant speed
    series = ("time", "exact_position", "velocity", "acceleration", "sliding")
    steady = replace(run.recording, **{name: getattr(run.recording, name)[late] for name in series})
    assert all(np.isinf(own) for own in bound_errors([replace(run, recording=steady)]).values())


def test_the_bound_of_an_arm_falls_with_the_noise_of_its_torque():
    rng = np.random.default_rng(SEED)
    arm, size = arms.draw_machine(rng)
    sensors = [Sensors(500.0, 8.0, counts=None, noise=noise) for noise in (1e-2, 1e-3)]
    loud, low = (arms.bound_errors(arms.run_arm(np.random.default_rng(1), arm, size, "multisine", s)) for s in sensors)
    for name, error in low.items():
        assert loud[name] == pytest.approx(10 * error, rel=0.1)


@pytest.mark.parametrize(
    ("text", "given", "remedies"),
    [
        ("if so, give --fix gravity=0. Else record again", [], [["--fix", "gravity=0"]]),
        ("give it, --fix inertia=VALUE", [], []),
        ("say which with --columns position=NAME", [], []),
        ("read it as --columns 'position=q:deg,torque=-u', or record", [], [["--columns", "position=q:deg,torque=-u"]]),
        ("torque is late: --align", [], [["--align"]]),
        ("torque is late: --align", ["--align"], []),
        ("--unwrap undoes jumps; --bound viscous=0:0.5 is a limit", [], [["--unwrap"], ["--bound", "viscous=0:0.5"]]),
    ],
)
def test_remedies_are_read_from_a_message(text, given, remedies):
    assert list_remedies(text, given) == remedies


def test_a_row_that_no_kind_has_is_refused():
    with pytest.raises(ValueError, match="no kind has the row current and the motion multisine"):
        draw_scenario(SEED, 0, "arm", "current", "multisine")


@pytest.mark.parametrize(("number", "row"), QUICK.items())
def test_a_retold_log_has_the_same_result(number, row):
    own = judge_number(number, SEED)
    assert own.row == row and own.outcome in ("right", "asked"), own


@pytest.mark.parametrize(("source", "row"), SLOW_SWEEPS.items())
def test_a_slow_sweep_without_effect_has_none(source, row):
    seed, number = source
    own = judge_number(number, seed)
    assert (own.row, own.motion, own.named) == (row, "slow sweep", "nothing") and own.outcome in ("right", "asked"), own


def test_a_stop_is_no_friction_without_limit_at_rest():
    """A joint that stands at its stop has no window of low speed, over which a Stribeck law is extrapolated."""
    own = judge_number(11, 57001)
    assert (own.row, own.motion, own.outcome) == ("idle", "standing", "right"), own


def test_steps_between_the_rows_of_a_log_are_no_effect():
    own = judge_number(174, 490)
    assert (own.row, own.motion, own.outcome) == ("fast controller", "steps", "right"), own


def test_a_servo_that_sticks_in_steps_has_its_dry_friction():
    own = judge_number(6, 8, "servo")
    assert own.motion == "steps of goals" and own.outcome == "right", own
