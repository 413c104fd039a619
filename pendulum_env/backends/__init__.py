"""Where measurements come from."""

from pendulum_env.backends.simulated import record

__all__ = ["record"]
