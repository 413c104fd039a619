"""Options of commands, told by texts like those of `--help`, and what becomes of what is typed."""

import argparse
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from inspect import cleandoc
from pathlib import Path
from typing import Any, TypeVar

from pendulum_env.lookup import find
from pendulum_env.physics import Term, list_nameable
from pendulum_env.plant import hide, paper_plant, read_parameters
from pendulum_env.reading import LARGE, quote_value
from pendulum_env.recording.columns import refuse_unknown_quantity, strip_joint
from pendulum_env.recording.vocabulary import TOLD
from pendulum_env.servo.drive import KEYS, WORDS, ServoDrive
from workbench.errors import InputError

T = TypeVar("T")
Number = TypeVar("Number", int, float)
Declared = tuple[list[str], dict[str, Any]]  # names of an option, and what `add_argument` takes of it
COUPLING = "coupling"  # of two joints: no effect of a pendulum
FORMATS = "CSV, Parquet, NPZ, MATLAB, HDF5, Excel, MCAP or ROS bag"
KINDS = f"{FORMATS}, or a study.toml (several recordings, known loads)"
DRIVEN = f"as preset=xl330,kp=200 or output=duty,kp=0.6,supply=12: {', '.join(KEYS)}"
READING = "--columns --unwrap"  # how recordings are to be read
ROBOT = "--robot --rotors --joints --base --no-gravity"
LIMITS = "--fix --bound"  # parameters that are known or bounded
OF_PENDULUMS = f"--drive --theta --instruments {LIMITS}"  # which say nothing of an arm
NEEDS_ROBOT = "is of an arm: give its links with --robot ARM.urdf"
NO_ROBOT = "is for pendulums: leave it out with --robot"


def _keep_message(convert: Callable[[str], T]) -> Callable[[str], T]:
    """Make a converter whose ValueError keeps its message; argparse itself would drop it."""

    def converted(text: str) -> T:
        try:
            return convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return converted


def convert_number(low: float, high: float = LARGE) -> Callable[[str], float]:
    """Make a converter of a number from low to high."""
    return _convert_within(float, low, high, f"a number from {low:g} to {high:g}")


def convert_between(low: float, high: float) -> Callable[[str], float]:
    """Make a converter of a number between low and high, both excluded."""
    inside = math.nextafter(low, high), math.nextafter(high, low)
    return _convert_within(float, *inside, f"a number above {low:g} and below {high:g}")


def convert_whole(low: int, high: int = 10**18) -> Callable[[str], int]:
    """Make a converter of a whole number from low to high."""
    return _convert_within(int, low, high, f"a whole number from {low} to {high}")


def _convert_within(kind: Callable[[str], Number], low: Number, high: Number, asked: str) -> Callable[[str], Number]:
    def converted(text: str) -> Number:
        with suppress(ValueError):
            if low <= (value := kind(text)) <= high:
                return value
        raise argparse.ArgumentTypeError(f"{quote_value(text)} should be {asked}")

    return converted


def convert_choice(kind: str, known: Iterable[str]) -> Callable[[str], str]:
    """Make a converter of one of the known names."""
    names = dict.fromkeys(known)

    def converted(text: str) -> str:
        find(kind, text, names)
        return text

    return converted


def _convert_effect(text: str) -> str:
    hide(paper_plant(), re.sub("@[^=:]*", "", text, count=1))  # at whatever joint
    return text


def _convert_page(text: str) -> str:
    """Name of a report's file; raises ValueError if it asks for another format than HTML."""
    suffix = Path(text).suffix.lower()
    if suffix not in ("", ".html", ".htm"):
        name = Path(text).with_suffix(".html")
        raise ValueError(f"a report is one HTML page, not {suffix}: name it {name}, a browser prints it to PDF")
    return text


def _convert_names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f"{quote_value(text)} should be names of joints with commas between them")
    return names


class MergeAction(argparse.Action):
    """Option that may be repeated and names several things: all are gathered in one dictionary."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Add to what was named before."""
        setattr(namespace, self.dest, {**getattr(namespace, self.dest), **values})


def parse_effects(text: str) -> list[str]:
    """Parse ids of effects with commas, perhaps at joints (`stribeck@elbow`); raises ValueError if one is unknown.

    What follows `coupling@elbow,` is its second joint, as long as it is no effect.
    """
    found: list[str] = []
    for id in filter(None, (word.strip() for word in text.split(","))):
        if found and found[-1].startswith(f"{COUPLING}@") and "," not in found[-1] and "@" not in id:
            found[-1] += f",{id}"
        else:
            found.append(find_effect(id.partition("@")[0]) + "".join(id.partition("@")[1:]))
    return found


