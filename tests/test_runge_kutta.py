"""The integrator of several tests, against a closed form."""

from math import cos, hypot, sin

from tests.runge_kutta import stepped


def test_a_driven_oscillator_is_followed_to_the_fourth_order():
    def error(steps: int) -> float:
        x, step = [1.0, 0.5], 2.0 / steps
        for k in range(steps):
            x = stepped(lambda t, q, v: (v, 3 * cos(2 * t) - q), k * step, x, step)
        exact = 2 * cos(2.0) + 0.5 * sin(2.0) - cos(4.0), -2 * sin(2.0) + 0.5 * cos(2.0) + 2 * sin(4.0)
        return hypot(x[0] - exact[0], x[1] - exact[1])

    assert error(40) < 1e-6
    assert 12 < error(40) / error(80) < 20
