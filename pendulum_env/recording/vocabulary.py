"""Names and units of columns, by quantity, including those that need a gain."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cache

from pendulum_env.recording.expression import normalise_name

PERCENT_OF_RANGE = " [percent of range]"  # end of a header of values in percent of an unknown range
UNKNOWN_UNIT = " [unknown unit]"  # end of a header of values whose unit a dataset does not tell
HEADER = "time,position,torque"  # standard header, in s, rad and N m

ALIASES = {
    "time": "time t timestamp timestamps stamp datetime clock elapsed elapsedtime seconds secs sec tout xvalue zeit "
    "zeitstempel unix unixtime tunix epoch epochtime posixtime",
    "position": "position pos q theta θ θr angle ang phi φ angularposition jointposition jointangle jointpos qpos "
    "motorposition motorangle motorpos presentpos presentangle observationstate winkel drehwinkel",
    "velocity": "velocity vel speed omega ω dq qd qdot dqdt dtheta thetadot thetad v angularvelocity angvel "
    "jointvelocity jointvel qvel motorvelocity motorvel winkelgeschwindigkeit drehzahl",
    "torque": "torque tau τ effort trq tq moment jointtorque motortorque taumotor motortau appliedtorque drehmoment "
    "qfrcactuator couple",
    "reference": "reference qr setpoint inputpos action goal goalposition",
    "supply": "supply volts vbus busvoltage supplyvoltage batteryvoltage presentinputvoltage",
    "enabled": "enabled powered torqueenable torqueenabled torqueon driveenable driveenabled driveon motorenable "
    "motorenabled motoron servoenable servoenabled servoon",
    "temperature": "temperature temp motortemperature motortemp jointtemperature jointtemp presenttemperature",
    "load_torque": "loadtorque torqueload tauload dynotorque torquedyno dynamometertorque externaltorque torqueext "
    "tauext",
    "segment": "segment segments episode episodeindex trial",
}
TICKS = {
    "second": "s",
    "secs": "s",
    "millis": "ms",
    "milliseconds": "ms",
    "micros": "us",
    "microseconds": "us",
    "nanoseconds": "ns",
    "utime": "us",
}  # of a clock
NOW = "current"  # before a long alias: measured, `current_torque`, but `torque_current` and `current_q` are currents
CARRIERS = ("shaft", "pendulum", "arm", "dof")  # before an alias: the moving part
JOINT_WORDS = frozenset((*CARRIERS, "joint", "joints", "motor", "axis", "j", "id"))  # words that name no one joint
LABELS = ("state", "phase", "test")  # of a column that counts segments, where its cells are words
MEASURED = ("meas", "measured", "msr", "fbk", "feedback", "actual", "act", "actualvalue")  # before or after an alias
ESTIMATED = ("est", "estimated")  # likewise, if no measured one is found
# torque only, if no other is found
COMMANDED = ("cmd", "command", "commanded", "des", "desired", "target", "ref", "reference", "setpoint")

UNITS = {  # factor to SI units by the letters of the unit
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0}
    | dict.fromkeys(("ms", "msec", "msecs", "millisec", "millis", "milliseconds"), 1e-3)
    | dict.fromkeys(("us", "usec", "usecs", "microsec", "µs", "μs", "micros", "microseconds"), 1e-6)
    | dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), 1e-9)
    | dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0)
    | dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
    "position": {"rad": 1.0, "radian": 1.0, "radians": 1.0}
    | dict.fromkeys(("deg", "degs", "degree", "degrees"), math.pi / 180)
    | dict.fromkeys(("mrad", "millirad"), 1e-3)
    | {"mdeg": math.pi / 180e3, "cdeg": math.pi / 180e2, "gon": math.pi / 200, "arcmin": math.pi / 10800}
    | dict.fromkeys(
        ("rev", "revs", "revolution", "revolutions", "turn", "turns", "rotation", "rotations", "rot"), math.tau
    ),
    "velocity": dict.fromkeys(("rads", "rads1", "radsec", "radpersec", "radianspersecond", "radps"), 1.0)
    | dict.fromkeys(("degs", "degs1", "degsec", "degpersec", "degreespersecond", "dps"), math.pi / 180)
    | dict.fromkeys(("rpm", "revmin", "minrev", "umin"), math.tau / 60)
    | dict.fromkeys(("revs", "rps", "revsec", "turnss", "turnssec", "turnspersecond"), math.tau)
    | dict.fromkeys(("rots", "rotationss", "rotationspersec", "rotationspersecond", "revolutionspersecond"), math.tau),
    "torque": {"nm": 1.0, "newtonmeter": 1.0, "newtonmeters": 1.0, "newtonmetre": 1.0, "newtonmetres": 1.0}
    | dict.fromkeys(("mnm", "millinewtonmeter"), 1e-3)
    | {"ncm": 1e-2, "cnm": 1e-2, "nmm": 1e-3, "knm": 1e3}
    | dict.fromkeys(("kgfm", "kgm"), 9.80665)
    | dict.fromkeys(("kgfcm", "kgcm"), 9.80665e-2)
    | dict.fromkeys(("gfcm", "gcm"), 9.80665e-5)
    | dict.fromkeys(("ozfin", "ozin", "inoz", "inozf"), 9.80665 * 0.45359237 / 16 * 0.0254)
    | dict.fromkeys(("lbfin", "lbin", "lbsin", "inlb", "inlbs", "inlbf"), 9.80665 * 0.45359237 * 0.0254)
    | dict.fromkeys(("lbfft", "lbft", "lbsft", "ftlb", "ftlbs", "ftlbf"), 9.80665 * 0.45359237 * 0.3048),
}
ODRIVE = {
    "posestimate": ("position", "rev"),
    "posrel": ("position", "rev"),
    "velestimate": ("velocity", "revs"),
    "torqueestimate": ("torque", "nm"),
}
MOTEUS = {"position": "rev", "velocity": "revs"}  # units of a log with two of `MOTEUS_REGISTERS`
MOTEUS_REGISTERS = frozenset(
    "mode fault qcurrent dcurrent absposition trajectorycomplete homestate rezerostate".split()
)
RAW = {  # factor to SI units, before a gain to the quantity, by the letters of the unit
    "torque": dict.fromkeys(("a", "amp", "amps", "ampere", "amperes"), 1.0)
    | {"ma": 1e-3, "v": 1.0, "mv": 1e-3, "duty": 1.0, "pwm": 1.0, "%": 0.01, "percent": 0.01},
    "position": dict.fromkeys(("counts", "count", "cts", "ticks", "pulses", "steps", "inc"), math.tau),
    "velocity": dict.fromkeys(("countss", "countsec", "ctss", "tickss", "pulsess", "stepss"), math.tau),
}
TORQUE_GAINS = {  # meaning of the gain of torque, by the unit of the column
    "A": "the torque constant [N m/A] times the gear ratio",
    "V": "the torque per volt [N m/V] times the gear ratio",
    "duty": "the torque at full duty [N m]",
}
RAW_NAMES = {  # names that imply such a unit
    "torque": "current motorcurrent iq iqmeasured iqmeas measurediq iqm i presentcurrent goalcurrent phasecurrent "
    "actualcurrent measuredcurrent currentmeasured currentactual amps duty dutycycle pwm presentpwm goalpwm "
    "presentload voltage motorvoltage presentvoltage".split(),
    "position": "counts encoder enc encodercounts encodercount ticks encoderticks presentposition rawposition "
    "positionraw shadowcount".split(),
}
UNSCALED = frozenset("raw lsb lsbs adc digit digits bits counts count cts norm normalized".split())  # last words
OUTPUTS = {"duty": "duty", "current": "A"}  # units of a controller's output, by the name of its column
LINEAR = {"position": {"m": 1.0, "mm": 1e-3}, "velocity": {"ms": 1.0, "mms": 1e-3}, "torque": {"n": 1.0, "kn": 1e3}}
for _of in (RAW, LINEAR):
    _of["reference"] = _of["position"]
LINEAR["load_torque"] = LINEAR["torque"]
UNITS |= {
    "reference": UNITS["position"] | UNITS["velocity"],
    "load_torque": UNITS["torque"],
    "segment": {},
    "supply": {"v": 1.0, "mv": 1e-3},
    "enabled": {},
    "temperature": dict.fromkeys(("c", "degc", "celsius"), 1.0),
}
SI = {
    "time": "s",
    "position": "rad",
    "velocity": "rad/s",
    "torque": "N m",
    "reference": "rad",
    "load_torque": "N m",
    "segment": "",
    "supply": "V",
    "enabled": "",
    "temperature": "deg C",
}
UNIT_NAMES = {  # units in messages
    "time": "s, ms, us, ns, min, h",
    "position": "rad, mrad, deg, rev, counts",
    "velocity": "rad/s, deg/s, rpm, rev/s, counts/s",
    "torque": "Nm, mNm, kNm, Ncm, A, mA, V, mV, duty, %, cNm, Nmm, kgfcm, ozfin, lbfin, lbfft",
    "reference": "rad, mrad, deg, rev, counts, rad/s, deg/s, rpm, rev/s",
    "load_torque": "Nm, mNm, Ncm, cNm, Nmm, kgfcm, ozfin, lbfin, lbfft",
    "supply": "V, mV",
    "temperature": "degC",
}
DRIVEN_ONLY = ("reference", "supply", "enabled", "load_torque")  # quantities of driven joints only
NO_TORQUE = frozenset(  # words in names of columns that are not torque
    "acceleration accel acc alpha ddq qdd qddot thetadd thetaddot gyro gyroscope x y z height distance energy kinetic "
    "potential counter count index idx id row no nr sample samples frame frames seq sequence step label comment note "
    "event marker date error err limit max min std offset integral".split()
)
NAMES_OF_JOINTS = frozenset(("rotation",))  # units in brackets alone: `position_Rotation` is that of a joint
SHORT_UNITS = frozenset("h hr hrs min".split())  # after `t` they make other names: `thr`, `th`, `tmin`
HAS_SHORT_UNIT = re.compile(r"([\[(]\s*|[^\W\d_]{3,}[\s_\-./:,]+)(h|hrs?|min)\s*[\])]?\s*$", re.IGNORECASE)
INDICES = ("unnamed: 0", "__index_level_0__")  # names of a column of row numbers; it may have none
BOUNDARY = re.compile(  # between the words of a name: `sampleNumber`, `sample_number`, `axisQMsr`, `tau1`
    r"[^\w°%]+|_+|(?<=[a-zäöüß])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[^\W\d])(?=\d)|(?<=\d)(?=[^\W\d])"
)
UNITS_OF_NO_TORQUE = frozenset(  # letters of units in brackets, beside those of other quantities
    "ms2 ms² rads2 rads² degs2 degs² cm mm m c k hz j mj w mw ut µt μt pa hpa kpa lx db".split()
).union(*(UNITS[quantity] for quantity in ("time", "position", "velocity", "temperature")))
# quantities of a recording; the first three are required
QUANTITIES = ("time", "position", "torque", "velocity", "reference", "supply", "enabled", "temperature", "load_torque")
OPTIONAL = ("velocity", "reference", "segment", "supply", "enabled", "temperature", "load_torque")
FIRST_MATCHING = OPTIONAL[1:]  # the first matching column is used


class Rank(IntEnum):
    """Rank of a column for a quantity; the least is preferred."""

    MEASURED = 0
    ESTIMATED = 1
    COMMANDED = 2


def _list_stems() -> Iterator[tuple[str, tuple[str, Rank]]]:
    """Yield each name without unit, in letters, with its quantity and rank."""
    for quantity, aliases in ALIASES.items():
        words: dict[Rank, tuple[str, ...]] = {Rank.MEASURED: MEASURED}
        if quantity in ("position", "velocity", "torque"):
            words[Rank.ESTIMATED] = ESTIMATED
        if quantity == "torque":
            words[Rank.COMMANDED] = COMMANDED
        stems: dict[str, Rank] = {}
        for alias in aliases.split():
            stems[alias] = Rank.MEASURED
            for rank, stems_of_rank in words.items():
                stems |= {stem: rank for word in stems_of_rank for stem in (alias + word, word + alias)}
            if quantity in ("position", "velocity", "torque") and len(alias) > 2:
                stems |= {NOW + alias: Rank.MEASURED}
                stems |= dict.fromkeys((carrier + alias for carrier in CARRIERS), Rank.ESTIMATED)
            if quantity != "time":
                stems |= {alias + "estimate": Rank.ESTIMATED}  # before an alias, `estimate dq` would be `estimated q`
        if quantity == "reference":
            positions = ALIASES["position"].split()
            stems |= {stem: Rank.MEASURED for p in positions for word in COMMANDED for stem in (p + word, word + p)}
        if quantity == "torque":
            stems |= {"u": Rank.COMMANDED}  # input in control theory
        for stem, rank in stems.items():
            yield stem, (quantity, rank)


STEMS = dict(_list_stems())
WHOLE = {  # names that are not a stem with a unit
    **{name: ("time", unit) for name, unit in TICKS.items()},
    **ODRIVE,
    "taum": ("torque", None),  # motor torque; `taumnm` is `tau [mNm]`
}


def find_name(name: str) -> tuple[str, str | None, Rank] | None:
    """Return quantity, unit or None, and rank of a name by its longest stem; None for unknown names."""
    letters = normalise_name(name)
    if letters in WHOLE:
        return *WHOLE[letters], Rank.MEASURED
    if len(letters) > 1 and UNITS["time"].get(letters, 1.0) < 1:  # `ms`, a part of another time, or the only one
        return "time", letters, Rank.ESTIMATED
    for end in range(len(letters), 0, -1):
        if letters[:end] in STEMS:
            quantity, rank = STEMS[letters[:end]]
            unit = letters[end:]
            if not unit or (unit in UNITS[quantity] and may_be_unit(unit, name)):
                return quantity, unit or None, rank
    return None


def may_be_unit(unit: str, name: str) -> bool:
    """Return whether the letters of a unit at the end of a name are one, and no part of a word or name of a joint."""
    if unit in NAMES_OF_JOINTS:
        return name.rstrip().endswith(("]", ")"))
    return unit not in SHORT_UNITS or bool(HAS_SHORT_UNIT.search(name))


@dataclass(frozen=True)
class Reading:
    """Meaning of some words of a name; the other words are the label of a joint: `LF_HAA_q` has `lf` and `haa`."""

    quantity: str  # empty if no words have a meaning
    unit: str | None
    rank: Rank
    is_raw: bool  # it is a current, a voltage or counts
    is_last: bool  # no word follows
    label: frozenset[str]


def split_words(name: str) -> list[str]:
    """Split a name at signs, changes of case, and digits."""
    return [word.lower().replace("°", "deg") for word in BOUNDARY.split(name) if word]


def find_label(joint: str) -> frozenset[str]:
    """Return the words of a joint's name that label its columns: `shoulder` and `pan` of `shoulder_pan_joint`."""
    return frozenset(split_words(joint)) - JOINT_WORDS


