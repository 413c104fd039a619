"""Options shared by several commands, and the conversion of their values."""

import argparse
import math
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pendulum_env.lookup import find
from pendulum_env.physics import Model, Term, list_nameable
from pendulum_env.plant import hide, paper_plant, read_parameters
from pendulum_env.reading import MAX_NUMBER, quote_value
from pendulum_env.recording.actuator import Actuator, list_actuators, parse_actuator
from pendulum_env.recording.columns import refuse_unknown_quantity, strip_joint
from pendulum_env.recording.vocabulary import UNIT_NAMES
from workbench.errors import InputError
from workbench.terminal import parse_json_output

T = TypeVar("T")
COUPLING = "coupling"  # effect between two joints
ARM_EFFECTS = (COUPLING, "rotor")  # only arms have them
FORMATS = "CSV, Parquet, NPZ, JSON, MATLAB, HDF5, Excel, MCAP or ROS bag"
KINDS = f"{FORMATS}, LeRobot dataset (FOLDER, FOLDER#12), or a study.toml (several recordings, known loads)"
OF_ARMS = ("rotors", "joints", "no_gravity")  # options that need --robot
OF_PENDULUMS = ("theta", "fixed", "bounds")  # options that exclude --robot


def add_json(parser: argparse.ArgumentParser, help: str) -> None:
    """Add the option for a JSON file."""
    parser.add_argument(
        "--json", metavar="FILE", type=parse_json_output, help=f"{help}; - for standard output, texts go to stderr"
    )


class MergeAction(argparse.Action):
    """Repeatable option that merges its NAME=VALUE pairs into one dictionary."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Merge the pairs of one occurrence; refuse a second value of a name."""
        if repeated := getattr(namespace, self.dest).keys() & values:
            raise argparse.ArgumentError(self, f"{min(repeated)} is given twice: give one value")
        setattr(namespace, self.dest, {**getattr(namespace, self.dest), **values})


def keep_message(convert: Callable[[str], T]) -> Callable[[str], T]:
    """Wrap a converter so that argparse shows the message of its ValueError."""

    def convert_text(text: str) -> T:
        try:
            return convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert_text


def convert_number(low: float, high: float = MAX_NUMBER) -> Callable[[str], float]:
    """Make a converter of text to a number from low to high; a whole number if both are int."""
    is_whole = isinstance(low, int) and isinstance(high, int)
    kind = int if is_whole else float
    expected = f"a whole number from {low} to {high}" if is_whole else f"a number from {low:g} to {high:g}"

    def convert_text(text: str) -> float:
        with suppress(ValueError):
            if low <= (value := kind(text)) <= high:
                return value
        raise argparse.ArgumentTypeError(f"{quote_value(text)} should be {expected}")

    return convert_text


def _parse_hidden_effect(text: str) -> str:
    hide(paper_plant(), re.sub("@[^=:]*", "", text, count=1))  # without the joint, which is checked later
    return text


def _parse_page(text: str) -> str:
    if Path(text).suffix.lower() not in ("", ".html", ".htm"):
        name = Path(text).with_suffix(".html")
        raise ValueError(f"a report is one HTML page: name it {name}, a browser prints it to PDF")
    return text


