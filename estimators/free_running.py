"""Free-running simulation against the measured position, in many short windows at once.

A one-second window started from the measured state is long enough for a wrong torque to show as a wrong motion, and
short enough that the errors of an unstable upright pendulum do not swamp everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_cdt

from estimators.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Term, simulate

SECONDS = 1.0  # length of a window


@dataclass(frozen=True)
class Flights:
    """Windows of one recording that a simulation has to follow: N periods, B windows.

    Attributes:
        windows: the recording they are cut from.
        first: index of the first sample of each window (B,).
        torque: held command in each period (N, B) [N m].
        position: measured (N + 1, B) [rad].
        velocity: measured at the start (B,) [rad/s].
    """

    windows: Windows
    first: Index
    torque: Array
    position: Array
    velocity: Array

    def before(self, delay: float) -> Array:
        """Commands before the first of every flight, as far back as `delay` [s] reaches, oldest first (M, B) [N m]."""
        recording = self.windows.recording
        reach = np.arange(-int(np.ceil(delay * recording.rate)) - 1, 0)[:, None] + self.first
        return np.where(reach >= 0, recording.torque[np.maximum(reach, 0)], 0.0)


def take_off(windows: Windows, seconds: float = SECONDS) -> Flights:
    """Cut a recording into flights that start where the velocity is known best, away from reversals."""
    recording = windows.recording
    length = min(round(seconds * recording.rate), windows.stop - windows.first - 1)
    clear = distance_transform_cdt(np.r_[False, np.diff(np.sign(windows.samples.velocity)) == 0] & windows.moving)
    clear = np.minimum(clear, len(windows.kernel))
    reach = round(0.2 * seconds * recording.rate)
    first = []
    earliest, latest = windows.first, windows.stop - length - 1
    for nominal in range(earliest, latest + 1, length):
        low, high = max(earliest, nominal - reach // 2), min(latest, nominal + reach)
        first.append(low + int(np.argmax(clear[low : high + 1])))
    starts = np.array(first or [earliest])
    index = starts + np.arange(length + 1)[:, None]
    return Flights(
        windows=windows,
        first=starts,
        torque=recording.torque[index[:-1]],
        position=np.vstack([windows.samples.position[starts], recording.position[index[1:]]]),
        velocity=windows.samples.velocity[starts],
    )


def follow(flights: Flights, terms: Sequence[Term], theta: Array) -> Array:
    """Simulated minus measured position in every flight, (N + 1, B) [rad]."""
    return fly(flights, terms, theta) - flights.position


def fly(flights: Flights, terms: Sequence[Term], theta: Array) -> Array:
    """Simulated position in every flight, (N + 1, B) [rad].

    Terms with memory start from the state that the measured motion up to then has left them in.
    """
    recording, first = flights.windows.recording, flights.first
    memory = {}
    for term in terms:
        if term.delay:
            continue  # a simulation delays the command itself
        (x,) = flights.windows.trace([term])
        memory.update({id: tuple(series[first] for series in state) for id, state in x.memory.items()})
    path = simulate(
        terms,
        theta,
        1.0 / recording.rate,
        flights.torque,
        flights.position[0],
        flights.velocity,
        recording.time[first],
        before=flights.before(sum(term.delay for term in terms)),
        memory=memory,
    )
    return path.position


def position_noise(flights: Sequence[Flights], terms: Sequence[Term], theta: Array) -> float:
    """Root mean square position error that the noise of the torque channel and of the initial state gives [rad]."""
    rng = np.random.default_rng(0)
    errors = []
    for flight in flights:
        w = flight.windows
        shaken = replace(
            flight,
            torque=flight.torque + w.raw_torque_noise * rng.standard_normal(flight.torque.shape),
            velocity=flight.velocity + w.velocity_noise * rng.standard_normal(flight.velocity.shape),
        )
        errors.append((fly(shaken, terms, theta) - fly(flight, terms, theta))[1:].ravel())
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def position_rms(flights: Sequence[Flights], terms: Sequence[Term], theta: Array) -> float:
    """Root mean square of the position error over all flights [rad]."""
    errors = [follow(flight, terms, theta)[1:].ravel() for flight in flights]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