@cache
def read_words(name: str) -> Reading:
    """Read the longest run of words with a meaning; numbers always belong to the label.

    A unit in brackets belongs to the run: with an unknown one, no words have a meaning.
    """
    words = split_words(name) if name.isprintable() else []
    numbers = frozenset(word for word in words if word.isdecimal())
    words = [word for word in words if word not in numbers]
    has_unit = re.search(r"[\[(][^\])\d][^\])]*[\])]\s*$", name)
    for length in range(len(words), 0, -1):
        for start in range(len(words) - length, -1, -1):
            run, is_last = words[start : start + length], start + length == len(words)
            text = "".join(run)
            if has_unit and not is_last:
                continue
            label = numbers.union(words[:start], words[start + length :]) - JOINT_WORDS
            if not label.isdisjoint(NO_TORQUE):  # `torque_error` is of no joint
                continue
            if (match := find_name(" ".join(run))) and (match[0] != "time" or len(text) > 2):  # `Motor T` is no time
                return Reading(*match, is_raw=False, is_last=is_last, label=label)
            for quantity, names in RAW_NAMES.items():
                if any(text.removesuffix(unit) in names for unit in ("", *RAW[quantity])):
                    return Reading(quantity, None, Rank.MEASURED, is_raw=True, is_last=is_last, label=label)
    return Reading("", None, Rank.MEASURED, is_raw=False, is_last=False, label=numbers.union(words) - JOINT_WORDS)