def parse_names(text: str) -> tuple[str, ...]:
    """Parse comma-separated names of joints."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f"{quote_value(text)} should be names of joints with commas between them")
    return names


def parse_effects(text: str) -> list[str]:
    """Parse comma-separated ids of effects, perhaps at joints (`stribeck@elbow`).

    The word after `coupling@elbow,` is its second joint. Raises ValueError if an effect is unknown.
    """
    ids: list[str] = []
    for id in filter(None, (word.strip() for word in text.split(","))):
        if ids and ids[-1].startswith(f"{COUPLING}@") and "," not in ids[-1] and "@" not in id:
            ids[-1] += f",{id}"
        else:
            ids.append(find_effect(id.partition("@")[0]) + "".join(id.partition("@")[1:]))
    return ids


def find_effect(id: str, find_kind: Callable[[str], type[Term]] | None = None) -> str:
    """Return the id of an effect, found by `find_kind`, by default in the library.

    Raises ValueError if it is unknown; the message names the nearest id.
    """
    return id if id in ARM_EFFECTS else (find("effect", id, list_nameable()) if find_kind is None else find_kind(id)).id


def parse_values(text: str) -> dict[str, float]:
    """Parse values of parameters, `gravity=2.01,...`; raises ValueError for another form."""
    return {name: _parse_bound(value) for name, value in _split_pairs(text, "NAME=VALUE, such as gravity=2.01")}


def parse_bounds(text: str) -> dict[str, tuple[float, float]]:
    """Parse bounds of parameters, `viscous=0:0.5,...`; raises ValueError for another form."""
    bounds, expected = {}, "NAME=LOW:HIGH, such as viscous=0:0.5"
    for name, range_text in _split_pairs(text, expected):
        low, colon, high = (word.strip() for word in range_text.partition(":"))
        if not colon:
            raise InputError(f"{quote_value(f'{name}={range_text}')} should be {expected}")
        bounds[name] = (_parse_bound(low or "-inf"), _parse_bound(high or "inf"))
    return bounds


def parse_drive(text: str) -> Actuator | None:
    """Parse the settings of a drive, `preset=xl330,kp=200`; raises ValueError if they are invalid."""
    pairs = _split_pairs(text, "KEY=VALUE, such as kp=200")
    words = {"kind", *(name for kind in list_actuators().values() for name in kind.text_settings)}
    return parse_actuator({name: value if name in words else _parse_bound(value) for name, value in pairs})


def describe_drives() -> str:
    """Describe the settings of all installed kinds of drives."""
    return "; ".join(kind.describe_settings() for kind in list_actuators().values())


def parse_columns(text: str) -> dict[str, str]:
    """Parse `QUANTITY=COLUMN,...` into column expressions by quantity; names of columns may contain commas."""
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


def _split_pairs(text: str, expected: str) -> Iterator[tuple[str, str]]:
    """Split `NAME=VALUE,...` into names and values; raises InputError with the expected form `expected`."""
    names = set()
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals):
            raise InputError(f"{quote_value(part)} should be {expected}")
        if name in names:
            raise InputError(f"{name} is given twice: give one value")
        names.add(name)
        yield name, value


def _parse_bound(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (abs(value) <= MAX_NUMBER or math.isinf(value)):
        raise InputError(f"{quote_value(text)} should be a number from {-MAX_NUMBER:g} to {MAX_NUMBER:g}, or left out")
    return value


SHARED: dict[str, dict[str, Any]] = {  # arguments of `add_argument`; `help` may be a function that returns it
    "model": {"metavar": "MODEL.json", "help": "what identify, diagnose or add wrote with -o"},
    "recordings": {"metavar": "RECORDING", "nargs": "+", "help": f"{KINDS}; several are of one machine"},
    "--holdout": {
        "metavar": "RECORDING",
        "action": "append",
        "default": [],
        "help": "recording to confirm the result on (may be repeated; default: the last 30 %% of each recording)",
    },
    "--columns": {
        "metavar": "QUANTITY=NAME[:UNIT][*GAIN]...,...",
        "type": keep_message(parse_columns),
        "help": "columns of time, position, torque, velocity, reference, load_torque, segment, supply, enabled and "
        "temperature whose names are not known, with unit and conversion, as "
        "time=clock:ms,position=-motor:deg/6+90,torque=current:A*0.091,velocity=none; torque=none: nothing drives the "
        f"joint; units: {'; '.join(UNIT_NAMES[q] for q in ('time', 'position', 'velocity', 'torque'))} "
        "(default: SI)".replace("%", "%%"),
    },
    "--unwrap": {"action": "store_true", "help": "undo jumps of a turn in position"},
    "--drive": {
        "metavar": "KEY=VALUE,...",
        "type": keep_message(parse_drive),
        "help": lambda: (
            f"the controller that followed the reference, {describe_drives()}; the closed loop is then simulated"
        ),
    },
    "--effect": {
        "metavar": "ID[=VALUE,...]",
        "dest": "effects",
        "action": "append",
        "default": [],
        "type": keep_message(_parse_hidden_effect),
        "help": "hide an effect: ID alone, ID=VALUE,... in the order of `effects`, or ID:name=value,...; of an arm "
        "ID@JOINT (may be repeated)",
    },
    "--theta": {
        "metavar": "NAME=VALUE,...",
        "type": keep_message(lambda text: paper_plant(read_parameters(text))),
        "help": "inertia, gravity, viscous, coulomb of the plant, where they differ from the paper's",
    },
    "--model": {"metavar": "MODEL.json", "help": "start from its terms (default: the paper's four)"},
    "--only": {
        "metavar": "ID,...",
        "type": keep_message(parse_effects),
        "help": "look for these effects only; of an arm at every joint, or at one, as stribeck@elbow",
    },
    "--without": {
        "metavar": "ID,...",
        "type": keep_message(parse_effects),
        "default": [],
        "help": "do not look for these effects",
    },
    "--fix": {
        "metavar": "NAME=VALUE,...",
        "dest": "fixed",
        "action": MergeAction,
        "default": {},
        "type": keep_message(parse_values),
        "help": "known values, as gravity=2.01 (may be repeated)",
    },
    "--bound": {
        "metavar": "NAME=LOW:HIGH,...",
        "dest": "bounds",
        "action": MergeAction,
        "default": {},
        "type": keep_message(parse_bounds),
        "help": "limits, as viscous=0:0.5 or cogging.order=10:14 (may be repeated)",
    },
    "--align": {"action": "store_true", "help": "correct torque that is logged late or filtered"},
    "--degrees": {"action": "store_true", "help": "print and draw degrees; options and files stay in rad"},
    "--report": {"metavar": "FILE.html", "type": keep_message(_parse_page), "help": "write a report with plots"},
    "--seed": {"type": convert_number(0, 10**18), "default": 0, "help": "of all random numbers (default 0)"},
    "--workers": {
        "type": convert_number(1, 1000),
        "default": os.cpu_count() or 1,
        "help": "processes on this computer (default: one a core)",
    },
}
READING, LIMITS = ("--columns", "--unwrap"), ("--fix", "--bound")
SEARCH, PLANT = ("--model", "--only", "--without"), ("--effect", "--theta")


def declare(parser: argparse.ArgumentParser, *names: str, **changed: Any) -> None:
    """Declare options of `SHARED`; `changed` replaces arguments of `add_argument`, for example `help`."""
    for name in names:
        settings = SHARED[name] | changed
        about = settings["help"]
        parser.add_argument(name, **settings | {"help": about() if callable(about) else about})


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """Declare `--verbose`."""
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="print tables, the gates of the candidates, and all remarks"
    )


def add_robot(
    parser: argparse.ArgumentParser, arms: Sequence[str] = (), pendulums: Sequence[str] = (), about: str = ""
) -> None:
    """Declare the options of arms.

    `arms`: further options of the command that need --robot; `pendulums`: further options that exclude it.
    """
    about = about or "recordings are of an arm with these links, with columns time, position_JOINT and torque_JOINT"
    group = parser.add_argument_group("arms")
    group.add_argument("--robot", metavar="ARM.urdf", help=f"{about}; URDF or MJCF (needs the extra arms)")
    group.add_argument(
        "--joints",
        metavar="A,B,...",
        type=keep_message(parse_names),
        help="joints that move (default: all with columns); others are held where the recording has them, or at zero",
    )
    group.add_argument(
        "--rotors", action="store_true", help="identify the motors' own inertia (default: if the MJCF has any)"
    )
    group.add_argument("--no-gravity", action="store_true", help="the driver subtracts gravity from the logged torque")
    of_pendulums = (*OF_PENDULUMS, *pendulums)
    parser.set_defaults(of_arms=(*OF_ARMS, *arms), of_pendulums=of_pendulums)


def make_plant(arguments: argparse.Namespace) -> Model:
    """Make the plant of the options with its hidden effects; raises ModelError if an effect is hidden twice."""
    plant: Model = arguments.theta or paper_plant()
    for text in arguments.effects:
        plant = hide(plant, text)
    return plant
