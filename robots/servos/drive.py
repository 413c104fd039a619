"""Drive of a servo: controller and motor, from goal and joint motion to torque.

    u = kp (goal - q) - kd q' + ki int (goal - q) dt        position control; or + kd (goal - q)' for - kd q'
    u = kp (goal - q') + ki int (goal - q') dt              velocity control

The output u is held between the controller's updates, limited, delayed, and zero without power; q' is the mean speed
between two updates. u is a share of the supply (duty), a voltage, a current or a torque. The motor torque is in N m if
the gain is known, and otherwise in V or A, as are the parameters.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Literal, NamedTuple, Self, get_args

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError, UserError
from pendulum_env.lookup import find
from pendulum_env.reading import quote_value
from pendulum_env.recording.actuator import Actuator
from pendulum_env.recording.vocabulary import OUTPUTS

Control = Literal["position", "velocity"]
Output = Literal["duty", "voltage", "current", "torque"]
Goal = Literal["held", "ramp"]
Shaft = Literal["motor", "output"]
Reading = Literal["exact", "counts"]
Windup = Literal["stop", "clamp", "free"]
Order = Literal["after", "before"]
Derivative = Literal["velocity", "error"]
CHOICES: Mapping[str, Any] = {
    "control": Control,
    "output": Output,
    "goal": Goal,
    "encoder": Shaft,
    "reads": Reading,
    "windup": Windup,
    "integral": Order,
    "derivative": Derivative,
}
CONTROLLER = ("windup", "integral", "derivative")  # open details of a controller's law
CONVENTIONS = ("goal", "reads", *CONTROLLER)  # may be None: simulated as the first choice, until a fit decides
LONGEST_DELAY = 0.1  # [s], largest delay
# unit of the motor torque if the gain is unknown
OUTPUT_UNITS = {"duty": "V", "voltage": "V", "current": "A", "torque": "N m"}


@dataclass(frozen=True)
class ServoDrive(Actuator):
    """Controller and motor of a servo.

    Attributes:
        control: quantity of the goal, position [rad] or velocity [rad/s].
        output: quantity of the controller's output.
        kp: proportional gain [output/rad, or output s/rad].
        ki: integral gain [output/(rad s), or output/rad].
        kd: derivative gain of position control [output s/rad].
        limit: largest output; 1 for a duty.
        supply: bus voltage [V] of recordings without a column of it.
        gain: motor torque per volt or ampere, gear included [N m/V or N m/A]; None: unknown.
        rate: update rate of the controller [Hz]; None: continuous, with exact speed.
        cutoff: cutoff frequency of the low-pass filter of the measured speed [Hz]; None: no filter.
        delay: time from measurement to action [s].
        goal: course of the goal between rows of the log, held or smooth; None: unknown, simulated as `held`.
        encoder: shaft of the encoder, at the motor or at the output, behind the gear's play and elasticity.
        reads: whether position control reads the counts of the encoder, as the log, or the exact position; None:
            unknown, simulated as `exact`.
        windup: integral at the output limit: `stop` stops it, `clamp` clamps ki times the integral to the limit,
            `free` lets it grow; None: unknown, simulated as `stop`.
        integral: whether an update adds its error to the integral after or before it computes the output, for a known
            `rate`; None: unknown, simulated as `after`.
        derivative: whether kd acts on the measured velocity or on the derivative of the error, which includes the
            velocity of the goal; None: unknown, simulated as `velocity`.
    """

    control: Control = "position"
    output: Output = "duty"
    kp: float = 1.0
    ki: float = 0.0
    kd: float = 0.0
    limit: float = math.inf
    supply: float | None = None
    gain: float | None = None
    rate: float | None = None
    cutoff: float | None = None
    delay: float = 0.0
    goal: Goal | None = None
    encoder: Shaft = "motor"
    reads: Reading | None = None
    windup: Windup | None = None
    integral: Order | None = None
    derivative: Derivative | None = None
    is_controller: ClassVar[bool] = True
    convention_names: ClassVar[tuple[str, ...]] = CONVENTIONS
    text_settings: ClassVar[tuple[str, ...]] = ("preset", *CHOICES)

    def __post_init__(self) -> None:
        for name, literal in CHOICES.items():
            value, choices = getattr(self, name), get_args(literal)
            if value not in choices and not (name in CONVENTIONS and value is None):
                raise UserError(f"{name} is {quote_value(value)}: it should be {' or '.join(choices)}")
        for name in ("kp", "ki", "kd", "delay"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise UserError(f"{name} is {getattr(self, name):g}: it should be 0 or a positive number")
        for name in ("limit", "supply", "gain", "rate", "cutoff"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and (math.isfinite(value) or name == "limit")):
                raise UserError(f"{name} is {value:g}: it should be a positive number")
        if self.integral == "before" and self.rate is None:
            raise UserError('integral is "before": give the rate of the controller as well, as rate = 100')
        if self.kp == self.ki == 0:
            raise UserError("kp and ki are both 0: such a controller does not follow its goal, say its gain")
        if self.delay > LONGEST_DELAY:
            raise UserError(f"delay is {self.delay:g} s: no controller is later than {LONGEST_DELAY:g} s")

    @property
    def unit(self) -> str:
        """Return the unit of the motor torque: `N m`, or V or A if the gain is unknown."""
        return "N m" if self.gain is not None else OUTPUT_UNITS[self.output]

    @property
    def output_name(self) -> str:
        """Return the name of a column with the output."""
        return self.output

    def check_columns(self, quantities: Collection[str]) -> None:
        """Raise a RecordingError if a duty has no supply, neither here nor in the file."""
        if self.output == "duty" and self.supply is None and "supply" not in quantities:
            raise RecordingError(
                "a duty is a share of the supply: name its column (supply=...), or give the drive a supply [V]"
            )

    @property
    def logged_unit(self) -> str | None:
        """Return the unit of a logged output: a duty, a current, or a voltage."""
        return OUTPUTS.get(self.output)

    @property
    def has_integral(self) -> bool:
        """Return whether the controller has an integral part."""
        return self.ki > 0

    @property
    def max_output(self) -> float:
        """Return the largest output."""
        return min(self.limit, 1.0) if self.output == "duty" else self.limit

    def torque(self, goal: Array, position: Array, velocity: Array, supply: Array, is_powered: Array) -> Array:
        """Return the commanded torque (N,) [unit] along a measured motion, from kp and -kd q' only."""
        error = goal - (velocity if self.acts_on_speed else position)
        output = self.kp * error - (0.0 if self.acts_on_speed else self.kd * velocity)
        return np.asarray(is_powered * self.scale(supply) * np.clip(output, -self.max_output, self.max_output))

    def scale(self, supply: Array) -> Array:
        """Return the torque [unit] per unit of output at a supply [V]."""
        volts = supply if self.output == "duty" else np.ones_like(supply)
        return volts if self.gain is None else volts * self.gain

    @property
    def open_conventions(self) -> dict[str, tuple[str, ...]]:
        """Return the choices of each undeclared, relevant convention of `CONVENTIONS`, by name.

        The order of the integral is relevant only with a `rate`.
        """
        is_relevant = {
            "goal": True,
            "reads": self.acts_on_position,
            "windup": self.ki > 0 and math.isfinite(self.max_output),
            "integral": self.ki > 0 and self.rate is not None,
            "derivative": self.kd > 0 and self.acts_on_position,
        }
        names = (name for name in CONVENTIONS if is_relevant[name] and getattr(self, name) is None)
        return {name: get_args(CHOICES[name]) for name in names}

    def complete_conventions(self, settings: Mapping[str, Any]) -> Self:
        """Return the drive with the settings of its `open_conventions`; other settings are ignored."""
        return replace(self, **{name: settings[name] for name in self.open_conventions if name in settings})

    def with_gain(self, gain: float, unit: str) -> Self:
        """Return the drive with a gain per `unit`; unchanged if its torque is in another unit."""
        return replace(self, gain=gain) if self.unit == unit else self

    @property
    def acts_on_speed(self) -> bool:
        """Return whether the drive controls the speed."""
        return self.control == "velocity"

    @property
    def acts_on_position(self) -> bool:
        """Return whether the drive controls the position."""
        return self.control == "position"

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Self:
        """Make a drive from the settings of a study; with a preset, kp is in register units."""
        preset = find("preset", str(settings["preset"]), PRESETS) if "preset" in settings else Preset({})
        values: dict[str, Any] = dict(preset.base)
        for name, value in settings.items():
            if name in TEXT_KEYS:
                values[name] = value
            elif find("key of a drive", name, KEYS) and name != "preset":
                if isinstance(value, bool) or not isinstance(value, int | float):
                    raise UserError(f"{name} is {quote_value(value)}: it should be a number")
                if name in ("ki", "kd") and preset.kp != 1.0 and value >= 1:
                    unit = {"ki": "duty/(rad s)", "kd": "duty s/rad"}[name]
                    raise UserError(
                        f"{name} is {value:g}, that of a register with an unknown unit: leave it out, as kd is part "
                        f"of the viscous friction, or give it in {unit}; with a preset, kp alone is a register"
                    )
                values[name] = float(value) * (preset.kp if name == "kp" else 1.0)
        if not values.keys() & {"kp", "ki"}:
            raise UserError("the controller has no gain: give kp (or ki)")
        return cls(**values)

    @classmethod
    def describe_settings(cls) -> str:
        """Describe the settings by two examples and all names."""
        return f"as preset=xl330,kp=200 or output=duty,kp=0.6,supply=12: {', '.join(KEYS)}"

    def get_settings(self) -> dict[str, str | float]:
        """Return the settings that differ from the defaults, for `from_settings`."""
        default, values = vars(ServoDrive()), {name: getattr(self, name) for name in vars(ServoDrive())}
        settings = {name: value for name, value in values.items() if name == "kp" or value != default[name]}
        return {name: value if isinstance(value, str) else float(value) for name, value in settings.items()}