def find_effect(id: str, known: Callable[[str], type[Term]] | None = None) -> str:
    """Find the id of an effect, by default of those that may be named, or of the one that only arms have.

    Raises ValueError if there is none; the message names the nearest.
    """
    return id if id == COUPLING else (find("effect", id, list_nameable()) if known is None else known(id)).id


def parse_values(text: str) -> dict[str, float]:
    """Parse the values by parameter, of `gravity=2.01,...`; raises ValueError if it is something else."""
    return {name: _bound(value) for name, value in _split_pairs(text, "NAME=VALUE, such as gravity=2.01")}


def parse_bounds(text: str) -> dict[str, tuple[float, float]]:
    """Parse the bounds by parameter, of `viscous=0:0.5,...`; raises ValueError if it is something else."""
    bounds, asked = {}, "NAME=LOW:HIGH, such as viscous=0:0.5"
    for name, both in _split_pairs(text, asked):
        low, colon, high = (word.strip() for word in both.partition(":"))
        if not colon:
            raise InputError(f"{quote_value(f'{name}={both}')} should be {asked}")
        bounds[name] = (_bound(low or "-inf"), _bound(high or "inf"))
    return bounds


def _split_pairs(text: str, asked: str) -> Iterator[tuple[str, str]]:
    """Split `NAME=VALUE,...` into names and values; raises InputError with the expected form."""
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals):
            raise InputError(f"{quote_value(part)} should be {asked}")
        yield name, value


