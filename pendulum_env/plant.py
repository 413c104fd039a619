"""Simulated plants: the paper's pendulum with hidden effects, given as texts such as `stribeck=0.4`."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Model, NonlinearParameter, Term, effect
from pendulum_env.physics.library import MEASURED
from pendulum_env.reading import MAX_NUMBER, quote_value

Effects = str | Sequence[str] | Mapping[str, float | Mapping[str, float]] | None  # see `list_effects`

PAPER: dict[str, float] = {  # the paper's Table 2, dynamic row
    "inertia": 0.0895,  # [kg m^2]
    "gravity": 2.01,  # [N m]
    "viscous": 0.3638,  # [N m s/rad]
    "coulomb": 0.9163,  # [N m]
}
TYPICAL: dict[str, float] = {  # typical sizes of effects by unit; `Term.typical_size` takes precedence
    "N m": 0.2,
    "N m s/rad": 0.06,
    "N m s^2/rad^2": 0.035,
    "N m/rad": 0.25,
    "kg m^2": 0.02,
    "rad": 0.02,
    "1": 0.1,
}


def paper_plant(theta: Mapping[str, float] | None = None) -> Model:
    """Return the paper's pendulum, with some of its four parameters replaced.

    Raises:
        ValueError: if a parameter is unknown or impossible.
    """
    theta = {} if theta is None else theta
    refuse_unnamed(theta)
    for name, value in theta.items():
        find("parameter", name, PAPER)
        if not 0 <= value <= MAX_NUMBER or (name == "inertia" and value == 0):
            raise ValueError(f"{name} of a plant cannot be {value:g}: give a positive number, {MAX_NUMBER:g} at most")
    return Model.build(BASE, np.array([theta.get(name, default) for name, default in PAPER.items()]))


def refuse_unnamed(theta: object) -> None:
    """Refuse parameters that are not given by name."""
    if not isinstance(theta, Mapping):
        raise TypeError(f"theta is {quote_value(theta)}: give parameters by name, such as {{'gravity': 2.0}}")


def get_typical_values(term: Term) -> dict[str, float]:
    """Return typical parameters of an effect by name, linear parameters first."""
    linear = {column.name.removeprefix(f"{term.id}."): TYPICAL.get(column.unit, 0.1) for column in term.columns}
    return linear | term.nonlinear_values | (read_parameters(size) if (size := term.typical_size) else {})


def list_typical_ranges(kind: type[Term]) -> dict[str, tuple[float, float]]:
    """Return ranges (low, high) around typical parameters of an effect by name: free nonlinear, then linear."""
    values = get_typical_values(kind())
    ranges = {
        parameter.name: (5.0, 24.0)
        if parameter.integer
        else (0.7 * values[parameter.name], 1.4 * values[parameter.name])
        for parameter in kind.nonlinear_parameters
        if parameter.nominal is None
    }
    return ranges | {name: (0.8 * values[name], 1.5 * values[name]) for name in list(values)[: len(kind().columns)]}


def draw_effect(kind: type[Term], rng: np.random.Generator) -> dict[str, float]:
    """Draw parameters of an effect around typical values: linear, then free nonlinear parameters."""
    ranges = list_typical_ranges(kind)
    drawn = {name: float(draw_parameter(kind, name, *bounds, rng)) for name, bounds in ranges.items()}
    n_linear = len(kind().columns)
    names = list(drawn)
    return {name: drawn[name] for name in names[len(names) - n_linear :] + names[: len(names) - n_linear]}


def draw_parameter(
    kind: type[Term], name: str, low: float, high: float, rng: np.random.Generator, count: int | None = None
) -> Array:
    """Draw a parameter of an effect between two bounds, or `count` of them (count,); integers include both."""
    if any(parameter.integer for parameter in kind.nonlinear_parameters if parameter.name == name):
        return np.asarray(rng.integers(round(low), round(high) + 1, count), dtype=float)
    return np.asarray(low + (high - low) * rng.random(count))  # bounds of a negative parameter fall


def hide(plant: Model, text: str) -> Model:
    """Add an effect, given as text, to a plant.

    `stribeck` has its typical size, `stribeck=0.4,0.3` sets the parameters in order, and `cogging:order=14,sin=0.2` by
    name. Other parameters keep typical values. `pendulum-ident effects` lists them in order. A single 0, as in
    `cogging=0`, sets all linear parameters to zero, `dead_time=0` the delay. An infinite limit removes a stop:
    `hard_stop:upper=0.9,lower=-inf`.

    Raises:
        ValueError: if the effect or a parameter is unknown, or a value is not a number in the admissible range.
        ModelError: if the plant already has the effect.
    """
    id, separator, value_text = re.fullmatch("([^:=]*)([:=]?)(.*)", text, re.DOTALL).groups()  # type: ignore[union-attr]
    id = id.strip()
    if id in MEASURED:
        raise ValueError(f"{id} acts by the joint's {MEASURED[id].needs}, which no simulated pendulum has")
    kind = effect(id)
    parameters = get_typical_values(kind())
    if separator == "=":
        values = [_parse_number(part, text) for part in value_text.split(",")]
        if len(values) > len(parameters):
            raise ValueError(
                f"{id} takes at most {len(parameters)} values ({', '.join(parameters)}), got {len(values)}"
            )
        if values == [0.0]:  # size 0, of all waves or parts
            values *= len(kind().columns) or 1
        values_by_name = dict(zip(parameters, values, strict=False))
    else:
        values_by_name = read_parameters(value_text) if separator else {}
    nonlinear = {p.name: values_by_name.get(p.name, parameters[p.name]) for p in kind.nonlinear_parameters}
    for parameter in kind.nonlinear_parameters:
        check_nonlinear(id, parameter, nonlinear[parameter.name])
    term = kind(**nonlinear)
    parameters = get_typical_values(term)
    for name in values_by_name:
        find(f"parameter of {id}", name, parameters)
    linear = {name: values_by_name.get(name, typical) for name, typical in parameters.items() if name not in nonlinear}
    for column, (name, value) in zip(term.columns, linear.items(), strict=True):
        low, high = max(column.least, -MAX_NUMBER), min(column.most, MAX_NUMBER)
        if not low <= value <= high:
            raise ValueError(f"{name} of {id} cannot be {value:g}: give a number from {low:g} to {high:g}")
    if term.fault:
        raise ValueError(f"{id} cannot be as '{text}' says: {term.fault}")
    return plant.add(term, np.array([*linear.values()]))


def check_nonlinear(id: str, parameter: NonlinearParameter, value: float) -> None:
    """Refuse a nonlinear parameter out of its range.

    Raises:
        ValueError: with the effect, the parameter and its range.
    """
    if not parameter.is_allowed(value):
        allowed = f"{'an integer' if parameter.integer else 'a number'} {parameter.format_range()}"
        raise ValueError(f"{parameter.name} of {id} cannot be {value:g}: give {allowed} [{parameter.unit}]")


def check_linear(name: str, value: float) -> None:
    """Refuse a linear parameter that a plant cannot have. Identified models may have negative parameters.

    Raises:
        ValueError: with the parameter and its range.
    """
    if not abs(value) <= MAX_NUMBER or (name == "inertia" and value <= 0):
        allowed = "a positive number" if name == "inertia" else f"a number from {-MAX_NUMBER:g} to {MAX_NUMBER:g}"
        raise ValueError(f"{name} of a plant cannot be {value:g}: give {allowed}")


def read_parameters(text: str) -> dict[str, float]:
    """Read numbers by name from `inertia=0.09,gravity=2`.

    Raises:
        ValueError: if a part is not of the form name=number.
    """
    parameters = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            raise ValueError(f"'{part}' in '{text}' is not of the form name=value")
        parameters[name.strip()] = _parse_number(value, text)
    return parameters


def _parse_number(part: str, text: str) -> float:
    with suppress(ValueError):
        if not math.isnan(value := float(part)):
            return value
    raise ValueError(f"'{part}' in '{text}' is not a number")


def list_effects(effects: Effects) -> tuple[str, ...]:
    """Convert effects to texts for `hide`.

    Args:
        effects: a text such as `stribeck=0.4`, several texts, sizes by id `{"stribeck": 0.4}`, parameters by id and
            name `{"stribeck": {"stribeck": 0.4}}`, or None.

    Raises:
        TypeError: if effects have another type.
    """
    if isinstance(effects, str):
        return (effects,)
    if isinstance(effects, Mapping):
        return tuple(_write_effect(id, size) for id, size in effects.items())
    if not isinstance(effects, Iterable | None):
        raise TypeError(f"effects is {quote_value(effects)}: give texts such as 'stribeck=0.4', or sizes by id")
    for text in effects or ():
        if not isinstance(text, str):
            raise TypeError(f"an effect is {quote_value(text)}: give a text such as 'stribeck=0.4'")
    return tuple(effects or ())


def _write_effect(id: str, size: object) -> str:
    try:
        if isinstance(size, Mapping):
            value_text = ",".join(f"{name}={float(value)!r}" for name, value in size.items())
            return f"{id}:{value_text}" if value_text else id
        return f"{id}={float(size)!r}"  # type: ignore[arg-type]  # float raises TypeError
    except (TypeError, ValueError):
        raise TypeError(f"the size of {id} is {quote_value(size)}: give a number, or numbers by parameter") from None


def make_plant(
    theta: Mapping[str, float] | None = None, effects: Effects = (), model: Model | str | Path | None = None
) -> Model:
    """Make the plant of an environment.

    Args:
        theta: parameters by name that differ from the paper.
        effects: hidden effects, such as `stribeck=0.4` or `{"stribeck": 0.4}`; see `list_effects`.
        model: identified model, or its file, in place of the paper's plant.

    Raises:
        ValueError: if a parameter or an effect is unknown or impossible, or if both theta and a model are given.
        TypeError: if theta or an effect has another type.
        ModelError: if the model cannot be read, or lacks inertia, or its inertia is unknown.
    """
    if model is not None:
        if theta is not None:
            raise ValueError("a plant is given by its theta or by a model, not by both")
        plant = model if isinstance(model, Model) else Model.load(model)
        plant.refuse_unknown_inertia()
    else:
        plant = paper_plant(theta)
    for text in list_effects(effects):
        plant = hide(plant, text)
    return plant
