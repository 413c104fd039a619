"""Recording of a pendulum: simulated, replayed, or row by row on the rig."""

from typing import Any

import gymnasium as gym
import numpy as np

from agents.observer import Pilot
from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import Recording, RecordingError
from pendulum_env.registration import PENDULUM
from pendulum_env.spaces import MAX_TORQUE
from pendulum_env.wrappers import RecordMeasurements
from workbench.errors import InputError, Interrupted
from workbench.outputs import report_files
from workbench.runs import Plan
from workbench.terminal import Terminal


def simulate(plan: Plan, rng: np.random.Generator, terminal: Terminal) -> Recording:
    """Record a simulated or replayed pendulum with the requested backend."""
    arguments, command, seconds = plan.arguments, plan.command, plan.seconds
    if not isinstance(command, Pilot) and arguments.backend in (None, "simulated"):
        with terminal.progress("simulating"):
            sensor = plan.rate, arguments.counts, TORQUE_NOISE
            return record(plan.plant, command, seconds, *sensor, rng=rng, release=plan.release)
    env = make_environment(plan)
    rate = env.unwrapped.rate  # type: ignore[attr-defined]
    steps = round(seconds * rate)
    with terminal.progress("running") as progress:
        return rollout(
            env,
            _make_controller(plan, rate),
            steps,
            seed=int(rng.integers(2**31)),
            watch=lambda info: progress(f"{info['time']:.0f} s", info["time"] / seconds),
        )


def record_rig(plan: Plan, steps: int, terminal: Terminal) -> None:
    """Record the rig row by row; rows up to a fault or an interrupt are kept.

    Raises InputError after a fault, Interrupted after an interrupt, and OSError if the disk is full.
    """
    output, rate, last = plan.arguments.output, plan.rate, dict[str, Any]()
    late: list[float] = []

    def watch(info: dict[str, Any]) -> None:
        last.update(info)
        late.append(info["jitter"])
        if len(late) % rate < 1:
            show(f"{info['time']:.0f} s", len(late) / steps)

    env = RecordMeasurements(make_environment(plan), output, overwrite=True)
    try:
        if plan.remark:
            terminal.print(plan.remark)
        with terminal.progress("running") as show:
            recording = rollout(env, _make_controller(plan, rate), steps, watch=watch)
    except (DriveError, RecordingError) as error:
        raise InputError(last.get("fault") or str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted(f"what was measured until then is in {output}" if late else "nothing was measured") from None
    finally:
        env.close()
    jitter = 1e3 * np.percentile(late, (50, 99))
    terminal.print(
        f"samples {jitter[0]:.2g} ms after their tick, 99 % within {jitter[1]:.2g} ms; {last['overruns']} ticks missed"
    )
    # [s]; interpolation over a longer gap is no measurement
    if (worst := max(late)) > 0.03:
        terminal.print(
            f"the largest delay is {1e3 * worst:.0f} ms, and samples over it are interpolated. A diagnosis may take "
            "this for an effect: record again on an idle computer, or with realtime = true"
        )
    describe_recording(recording, terminal)
    if "fault" in last:
        raise InputError(f"{last['fault']}; what was measured until then is in {output}")
    report_files([output], terminal)


def _make_controller(plan: Plan, rate: float) -> OpenLoop | Pilot:
    """Create the controller at a rate [Hz]."""
    return plan.command if isinstance(plan.command, Pilot) else OpenLoop(plan.command, rate)


def make_environment(plan: Plan) -> gym.Env[Any, Any]:
    """Create the environment of a simulated plant, a replayed recording, or the rig (connected, without power).

    Raises InputError if the rig is not reachable or in use.
    """
    arguments = plan.arguments
    if plan.rig is not None:
        try:
            return gym.make(PENDULUM, max_episode_steps=-1, backend="dm1015b", config=str(plan.rig.path))
        except DriveError as error:
            raise InputError(str(error)) from None
    plant: dict[str, Any] = {"model": plan.plant, "rate": plan.rate} if arguments.replay is None else {}
    return gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=arguments.backend or "pymunk",
        **plant,
        counts=arguments.counts,
        torque_noise=TORQUE_NOISE,
        max_torque=max(MAX_TORQUE, plan.command.amplitude),
        recording=arguments.replay,
    )


def describe_recording(recording: Recording, terminal: Terminal) -> None:
    """Print the duration, rate, range of angles and largest torque of a recording."""
    turns, peak = np.ptp(recording.position) / (2 * np.pi), np.abs(recording.torque).max()
    terminal.print(f"{len(recording) / recording.rate:.4g} s at {recording.rate:.4g} Hz, {len(recording)} samples")
    terminal.print(f"the arm covers {turns:.2g} turns under up to {peak:.2g} N m")
