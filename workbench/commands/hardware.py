"""`hardware check`: check a new rig step by step; until it passes, the guard allows a small torque only.

Each step gives an instruction, measures the result, and names the remedy after a failure.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.config import RigConfig, load, mark_checked
from pendulum_env.backends.hardware.rig import Rig
from pendulum_env.backends.port import Sample, Start, Status
from workbench.errors import InputError
from workbench.terminal import Terminal

QUARTER = 0.5 * math.pi  # rotation by hand [rad]
ROUGHLY = 0.5  # tolerance of a motion by hand [rad]
RAMP = 1.0  # rate of the torque [N m/s]
MOVED = 0.1  # rotation that counts as motion [rad]
STEP = 0.005  # time between torque commands without power [s]
PATIENCE = 3.0  # pause that must trip the watchdog, in watchdog times

Confirm = Callable[[str], bool]  # puts a question to the operator; True: confirmed


class CheckFailed(RuntimeError):
    """A step failed; the message names the remedy."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the action and the configuration of the rig."""
    parser.add_argument("what", choices=("check",), help="wiring, signs, zero and limits, step by step at low torque")
    parser.add_argument("config", metavar="CONFIG", help="the rig's rig.toml, see docs/hardware.md")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run the check with questions on the terminal."""

    def confirm(text: str) -> bool:
        """Ask until the answer is yes or no, so that an accidental key moves no motor."""
        terminal.print(text)
        try:
            while (answer := input("[y/n] ").strip().lower()) not in ("y", "yes", "n", "no"):
                pass
            return answer.startswith("y")
        except EOFError:
            raise InputError("the check asks questions: run it in a terminal") from None

    try:
        check_rig(load(arguments.config), terminal.print, confirm)
    except (CheckFailed, DriveError) as error:
        raise InputError(str(error)) from None


def check_rig(config: RigConfig, print: Callable[[str], None], confirm: Confirm) -> None:
    """Run all steps, and write a mark next to the configuration if they pass.

    Raises CheckFailed if a step fails, and DriveError if the rig is in use or not reachable.
    """
    # at low torque even if checked before; no plausibility check of motion: the steps look for faults
    rig = Rig(replace(config, checked=False, plant=replace(config.plant, watch=False)))
    try:
        for number, (title, step) in enumerate(STEPS, start=1):
            print(f"\n{number} of {len(STEPS)}: {title}")
            print(step(rig, confirm))
    except KeyboardInterrupt:
        raise CheckFailed("the check was interrupted: nothing is noted") from None
    finally:
        rig.close()
    note = mark_checked(config)
    print(f"\npassed: up to {config.limits.torque:g} N m are allowed (noted in {note})")


def _check_wiring(rig: Rig, confirm: Confirm) -> str:
    _require(
        confirm(
            "The emergency stop cuts the motor's power and is within reach, no person is within reach of it, and it "
            "can turn all the way round. Is that so?"
        ),
        "make it so first: software is never the emergency stop",
    )
    rig.open()
    reading = rig.guard.motor.read()
    return f"the drive answers; counts {reading.counts}, {reading.fault or 'no fault'}"


def _check_encoder(rig: Rig, confirm: Confirm) -> str:
    _, before = rig.guard.read()
    _ask(confirm, "Without power: turn the pendulum a quarter turn counter-clockwise by hand and hold it. Done?")
    angle = rig.guard.read()[1] - before
    encoder, degrees = rig.config.encoder, f"{math.degrees(angle):.0f} degrees"
    _require(abs(angle) > 0.01, "the counts do not change: check the encoder's cable and supply")
    _require(angle > 0, f"the counts go the wrong way: set encoder.sign = {-encoder.sign}")
    _require(
        abs(angle - QUARTER) < ROUGHLY,
        f"a quarter turn came as {degrees}: encoder.counts is nearer to "
        f"{round(encoder.counts * angle / QUARTER)} (after quadrature: four times the lines)",
    )
    return f"turned by {degrees}"


def _check_zero(rig: Rig, confirm: Confirm) -> str:
    _ask(confirm, "Let the pendulum hang down and rest, touching nothing. Done?")
    off = math.degrees(math.remainder(rig.guard.read()[1], 2 * math.pi))
    counts = rig.guard.motor.read().counts
    _require(
        abs(off) < math.degrees(ROUGHLY),
        f"it hangs at {off:.0f} degrees: start with the pendulum hanging down, or set encoder.zero to {counts}",
    )
    return (
        f"zero is {abs(off):.1f} degrees off, the count is {counts}: a diagnosis finds what is left as gravity_tilt, "
        "as long as zero stays the same (encoder.zero)"
    )


def _check_torque(rig: Rig, confirm: Confirm) -> str:
    max_torque = rig.traits.max_torque
    _ask(confirm, f"The motor will push, slowly, up to {max_torque:g} N m, one way and then the other. Ready?")
    _require(
        _measure_motion(rig, max_torque) < MOVED,
        "the pendulum moves without power: servo-enable does not reach the drive, which keeps its torque. Check that "
        "line, its pull-down, and the drive's setting for it",
    )
    torques = []
    for direction in (1.0, -1.0):
        start = rig.enable(Start())
        torque, angle = 0.0, 0.0
        for sample in _run(rig, lambda t, d=direction: d * min(RAMP * t, max_torque), max_torque / RAMP + 1.0):  # type: ignore[misc]
            torque, angle = sample.torque, sample.position - start.position
            if abs(angle) > MOVED:
                break
        rig.disable()
        _require(
            abs(angle) > MOVED,
            f"the pendulum does not move under {max_torque:g} N m: check motor and drive, or free the pendulum",
        )
        _require(
            angle * direction > 0,
            f"a torque of {torque:+.2g} N m turned it by {math.degrees(angle):+.0f} degrees: set torque_sign = "
            f"{-rig.config.torque_sign}",
        )
        torques.append(abs(torque))
    forwards, backwards = torques
    return (
        f"without power it stays; with power it starts to turn at {forwards:.2g} and {backwards:.2g} N m, the right way"
    )


def _measure_motion(rig: Rig, max_torque: float) -> float:
    """Ramp the torque command up to `max_torque` [N m] without power; return the largest motion [rad]."""
    rig.disable()
    motor, sign, angle = rig.guard.motor, rig.config.torque_sign, 0.0
    _, start = rig.guard.read()
    try:
        for k in range(round(max_torque / RAMP / STEP)):
            motor.write(sign * RAMP * k * STEP)
            time.sleep(STEP)
            angle = abs(rig.guard.read()[1] - start)
            if angle > MOVED:
                break
    finally:
        motor.write(0.0)
    return angle


def _check_clamp(rig: Rig, confirm: Confirm) -> str:
    rig.enable(Start())
    max_torque = rig.traits.max_torque
    largest = max(abs(sample.torque) for sample in _run(rig, lambda t: 100.0 * (-1) ** int(t / 0.05), 0.2))
    rig.disable()
    _require(largest <= max_torque * (1 + 1e-6), f"{largest:.3g} N m were let pass where {max_torque:.3g} are allowed")
    return f"100 N m were requested, and at most {largest:.3g} N m came"


def _check_watchdog(rig: Rig, confirm: Confirm) -> str:
    patience = PATIENCE * rig.config.limits.watchdog
    rig.enable(Start())
    for _ in _run(rig, lambda t: 0.0, 0.2):
        pass
    time.sleep(patience)  # simulates a hanging program
    fault = rig.guard.motor.read().fault
    rig.disable()
    _require(
        fault is not None,
        f"the drive keeps its power {patience:g} s after the last command: it has no watchdog, or does not take "
        "limits.watchdog",
    )
    return f"the drive let go by itself: {fault}"


STEPS: tuple[tuple[str, Callable[[Rig, Confirm], str]], ...] = (
    ("wiring", _check_wiring),
    ("sign and scale of the encoder", _check_encoder),
    ("zero", _check_zero),
    ("sign of the torque", _check_torque),
    ("limit of the torque", _check_clamp),
    ("the drive's watchdog", _check_watchdog),
)


def _run(rig: Rig, torque: Callable[[float], float], seconds: float) -> Iterator[Sample]:
    """Run the rig for some time [s] under a torque as a function of time; yield the samples."""
    time_now = 0.0
    while time_now < seconds:
        sample = rig.exchange(torque(time_now))
        if sample.status is Status.FAULT:
            raise DriveError(str(sample.fault))
        time_now = sample.time
        yield sample


def _require(is_right: bool, remedy: str) -> None:
    if not is_right:
        raise CheckFailed(remedy)


def _ask(confirm: Confirm, text: str) -> None:
    _require(confirm(text), "the check was left: nothing is noted")
