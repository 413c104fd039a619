"""Runs of a pendulum or an arm: the torque that drives it, what answers step by step, and recording the rig row by row.

A run may go on until a verdict stands: the online diagnosis is beside it, for a motor in a process of its own.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Self

import gymnasium as gym
import numpy as np

from agents.arm_env import plan_motion
from agents.baselines import make_separating_signal
from agents.network import load
from agents.observer import ARM, CONSTRAINTS, EPISODE, Pilot
from estimators.arms.excitation import design_excitation
from estimators.arms.following import follow
from estimators.arms.limits import find_limits
from estimators.arms.reference import Reference
from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing
from estimators.wrappers.options import find_smoothing
from pendulum_env.arms.body import Body, BodyError
from pendulum_env.arms.env import PlanarArm, SimulatedArm, SpatialArm
from pendulum_env.arms.plane import planar_links
from pendulum_env.backends.hardware import config
from pendulum_env.backends.hardware.config import RigConfig
from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.hardware.process import ordinary
from pendulum_env.excitation import MOST_TORQUE, STILL, Excitation, excitation
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import Model
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.reading import LARGE
from pendulum_env.recording import Recording, RecordingError, write_recording
from pendulum_env.registration import PENDULUM
from pendulum_env.words import listing
from pendulum_env.wrappers import RecordMeasurements
from workbench.inputs import plant_of, read_suggestion, robot_of, tell_held, wrote
from workbench.mistakes import InputError, Interrupted
from workbench.narrator.effects import name
from workbench.processes import End, Worker, attend
from workbench.terminal import Terminal

SECONDS = 30.0  # length of a recording
SUGGESTED = "suggested"  # excitation that a diagnosis holds
LEARNT = "rl"  # excitation that a policy chooses while the arm moves
DIAGNOSED = "diagnosed"  # what a recording may go on until
LONGEST = 20.0  # [s] of a run without a verdict

Sample = tuple[float, float, float]  # time [s], position [rad], torque over the period that ends with it [N m]


@dataclass(frozen=True)
class Plan:
    """Plan of a run: a torque for some time, on a plant or on the rig."""

    arguments: argparse.Namespace  # of `record`
    rig: RigConfig | None  # None: a plant is simulated, or a recording replayed
    plant: Model  # that is simulated
    rate: float  # samples per second [Hz]
    command: Excitation | Pilot  # what chooses the torque
    seconds: float  # length
    release: float | None = None  # angle at which the joint is let go at rest, without torque [rad]

    @classmethod
    def of(cls, arguments: argparse.Namespace, rng: np.random.Generator) -> Self:
        """Create the plan from arguments.

        Raises InputError if the arguments do not go together, a configuration or a policy cannot be used, or a
        diagnosis suggests nothing, and ModelError if an effect is hidden twice.
        """
        rig = _configured(arguments)
        rate = arguments.rate if rig is None else rig.rate
        command, seconds, release = _experiment(arguments, rng, rate)
        if release is not None and (arguments.backend not in (None, "simulated") or arguments.until is not None):
            raise InputError("a free swing is simulated as a whole: leave out --backend and --until")
        return cls(arguments, rig, plant_of(arguments), rate, command, seconds, release)

    def environment(self) -> gym.Env[Any, Any]:
        """Create the environment: a simulated plant, a replayed recording, or a rig without power.

        The rig is owned and connected from now on; raises InputError if it is out of reach, or in use.
        """
        asked = self.arguments
        if self.rig is not None:
            try:
                return gym.make(PENDULUM, max_episode_steps=-1, backend="dm1015b", config=str(self.rig.path))
            except DriveError as error:
                raise InputError(str(error)) from None
        return gym.make(
            PENDULUM,
            max_episode_steps=-1,
            backend=asked.backend or "pymunk",
            model=None if asked.replay is not None else self.plant,
            rate=asked.rate,
            counts=asked.counts,
            torque_noise=asked.noise,
            max_torque=max(MAX_TORQUE, self.command.amplitude),
            recording=asked.replay,
        )

    def controller(self, rate: float) -> OpenLoop | Pilot:
        """Create the controller at a rate [Hz]; a replay has its own torque."""
        return self.command if isinstance(self.command, Pilot) else OpenLoop(self.command, rate)

    @property
    def remark(self) -> str:
        """Describe the reduction of the torque by the limits of the rig; empty without one."""
        rig, most = self.rig, self.command.amplitude
        if rig is None or most <= rig.max_torque:
            return ""
        until = "limits.torque" if rig.checked else "until `hardware check` has passed"
        return f"torque is cut at {rig.max_torque:g} N m ({until}), {most:g} were asked for"


def _experiment(
    arguments: argparse.Namespace, rng: np.random.Generator, rate: float
) -> tuple[Excitation | Pilot, float, float | None]:
    """Torque command, length [s] and angle of release [rad]: drawn, as a diagnosis suggests, or by a policy.

    Raises as `Plan.of`.
    """
    kind = arguments.excitation
    if arguments.release is not None:
        if kind is not None or arguments.amplitude is not None:
            raise InputError("--release lets the joint go without torque: leave out --excitation and --amplitude")
        return STILL, arguments.seconds or SECONDS, arguments.release
    for option, only in (("policy", LEARNT), ("diagnosis", SUGGESTED)):
        if getattr(arguments, option) is not None and kind != only:
            raise InputError(f"--{option} goes with --excitation {only} only")
    if kind in (LEARNT, SUGGESTED) and arguments.amplitude is not None:
        bound = "the policy decides as the arm moves" if kind == LEARNT else "`diagnose --max-torque` bounds its torque"
        raise InputError(f"--amplitude does not go with --excitation {kind}: {bound}")
    if kind == LEARNT:
        if arguments.replay is not None or arguments.backend == "simulated":
            raise InputError(f"--excitation {LEARNT} needs a backend that answers step by step: use --backend pymunk")
        seconds = arguments.seconds or (EPISODE if arguments.until is None else LONGEST)
        network = load(arguments.policy or "peak")
        if network.constraint not in CONSTRAINTS:
            raise InputError(f"policy {arguments.policy} chooses the motion of an arm: give its --robot FILE")
        return Pilot(network, network.constraint, seconds, rate), seconds, None
    if kind == SUGGESTED:
        if arguments.diagnosis is None:
            raise InputError(f"--excitation {SUGGESTED} needs --diagnosis FILE, which `diagnose --json FILE` writes")
        suggestion = read_suggestion(arguments.diagnosis)
        return suggestion.signal or STILL, arguments.seconds or suggestion.seconds, suggestion.release
    seconds = arguments.seconds or (SECONDS if arguments.until is None else LONGEST)
    if arguments.until is not None and kind is None:
        return make_separating_signal(arguments.amplitude), seconds, None
    return excitation(kind or "paper", rng, seconds, arguments.amplitude), seconds, None


def _configured(arguments: argparse.Namespace) -> RigConfig | None:
    """Configuration of the rig, if one is to be recorded; raises as `Plan.of`."""
    if (arguments.backend == "dm1015b") != (arguments.config is not None):
        raise InputError("--backend dm1015b and --config FILE belong together: give both or neither")
    if arguments.config is None:
        return None
    if arguments.effects or arguments.theta is not None:
        raise InputError("--effect and --theta do not go with a rig: it has the plant that it has")
    if not arguments.output.lower().endswith(".csv"):
        raise InputError(f"{arguments.output}: a rig is recorded row by row as it runs: let the name end in .csv")
    return config.load(arguments.config)


def record_rig(plan: Plan, steps: int, terminal: Terminal) -> None:
    """Record the rig, row by row: what was measured up to a fault or an interrupt is kept.

    Raises InputError if there is a fault, Interrupted if somebody interrupts it, and OSError if the disk does not take
    it all; it says what is kept.
    """
    output, rate, last = plan.arguments.output, plan.rate, dict[str, Any]()
    late: list[float] = []

    def watch(info: dict[str, Any]) -> None:
        last.update(info)
        late.append(info["jitter"])
        if len(late) % rate < 1:
            show(f"{info['time']:.0f} s", len(late) / steps)

    judge: Apart | None = None
    env = RecordMeasurements(plan.environment(), output, overwrite=True)
    try:
        judge = Apart(rate, find_smoothing(env, rate)) if plan.arguments.until is not None else None
        if plan.remark:
            terminal.say(plan.remark)
        with terminal.progress("running") as show:
            until = None if judge is None else judge.stands
            recording = rollout(env, plan.controller(rate), steps, watch=watch, until=until)
    except (DriveError, RecordingError) as error:
        raise InputError(last.get("fault") or str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted(f"what was measured until then is in {output}" if late else "nothing was measured") from None
    finally:
        env.close()
    jitter = 1e3 * np.percentile(late, (50, 99))
    terminal.say(
        f"samples {jitter[0]:.2g} ms after their tick, 99 % within {jitter[1]:.2g} ms; {last['overruns']} ticks missed"
    )
    # [s]: what is interpolated over more than that is no measurement
    if (worst := max(late)) > 0.03:
        terminal.say(
            f"at worst {1e3 * worst:.0f} ms late, over which samples are interpolated: a diagnosis would find that, "
            "record again on a machine that does nothing else, or with realtime = true"
        )
    describe(recording, terminal)
    if judge is not None:
        terminal.say(verdict_text(judge.close(), len(recording) < steps))
    if "fault" in last:
        raise InputError(f"{last['fault']}; what was measured until then is in {output}")
    wrote([output], terminal)


def describe(recording: Recording, terminal: Terminal) -> None:
    """Say what was recorded."""
    turns, peak = np.ptp(recording.position) / (2 * np.pi), np.abs(recording.torque).max()
    terminal.say(f"{len(recording) / recording.rate:.4g} s at {recording.rate:.4g} Hz, {len(recording)} samples")
    terminal.say(f"the arm covers {turns:.2g} turns under up to {peak:.2g} N m")


def record_arm(
    arguments: argparse.Namespace, seconds: float, samples: int, rng: np.random.Generator, terminal: Terminal
) -> None:
    """Design a motion, let the simulated arm follow it, and write what it did."""
    for option, own in (("excitation", (LEARNT,)), ("backend", ("pymunk", "mujoco"))):
        if (asked := getattr(arguments, option)) not in (None, *own):
            raise InputError(f"--{option} {asked} is for pendulums: arms know {' and '.join(own)} alone")
    if arguments.policy is not None and arguments.excitation != LEARNT:
        raise InputError(f"--policy goes with --excitation {LEARNT} only")
    body = robot_of(arguments).body()
    tell_held(body, [], terminal)
    arm = _simulated(arguments, body)
    with terminal.progress("choosing the motion"):
        motion = _motion(arguments, arguments.excitation == LEARNT, body, seconds, rng)
    with terminal.progress("simulating") as tell:
        recording = follow(arm, motion, samples, arguments.amplitude, rng=rng, name=arguments.output, progress=tell)
    if not (np.abs(recording.position) <= LARGE).all():  # nor NaN
        raise InputError(f"the joints turn by more than {LARGE:g} rad: hide less, or allow less torque")
    write_recording(recording, arguments.output)
    terminal.say(recording.summary)
    terminal.say(f"the joints follow {motion}, condition of the regressor {motion.condition:.3g}")
    off = np.sqrt(np.mean((motion(recording.time)[0] - recording.position) ** 2, axis=0))
    rows = [
        (
            name,
            f"{joint.position.min():.2f} to {joint.position.max():.2f}{' m' * slides}",
            f"{rms:.2g}{' m' * slides}",
            f"{np.abs(joint.torque).max():.3g}{' N' * slides}",
        )
        for name, joint, rms, slides in zip(recording.names, recording.joints, off.tolist(), body.slides, strict=True)
    ]
    terminal.table(("joint", "angle [rad]", "off its reference [rad]", "largest torque [N m]"), rows)
    if arguments.effects:
        terminal.say(f"hidden: {listing([re.split('[=:]', text)[0] for text in arguments.effects])}")
    wrote([arguments.output], terminal)


def _motion(
    arguments: argparse.Namespace, learnt: bool, body: Body, seconds: float, rng: np.random.Generator
) -> Reference:
    """The reference that is asked for, within the limits; raises InputError if a policy is none for this arm."""
    limits = {"max_angle": arguments.max_angle, "max_speed": arguments.max_speed, "max_torque": arguments.amplitude}
    limits["max_acceleration"] = arguments.max_acceleration
    if learnt:
        return plan_motion(load(arguments.policy or ARM), body, find_limits(body, **limits), seconds)
    return design_excitation(body, seconds, **limits, rng=rng)


def _simulated(arguments: argparse.Namespace, body: Body) -> SimulatedArm:
    """The arm in pymunk if all joints turn in a vertical plane, else, or where that is asked for, in MuJoCo."""
    seen = {"rate": arguments.rate, "counts": arguments.counts, "torque_noise": arguments.noise}
    seen |= {"effects": arguments.effects, "max_torque": MOST_TORQUE}
    if arguments.backend != "mujoco":
        try:
            links = planar_links(body)
            steps = max(1, round(1000.0 / arguments.rate))  # [Hz], of the simulator's steps at least
            # velocities as the controller sees them
            return PlanarArm(links, joints=body.joints, substeps=steps, velocity="ideal", **seen)
        except BodyError:
            if arguments.backend is not None:
                raise
    return SpatialArm(body, **seen)


class Here:
    """Diagnoses sample by sample, as the run waits; a verdict stands once its first effect has led for a while."""

    steady = 2.0  # [s]

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Take the samples per second [Hz], and the smoothing of the measurement."""
        self._diagnoser = Diagnoser(rate, smoothing=smoothing)
        self._leader, self._since = "", np.inf  # effect, and time since when it leads [s]

    def stands(self, info: dict[str, Any]) -> bool:
        """Take in a sample; whether a verdict stands."""
        return self.take([(info["time"], info["position"], info["torque"])])

    def take(self, samples: Sequence[Sample]) -> bool:
        """Take in samples; whether a verdict stands."""
        for time, position, torque in samples:
            (found,) = self._diagnoser.take(*(np.array([value]) for value in (time, position, torque)))
            leader = found.group[0] if found.kind == "missing" else ""
            if leader != self._leader:
                self._leader, self._since = leader, time if leader else np.inf
        return bool(samples and time - self._since >= self.steady)

    def close(self) -> OnlineDiagnosis:
        """Return the final diagnosis."""
        return self._diagnoser.diagnoses[0]


