"""Actuators of a joint: how the torque of a recording was made."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from pendulum_env.errors import UserError
from pendulum_env.lookup import find
from pendulum_env.plugins import load_plugins, make_missing_error
from pendulum_env.recording.channel import NEWTON_METRE

ENTRY_POINTS = "pendulum_ident.actuators"  # classes of actuators


@dataclass(frozen=True)
class Actuator:
    """Motor with logged or zero torque, and base class of actuators that follow a reference by a known law."""

    is_controller: ClassVar[bool] = False  # whether the torque follows a reference
    convention_names: ClassVar[tuple[str, ...]] = ()  # settings that a fit may decide
    text_settings: ClassVar[tuple[str, ...]] = ()  # settings with a text; others have a number

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

    def select_joint(self, joint: str) -> Actuator:
        """Return the actuator of a joint: this one, which all joints have."""
        return self

    def list_joints(self) -> tuple[str, ...]:
        """Return the joints that have settings of their own."""
        return ()

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
        """Return the settings of `convention_names`; None for an open one."""
        return {name: getattr(self, name) for name in self.convention_names}

    def check_columns(self, quantities: Collection[str]) -> None:
        """Raise a RecordingError if a quantity that the actuator needs is missing in a file."""

    def with_gain(self, gain: float, unit: str) -> Self:
        """Return the actuator with a torque per `unit`; unchanged if its torque is in another unit."""
        return self

    def complete_conventions(self, settings: Mapping[str, Any]) -> Self:
        """Return the actuator with the settings of a log format that it leaves open; unchanged without conventions."""
        return self

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Self:
        """Make an actuator of the settings of a study; raises a UserError if they are invalid."""
        return cls(**settings)

    @classmethod
    def describe_settings(cls) -> str:
        """Describe the settings for the help of the command line: an example and the names."""
        return ""

    def get_settings(self) -> dict[str, str | float]:
        """Return the settings of a study that make the actuator."""
        return {}


MOTOR = Actuator()


@dataclass(frozen=True)
class JointActuators(Actuator):
    """Actuators of the joints of an arm.

    Attributes:
        common: settings of all joints.
        own: further settings by joint.
    """

    common: Mapping[str, Any] = field(hash=False)
    own: Mapping[str, Mapping[str, Any]] = field(hash=False)
    is_controller: ClassVar[bool] = True

    def select_joint(self, joint: str) -> Actuator:
        """Return the actuator of a joint; raises a UserError if it has no settings."""
        actuator = parse_actuator({**self.common, **self.own.get(joint, {})})
        if actuator is None:
            raise UserError(f"has no drive: write [drive] for all joints, or [drive.{joint}]")
        return actuator

    def list_joints(self) -> tuple[str, ...]:
        """Return the joints that have settings of their own."""
        return tuple(self.own)

    def get_settings(self) -> dict[str, Any]:
        """Return the settings of a study that make the actuators."""
        return {**self.common, **{joint: dict(settings) for joint, settings in self.own.items()}}


@contextmanager
def name_joint_errors(joint: str) -> Iterator[None]:
    """Add a joint to errors on the settings of its actuator within a block."""
    try:
        yield
    except UserError as error:
        raise UserError(f"joint '{joint}': {error}") from None


def parse_actuator(settings: Mapping[str, Any]) -> Actuator | None:
    """Make the actuator of the table `drive` of a study by an installed package; None without settings.

    A table within it has settings of one joint: `[drive.elbow]`. The setting `kind` names the entry point, if several
    packages have one.
    """
    if not settings:
        return None
    if own := {name: value for name, value in settings.items() if isinstance(value, Mapping)}:
        common = {name: value for name, value in settings.items() if name not in own}
        for joint, more in own.items():
            with name_joint_errors(joint):
                parse_actuator({**common, **more})
        return JointActuators(common, own)
    kinds, others = list_actuators(), {name: value for name, value in settings.items() if name != "kind"}
    if not kinds:
        raise make_missing_error(ENTRY_POINTS, "has drives")
    if len(kinds) > 1 and "kind" not in settings:
        raise UserError(f"several kinds of drives are installed: give kind, one of {', '.join(kinds)}")
    kind = find("kind of drive", str(settings["kind"]), kinds) if "kind" in settings else next(iter(kinds.values()))
    return kind.from_settings(others)


def list_conventions() -> set[str]:
    """List the names of the conventions of all installed actuators."""
    return {name for kind in list_actuators().values() for name in kind.convention_names}


def list_actuators() -> dict[str, type[Actuator]]:
    """List the installed classes of actuators by the name of their entry point."""
    plugins = load_plugins(ENTRY_POINTS)
    return {name: kind for name, kind in plugins.items() if isinstance(kind, type) and issubclass(kind, Actuator)}