class Preset(NamedTuple):
    """Family of servos: common settings, and kp per register unit."""

    base: Mapping[str, Any]
    kp: float = 1.0


PRESETS = {  # servos with duty: values measured by github.com/Rhoban/bam, encoders at the output
    # Dynamixel XL330: duty = kp (goal - position) [counts] / (256 x 885)
    "xl330": Preset({"supply": 7.3, "encoder": "output"}, 4096 / math.tau / (256 * 885)),
    # Dynamixel XL-320: duty = 0.0505 kp (goal - position) [rad]
    "xl320": Preset({"supply": 7.5, "encoder": "output"}, 0.0505),
    # Dynamixel MX-64 and MX-106: duty = 0.158 kp (goal - position) [rad], 0.9625 at most
    "mx": Preset({"supply": 15.0, "limit": 0.9625, "encoder": "output"}, 0.158),
    # Feetech STS3215: duty = 0.166 kp (goal - position) [rad], 0.97 at most, below its largest speed
    "sts3215": Preset({"supply": 7.4, "limit": 0.97, "encoder": "output"}, 0.166),
    # MIT mode of quasi-direct drives (Mini Cheetah, Damiao, CubeMars): torque = kp (goal - position) - kd velocity at
    # the output, without goal velocity and feed-forward torque
    "mit": Preset({"output": "torque", "derivative": "velocity"}),
}
TEXT_KEYS = tuple(CHOICES)  # keys with text values
KEYS = dict.fromkeys(("preset", *vars(ServoDrive())), True)


def find_declared_conventions(drives: Sequence[ServoDrive]) -> dict[str, str]:
    """Return the first declared value of each convention, by name."""
    values = {name: [v for drive in drives if (v := getattr(drive, name)) is not None] for name in CONVENTIONS}
    return {name: declared[0] for name, declared in values.items() if declared}


def list_open_conventions(drives: Sequence[ServoDrive], names: Sequence[str]) -> list[dict[str, str]]:
    """Return all combinations of the drives' `open_conventions` of some names; without any, one empty combination."""
    choices = {name: options for drive in drives for name, options in drive.open_conventions.items() if name in names}
    choices = {name: choices[name] for name in names if name in choices}
    return [dict(zip(choices, values, strict=True)) for values in product(*choices.values())]