class Apart:
    """Diagnoses in a process of its own: a motor does not wait for a grid that is refined."""

    together = 50  # samples that are sent at once
    ready = 60.0  # [s] in which the process has to be there

    def __init__(self, rate: float, smoothing: Smoothing) -> None:
        """Start the process; takes what `Here` does.

        Raises OSError if it does not come up.
        """
        self._worker = Worker("diagnosis")
        self._worker.send(partial(_diagnose_samples, rate, smoothing))
        if not self._worker.connection.poll(self.ready) or isinstance(self._worker.hear(), End):
            self._worker.end()
            raise OSError("the process that diagnoses did not start: try again on a machine that does less")
        self._waiting: list[Sample] = []
        self._stands = False

    def stands(self, info: dict[str, Any]) -> bool:
        """Take in a sample; whether a verdict stood some samples ago."""
        self._waiting.append((info["time"], info["position"], info["torque"]))
        if len(self._waiting) >= self.together and not self._stands:
            self._worker.send(self._waiting)
            self._waiting = []
            while self._worker.connection.poll():
                self._stands = self._worker.hear() is True or self._stands
        return self._stands

    def close(self) -> OnlineDiagnosis:
        """Return the final diagnosis after all samples.

        Raises OSError if the process has died.
        """
        if not self._stands:
            self._worker.send(self._waiting)
        self._worker.send(None)
        while not isinstance(word := self._worker.hear(), End):
            pass
        self._worker.end()
        if word.why:
            raise OSError(f"what was measured has no verdict: {word.why}")
        found: OnlineDiagnosis = word.came
        return found


def _diagnose_samples(rate: float, smoothing: Smoothing, connection: Connection[Any, Any]) -> OnlineDiagnosis:
    attend()
    ordinary()  # a motor's loop, which began this, may be more urgent
    judge = Here(rate, smoothing)
    connection.send(False)
    while (samples := connection.recv()) is not None:
        connection.send(judge.take(samples))
    return judge.close()


def verdict_text(found: OnlineDiagnosis, stands: bool) -> str:
    """The verdict in words, and what was not tried, which may look like what was."""
    after = f"after {found.motion:.1f} s of motion"
    if found.kind == "calibrating":
        return "too short to tell what is missing: record some seconds more of motion"
    verdict = f"nothing is surely missing {after}"
    if found.kind == "missing":
        standing = "the verdict stands" if stands else "the verdict does not stand yet"
        verdict = f"missing: {listing([name(id) for id in found.group], 'or')} ({standing}, {after})"
    elif found.kind == "changed":
        verdict = f"changed during the run: {listing([name(id) for id in found.changed], 'and')} ({after})"
    if not found.not_run:
        return verdict
    others = listing([name(id) for id in found.not_run], "and")
    return f"{verdict}\nnot tried, as only `diagnose` on the recording does: {others}"
