"""Classical Runge-Kutta in plain arithmetic: shares no code with the packages, and is fast for a few states."""

from collections.abc import Callable, Sequence

Rate = Callable[..., Sequence[float]]


def stepped(rate: Rate, t: float, x: Sequence[float], step: float) -> list[float]:
    """States after a step from x at time t, where `rate(t, *x)` gives their derivatives."""

    def moved(slopes: Sequence[float], by: float) -> list[float]:
        return [one + by * slope for one, slope in zip(x, slopes, strict=True)]

    first = rate(t, *x)
    second = rate(t + step / 2, *moved(first, step / 2))
    third = rate(t + step / 2, *moved(second, step / 2))
    last = rate(t + step, *moved(third, step))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(first, second, third, last, strict=True)]
    return moved(mean, step)
