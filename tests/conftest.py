"""What several tests share."""

import signal

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from scipy.integrate import solve_ivp

from pendulum_env.recording import Recording
from tests import once
from tests.pendulum_env.rigs import until_in_time

# a busy machine is no mistake: no test asserts how long it takes
settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")

# as where a shell runs the tests behind: commands would inherit it
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # once, by the process that starts the others
        once.forget()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What runs against the clock does so until it was in time."""
    for item in items:
        if isinstance(item, pytest.Function) and item.get_closest_marker("realtime"):
            item.obj = until_in_time(item.obj)


@pytest.fixture(scope="session")
def swing() -> Recording:
    """4 s of a driven pendulum at 500 Hz, several radians wide, integrated without any code of this project."""
    time = np.arange(2000) / 500.0

    def torque(t: float) -> float:
        return 3 * np.sin(12.07 * t) + 3 * np.sin(2.25 * t + 1)

    def slope(t: float, state: np.ndarray) -> list[float]:
        q, v = state
        return [v, (torque(t) - 2.0 * np.sin(q) - 0.3 * v - 0.3 * np.tanh(v / 0.01)) / 0.08]

    position, velocity = solve_ivp(slope, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-7, max_step=0.01).y
    return Recording(time, position, torque(time), velocity, name="swing")
