"""Integrators that share no code with the packages: Runge-Kutta in plain arithmetic, and DOP853 with dry friction."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

Rate = Callable[..., Sequence[float]]
Law = Callable[[float, float, float, float], float]  # of time, position, velocity and command


def step_runge_kutta(rate: Rate, t: float, x: Sequence[float], step: float) -> list[float]:
    """States after a step from x at time t, where `rate(t, *x)` gives their derivatives."""

    def moved(slopes: Sequence[float], by: float) -> list[float]:
        return [one + by * slope for one, slope in zip(x, slopes, strict=True)]

    first = rate(t, *x)
    second = rate(t + step / 2, *moved(first, step / 2))
    third = rate(t + step / 2, *moved(second, step / 2))
    last = rate(t + step, *moved(third, step))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(first, second, third, last, strict=True)]
    return moved(mean, step)


def simulate_stick_slip(
    net: Law, dry: Law, inertia: float, command: Sequence[float], period: float, start: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity (N + 1,) and whether each period ends in stick, from event to event with DOP853.

    `net` is the torque on the joint but for dry friction, whose magnitude is `dry`; commands are held for a period.
    """
    q, v = start
    direction, path, stuck = np.sign(v), [start], [False]

    def slope(t: float, x: np.ndarray, u: float, direction: float) -> list[float]:
        return [x[1], (net(t, *x, u) - direction * dry(t, *x, u)) / inertia]

    def spare(t: float, q: float, u: float) -> float:
        return dry(t, q, 0.0, u) - abs(net(t, q, 0.0, u))

    for k, u in enumerate(command):
        t, end = k * period, (k + 1) * period
        while t < end:
            if direction == 0:
                if spare(t, q, u) >= 0:
                    if spare(end, q, u) >= 0:
                        break
                    t = brentq(spare, t, end, (q, u))  # friction fades, or the load grows, while the joint rests
                direction = np.sign(net(t, q, 0.0, u))
                a, ahead = slope(t, np.array([q, 0.0]), u, direction)[1], 1e-9  # off the zero of the event
                t, q, v = t + ahead, q + 0.5 * a * ahead**2, a * ahead
            stop = lambda t, x, *_: x[1]  # noqa: E731
            stop.terminal, stop.direction = True, -direction
            leg = solve_ivp(slope, (t, end), [q, v], "DOP853", rtol=1e-10, atol=1e-12, events=stop, args=(u, direction))
            (q, v), t = leg.y[:, -1], leg.t[-1]
            if leg.status == 1:
                v, direction = 0.0, 0.0
        path.append((q, v))
        stuck.append(direction == 0)
    return *np.transpose(path), np.array(stuck)
