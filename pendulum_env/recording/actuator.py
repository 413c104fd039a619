"""Actuators of a joint: how the torque of a recording was made."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from pendulum_env.errors import UserError
from pendulum_env.plugins import load_plugins
from pendulum_env.recording.channel import NEWTON_METRE

ENTRY_POINTS = "pendulum_ident.actuators"  # functions from the settings of a study to an actuator


@dataclass(frozen=True)
class Actuator:
    """Motor with logged or zero torque; subclasses follow a reference by a known law.

    Attributes:
        is_controller: whether the torque follows a reference.
        acts_on_speed, acts_on_position: quantity of the reference.
    """

    is_controller: ClassVar[bool] = False

    @property
    def acts_on_speed(self) -> bool:
        """Return whether the reference is a speed."""
        return False

    @property
    def acts_on_position(self) -> bool:
        """Return whether the reference is a position."""
        return False

    @property
    def unit(self) -> str:
        """Return the unit of the torque."""
        return NEWTON_METRE

    @property
    def output_name(self) -> str:
        """Return the name of a column with the output of the controller, such as `duty`."""
        return ""

    @property
    def logged_unit(self) -> str | None:
        """Return the unit of a logged output, from which the torque follows; None if torque is logged as it is."""
        return None

    @property
    def has_integral(self) -> bool:
        """Return whether the torque depends on an integral of unknown initial value."""
        return False

    @property
    def conventions(self) -> dict[str, str | None]:
        """Return settings that a fit may decide, by name; None for an open one."""
        return {}

    def check_columns(self, quantities: Collection[str]) -> None:
        """Raise a RecordingError if a quantity that the actuator needs is missing in a file."""

    def with_gain(self, gain: float, unit: str) -> Self:
        """Return the actuator with a torque per `unit`; unchanged if its torque is in another unit."""
        return self

    def get_settings(self) -> dict[str, str | float]:
        """Return the settings of a study that make the actuator."""
        return {}


MOTOR = Actuator()


def parse_actuator(settings: Mapping[str, Any]) -> Actuator | None:
    """Make the actuator of the settings `drive` of a study by an installed package; None without settings."""
    if not settings:
        return None
    parsers: tuple[Callable[[Mapping[str, Any]], Actuator], ...] = load_plugins(ENTRY_POINTS)
    if not parsers:
        raise UserError("no installed package has drives: install pendulum-ident again to register its own")
    return parsers[0](settings)
