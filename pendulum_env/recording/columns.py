"""Which column of a file is which quantity, and in which unit: told by its name, case-insensitive, or by the user.

A name is an alias (`q`, `tau`, ...), perhaps decorated (`q_meas`, `actual_position`), perhaps followed by a unit
(`q [rad]`, `pos_deg`, `time_ms`). Names with an unknown unit (`position [counts]`) are no match, rather than a guess.
Users name columns as they stand in the file, with a unit behind a colon where the name does not tell it: `Winkel:deg`.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from pendulum_env.recording.record import RecordingError

HEADER = "time,position,torque"  # the plain header, in s, rad and N m; velocity [rad/s] is optional

ALIASES = {
    "time": "time t timestamp timestamps stamp elapsed elapsedtime seconds secs sec",
    "position": "position pos q theta θ angle ang phi φ angularposition jointposition jointangle jointpos "
    "motorposition motorangle motorpos",
    "velocity": "velocity vel speed omega ω dq qd qdot dqdt dtheta thetadot thetad v angularvelocity angvel "
    "jointvelocity jointvel motorvelocity motorvel",
    "torque": "torque tau τ effort trq tq moment jointtorque motortorque appliedtorque",
}
MEASURED = ("meas", "measured", "actual", "act")  # before or after an alias
COMMANDED = ("cmd", "command", "commanded", "des", "desired", "ref", "setpoint")  # torque only, if no other is found

UNITS = {  # factor to SI by the unit's letters
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0}
    | dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3)
    | dict.fromkeys(("us", "usec", "µs", "μs", "micros", "microseconds"), 1e-6)
    | dict.fromkeys(("ns", "nsec", "nanoseconds"), 1e-9),
    "position": {"rad": 1.0, "radian": 1.0, "radians": 1.0}
    | dict.fromkeys(("deg", "degs", "degree", "degrees"), math.pi / 180)
    | dict.fromkeys(("mrad", "millirad"), 1e-3)
    | dict.fromkeys(("rev", "revs", "turns"), math.tau),
    "velocity": dict.fromkeys(("rads", "rads1", "radsec", "radpersec", "radianspersecond", "radps"), 1.0)
    | dict.fromkeys(("degs", "degs1", "degsec", "degpersec", "degreespersecond", "dps"), math.pi / 180)
    | dict.fromkeys(("rpm", "revmin", "minrev"), math.tau / 60)
    | {"revs": math.tau, "rps": math.tau},
    "torque": {"nm": 1.0, "newtonmeter": 1.0, "newtonmeters": 1.0, "newtonmetre": 1.0, "newtonmetres": 1.0}
    | dict.fromkeys(("mnm", "millinewtonmeter"), 1e-3)
    | {"ncm": 1e-2},
}
SI = {"time": "s", "position": "rad", "velocity": "rad/s", "torque": "N m"}
TOLD = {  # of UNITS, what people are told of
    "time": "s, ms, us, ns",
    "position": "rad, mrad, deg, rev",
    "velocity": "rad/s, deg/s, rpm, rev/s",
    "torque": "Nm, mNm, Ncm",
}
CHOOSE = "say which with --columns QUANTITY=NAME (columns=...)"  # what mends it, on the command line and in Python


@dataclass(frozen=True)
class Column:
    """One column of a file that was recognised."""

    quantity: str  # time, position, velocity or torque
    header: str  # its name in the file
    index: int  # its place in the file, from 0
    unit: str | None  # letters of the unit in its name, None if it names none
    commanded: bool = False  # its name says commanded rather than measured
    passed_over: tuple[str, ...] = ()  # names of others that could be the same quantity

    @property
    def scale(self) -> float:
        """Factor from the column's unit to SI."""
        return 1.0 if self.unit is None else UNITS[self.quantity][self.unit]

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know about how this column was read."""
        notes = []
        if self.scale != 1.0:
            notes.append(f"{self.quantity} converted to {SI[self.quantity]} from column {self.header!r}")
        if self.commanded and _letters(self.header) != "u":  # which never means anything else
            notes.append(f"torque is the commanded one, from column {self.header!r}")
        for other in self.passed_over:
            notes.append(f"{self.quantity} is taken from column {self.header!r}; {other!r} is there too")
        return tuple(notes)


def find_columns(headers: Sequence[str], named: Mapping[str, str] | None = None) -> dict[str, Column]:
    """Column by quantity: time, position, torque, and velocity if there is one.

    Args:
        headers: names of the columns in the file.
        named: columns that the user names, by quantity: `NAME`, or `NAME:UNIT`; the others are found by their names.

    Raises:
        RecordingError: if one is missing, or if two fit the same quantity.
    """
    given = {quantity: _named(quantity, text, headers) for quantity, text in (named or {}).items()}
    taken = {column.index for column in given.values()}
    found: dict[str, list[Column]] = {quantity: [] for quantity in ALIASES}
    for index, header in enumerate(headers):
        if (match := NAMES.get(_letters(header))) and index not in taken:
            quantity, unit, commanded = match
            found[quantity].append(Column(quantity, header.strip(), index, unit, commanded))
    columns = {}
    for quantity, fitting in found.items():
        if quantity in given:
            columns[quantity] = given[quantity]
            continue
        candidates = [c for c in fitting if not c.commanded] or fitting
        if len(candidates) > 1:
            names = " and ".join(_shown(c.header) for c in candidates)
            raise RecordingError(f"columns {names} could both be {quantity}: {CHOOSE}")
        if candidates:
            others = tuple(c.header for c in fitting if c not in candidates)
            columns[quantity] = replace(candidates[0], passed_over=others)
    missing = [quantity for quantity in ("time", "position", "torque") if quantity not in columns]
    if missing:
        raise RecordingError(
            f"no column for {', '.join(missing)} among {_listed(headers)}: name the columns {HEADER} (in s, rad, N m) "
            f"and optionally velocity (rad/s), or {CHOOSE}"
        )
    return columns


def refuse_unknown_quantity(quantity: str) -> None:
    """Refuse a word that is none of the four quantities."""
    if quantity not in ALIASES:
        raise RecordingError(f"columns are named for {', '.join(ALIASES)}, not for {quantity!r}")


def _named(quantity: str, text: str, headers: Sequence[str]) -> Column:
    """The column that a user names for a quantity; the name as it stands in the file comes first, colons and all."""
    refuse_unknown_quantity(quantity)
    names = [header.strip() for header in headers]
    name, unit = text.strip(), None
    if name not in names and ":" in name:
        name, _, told = (part.strip() for part in name.rpartition(":"))
        unit = _letters(told)
        if unit not in UNITS[quantity]:
            raise RecordingError(f"unit {told!r} of {quantity} is not known: use one of {TOLD[quantity]}")
    if (count := names.count(name)) != 1:
        many = f"{count} columns are" if count else "no column is"
        raise RecordingError(f"{many} named {name!r}, which is to be {quantity}, among {_listed(headers)}")
    return Column(quantity, name, names.index(name), unit or _unit_at_the_end(quantity, name))


def _unit_at_the_end(quantity: str, name: str) -> str | None:
    """Letters of the unit that a name ends in, `Winkel [deg]` or `phi2_deg`; None if that is no unit."""
    ends = re.search(r"\[([^\]]*)\]$|\(([^)]*)\)$|[\s_]([^\s_]+)$", name)
    unit = _letters(next(filter(None, ends.groups()), "")) if ends else ""
    return unit if unit in UNITS[quantity] else None


def _letters(header: str) -> str:
    """The name without case, spacing and brackets: `Pos [°]` becomes `posdeg`. Other signs stay, and match nothing."""
    return re.sub(r"[\s_\-./·⋅*^()\[\]{}:,]+", "", header.lower().replace("°", "deg"))


def _listed(headers: Sequence[str]) -> str:
    shown = ", ".join(_shown(header) for header in headers[:12]) + (", ..." if len(headers) > 12 else "")
    return shown or "no columns at all"


def _shown(header: str) -> str:
    return repr(header.strip() if len(header) <= 40 else header.strip()[:37] + "...")


def _names() -> Iterator[tuple[str, tuple[str, str | None, bool]]]:
    """Every name that is understood, as letters, with its quantity, unit and whether it means a command."""
    for quantity, aliases in ALIASES.items():
        stems: dict[str, bool] = {}
        for alias in aliases.split():
            stems |= {alias: False}
            stems |= {stem: False for word in MEASURED for stem in (alias + word, word + alias)}
            if quantity == "torque":
                stems |= {stem: True for word in COMMANDED for stem in (alias + word, word + alias)}
        if quantity == "torque":
            stems |= {"u": True}  # control engineers' input
        for stem, commanded in stems.items():
            yield stem, (quantity, None, commanded)
            for unit in UNITS[quantity]:
                yield stem + unit, (quantity, unit, commanded)


NAMES = dict(_names())