def _bound(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (abs(value) <= LARGE or math.isinf(value)):
        raise InputError(f"{quote_value(text)} should be a number from {-LARGE:g} to {LARGE:g}, or left out")
    return value


def _convert_drive(text: str) -> ServoDrive:
    """Convert a drive, of `preset=xl330,kp=200`; raises ValueError if it is none."""
    pairs = _split_pairs(text, "KEY=VALUE, such as kp=200")
    words = ("preset", *WORDS)
    return ServoDrive.from_settings({name: value if name in words else _bound(value) for name, value in pairs})


def _convert_columns(text: str) -> dict[str, str]:
    """Parse expressions of columns by quantity; a comma belongs to a name unless another `QUANTITY=` follows."""
    columns: dict[str, str] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", text):
        quantity, equals, name = (word.strip() for word in part.partition("="))
        if not (quantity and equals and name):
            raise ValueError(
                f"'{part}' should be QUANTITY=NAME:UNIT*GAIN, such as position=ANGLE:deg or torque=current:A*0.091"
            )
        refuse_unknown_quantity(strip_joint(quantity))
        if quantity in columns:
            raise ValueError(f"{quantity} is named twice in '{text}'")
        columns[quantity] = name
    return columns


SHARED = f"""
model MODEL.json  what identify, diagnose or add wrote with -o
recordings RECORDING  {KINDS}; fitted jointly
--effect ID[=VALUE,...]  hide an effect: ID alone, ID=VALUE,... in the order of `effects`, or ID:name=value,...
    (may be repeated)
--theta NAME=VALUE,...  inertia, gravity, viscous, coulomb of the plant, where they differ from the paper's
--holdout RECORDING  recording to confirm the result on (may be repeated; default: the last 30 %% of each recording)
--columns QUANTITY=NAME[:UNIT][*GAIN]...,...  columns of time, position, torque, velocity, reference, segment, supply,
    enabled and temperature whose names are not known, with unit and conversion, e.g.
    time=clock:ms,position=-motor:deg/6+90,torque=current:A*0.091,velocity=none;
    torque=none: nothing drives the joint;
    units: {"; ".join(TOLD[quantity] for quantity in ("time", "position", "velocity", "torque"))} (default: SI)
--unwrap  undo jumps of 2 pi in position
--drive KEY=VALUE,...  the controller that followed the reference, {DRIVEN};
    diagnose, add and compare then simulate the closed loop
--robot ARM.urdf  recordings are of an arm with these links, URDF or MJCF (needs the extra arms), with columns time,
    position_JOINT and torque_JOINT, or numbered
--rotors  with --robot: identify the motors' own inertia (default: if the MJCF has any)
--joints A,B,...  with --robot: joints that move (default: all); others, such as a gripper's, are held where the
    recording has them, or at zero
--base  with --robot: fix the floating base of the file
--no-gravity  with --robot: the logged torque is without gravity compensation, which the driver subtracts
--only ID,...  look for these effects only
--without ID,...  do not look for these effects
--fix NAME=VALUE,...  known values of parameters, as gravity=2.01 (may be repeated)
--bound NAME=LOW:HIGH,...  bounds of parameters, as viscous=0:0.5 or cogging.order=10:14 (may be repeated)
--align  correct torque that is logged late or through a low-pass filter
--instruments  fit the base model with instrumental variables made of the controller's reference: removes the bias
    from feedback
--model MODEL.json  start from its terms (default: the paper's four)
--seed  of all random numbers (default 0)
--report FILE.html  write a report with plots, one file to share
--degrees  print and draw angles and speeds in degrees; options, files of models and --json stay in rad
-v, --verbose  print errors, parameters, candidates and their gates as tables, and all remarks
"""


def _read_options(text: str, settings: dict[str, Any]) -> Iterator[Declared]:
    """Read the names and arguments of each option in a text, see `declare`; none where a line only names options."""
    for entry in re.split(r"\n(?! )", cleandoc(text)):
        usage, _, about = entry.partition("  ")
        words = usage.split()
        if not about:
            yield from (([name], {}) for name in words)
            continue
        names = [word.rstrip(",") for word in words if word.startswith("-")] or words[:1]
        own: dict[str, Any] = {"help": " ".join(about.split())}
        if len(words) > len(names):
            own["metavar"] = words[len(names)]
        setting = settings.get(names[-1].lstrip("-").replace("-", "_"))
        if isinstance(setting, dict):
            own |= setting
        elif setting is not None:
            own["type"], own["default"] = setting if isinstance(setting, tuple) else (setting, None)
        elif usage.startswith("-") and "metavar" not in own:
            own["action"] = "store_true"
        if "type" in own:
            own["type"] = _keep_message(own["type"])
        yield names, own


SETTINGS: dict[str, Any] = {  # of these, see `declare`
    "recordings": {"nargs": "+"},
    "effect": {"dest": "effects", "action": "append", "type": _convert_effect, "default": []},
    "theta": lambda text: paper_plant(read_parameters(text)),
    "holdout": {"action": "append", "default": []},
    "columns": _convert_columns,
    "drive": _convert_drive,
    "joints": _convert_names,
    "base": {"choices": ("fixed",)},
    "only": parse_effects,
    "without": (parse_effects, []),
    "fix": {"dest": "fixed", "type": parse_values, "action": MergeAction, "default": {}},
    "bound": {"dest": "bounds", "type": parse_bounds, "action": MergeAction, "default": {}},
    "instruments": {"choices": ("reference",)},
    "seed": (convert_whole(0), 0),
    "report": _convert_page,
}
OPTIONS = {names[-1]: (names, own) for names, own in _read_options(SHARED, SETTINGS)}


def add_options(
    parser: argparse.ArgumentParser, text: str, arms: Sequence[str] = (), pendulums: Sequence[str] = (), **settings: Any
) -> None:
    """Declare options by a text like that of `--help`: names, what the option takes, two spaces, what it is for.

    An option that takes nothing is a switch. A line of names alone declares options that several commands share, see
    `OPTIONS`; a name with a new description replaces the shared one. Each setting, by the name of the option, is a
    converter, a converter and a default, or further arguments of `add_argument`.

    `arms` and `pendulums` name options that make sense for one of them only, beside those of `ROBOT` and of
    `OF_PENDULUMS`; `cli.parse` refuses them for the other.
    """
    for names, own in _read_options(text, settings):
        if not own or (names[-1] in OPTIONS and "metavar" not in own):
            names, shared = OPTIONS[names[-1]]
            own = shared | {key: value for key, value in own.items() if key != "action"}
        parser.add_argument(*names, **own)
    if "--rotors" not in parser._option_string_actions:
        return

    def marked(dests: Sequence[str], every: str) -> list[argparse.Action]:
        options = set(every.split())
        return [own for own in parser._actions if own.dest in dests or not options.isdisjoint(own.option_strings)]

    of_arms, of_pendulums = marked(arms, ROBOT.partition(" ")[2]), marked(pendulums, OF_PENDULUMS)
    parser.set_defaults(refused={False: (of_arms, NEEDS_ROBOT), True: (of_pendulums, NO_ROBOT)})
    for action in of_pendulums:
        action.help = f"{action.help} [not with --robot]"
