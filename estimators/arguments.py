"""Conversion and checks of arguments: recordings, terms, effects and models, one or several, by name or object."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.free_swings import is_torque_needed
from estimators.progress import no_progress
from estimators.regression.least_squares import IdentificationError
from pendulum_env.errors import ColumnError, UserError
from pendulum_env.physics import (
    BASE,
    PENDULUM,
    Bounds,
    Mechanism,
    Model,
    ModelError,
    Term,
    describe_joints,
    find_term,
    list_nameable,
)
from pendulum_env.physics.joints import (
    check_places,
    find_kinds,
    find_mechanism,
    list_effects,
    place_effects,
    place_term,
)
from pendulum_env.physics.limits import check_names, collect_limits, limit_kind, limit_term, make_limits
from pendulum_env.physics.model import NO_INERTIA
from pendulum_env.reading import quote_value
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.formats import Readable, is_data, is_readable
from pendulum_env.recording.lerobot import list_recordings
from pendulum_env.recording.logged import read_logged
from pendulum_env.recording.study import parse_log_format
from pendulum_env.settings import format_setting

Recordings = Recording | Readable | Sequence[Recording | Readable]
Terms = str | Sequence[str | Term]


def select_recordings(
    given: Recordings,
    *,
    empty: bool = False,
    terms: Sequence[Term] = BASE,
    log_format: Mapping[str, Any] | None = None,
) -> tuple[Recording, ...]:
    """Return recordings as a tuple; time counts from the start of each, since logs often have Unix time.

    Args:
        given: one or several recordings, paths, data frames or mappings of arrays, see `read_recording`.
        empty: whether no recording is allowed.
        terms: of a model of the recordings. Its mechanism is theirs, and without gravity, no unit of the angle shows.
        log_format: log format of a model, for reading files and tables; `Recording` objects are unchanged.

    Raises:
        TypeError: if an object is no recording, or has other joints.
        ValueError: if a recording is given twice, or none.
    """
    is_single, sources = isinstance(given, Recording) or is_readable(given), _list_sources(given)
    mechanism = find_mechanism(terms)
    format = replace(parse_log_format(log_format or {}), has_gravity=_may_have_gravity(terms))
    recordings = [
        _read_input(item, "" if is_single else f" {k + 1}", mechanism, format) for k, item in enumerate(sources)
    ]
    for item in recordings:
        if item.names != mechanism.joints:
            read_joints, term_joints = describe_joints(item.names), describe_joints(mechanism.joints)
            raise TypeError(
                f"{item.name}: is of {read_joints}, and the terms are of {term_joints}: give BASE, or arm_base(body)"
            )
    if len(_identify_sources(sources)) < len(sources):
        raise ValueError("a recording is given twice: give each one once")
    if not recordings and not empty:
        raise ValueError("there is no recording to work on: give one or several")
    return tuple(recording.start_from_zero() for recording in recordings)


def select_parts(
    given: Recordings,
    holdout: Recordings,
    terms: Sequence[Term] = BASE,
    log_format: Mapping[str, Any] | None = None,
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Return fitted and held-out recordings, see `select_recordings`; `holdout` may be empty.

    Raises:
        ValueError: if a held-out recording is fitted, too.
    """
    given, holdout = _read_once(given), _read_once(holdout)
    if _identify_sources(_list_sources(given)) & _identify_sources(_list_sources(holdout)):
        raise ValueError("a recording is both fitted and held out: hold out another, or none for the last 30 % of each")
    fitted = select_recordings(given, terms=terms, log_format=log_format)
    return fitted, select_recordings(holdout, empty=True, terms=terms, log_format=log_format)


def _may_have_gravity(terms: Sequence[Term]) -> bool:
    """Return whether the gravity of some terms may differ from zero."""
    columns = [column for term in terms if term.id == "gravity" for column in term.columns]
    return not any(column.is_known and column.least == 0.0 for column in columns)


def _read_once(given: Recordings) -> Recordings:
    """Return one or several recordings as given, with an iterator as a tuple."""
    return given if isinstance(given, Recording) or is_readable(given) else _list_sources(given)


def _list_sources(given: Recordings) -> tuple[Any, ...]:
    """List one or several recordings as given, with the episodes of datasets."""
    is_single = isinstance(given, Recording | np.ndarray) or is_readable(given)
    items = (given,) if is_single else convert_to_tuple(given)
    return tuple(
        part for item in items for part in (list_recordings(item) if isinstance(item, str | os.PathLike) else [item])
    )


def _identify_sources(sources: Sequence[Any]) -> set[int | str]:
    """Return keys of recordings that differ unless they are the same object or file."""
    return {os.path.realpath(item) if isinstance(item, str | os.PathLike) else id(item) for item in sources}


def _read_input(given: Any, number: str, mechanism: Mechanism, format: Source) -> Recording:
    """Return a recording, or read it from a file or table; tables in memory are numbered."""
    if isinstance(given, Recording):
        return given
    if not is_readable(given):
        raise TypeError(
            f"{quote_value(given)} is not a recording: give the path of a file, a data frame, a mapping of arrays, or "
            "a Recording"
        )
    name = f"recording{number}" if is_data(given) else None
    try:
        return read_logged(mechanism, given, format, name)
    except ColumnError as error:
        if not format.columns:
            raise
        raise ColumnError(
            f"{error}; it was read by the log_format of the model: give read_recording(source) of a log of another "
            "format"
        ) from None


def select_terms(given: Terms | Model | None) -> tuple[Term, ...]:
    """Return terms by object, or by id with default nonlinear parameters; None for the four of the paper.

    After links, terms are at joints, by id as in `stribeck@elbow`.
    """
    if given is None:
        return BASE
    if isinstance(given, Model):
        raise TypeError("a model is not a list of terms: pass model.terms")
    items = convert_to_tuple(given)
    mechanism = find_mechanism(items)
    terms = tuple(_find_term(item, mechanism) if isinstance(item, str) else item for item in items)
    for item in terms:
        if not isinstance(item, Term):
            raise TypeError(f"{quote_value(item)} is not a term: give its id, such as 'stribeck', or Stribeck()")
    if not terms:
        raise ValueError("a model needs at least one term: leave the terms out for the paper's four")
    check_places(terms, mechanism.joints)
    return terms


def _find_term(text: str, mechanism: Mechanism) -> Term:
    """Return a term by its id, or by `id@joint`, with default nonlinear parameters."""
    id, _, joint = text.partition("@")
    return place_term(find_term(id)(), joint, joint in mechanism.prismatic_joints)


def select_effects(
    library: Mapping[str, type[Term]] | None,
    only: Iterable[str] | None,
    without: Iterable[str],
    mechanism: Mechanism = PENDULUM,
) -> dict[str, type[Term]]:
    """Select effects from a library, by default all known effects: `only` some, or all `without` some.

    With links, `stribeck` selects this effect at each possible joint, `stribeck@elbow` at one joint.
    """
    kinds = list_effects(mechanism) if library is None else library
    known = {kind.id: kind for kind in place_effects(kinds.values(), mechanism)}
    excluded, allowed = (
        {kind.id: kind for kind in find_kinds(_list_ids(ids), mechanism, kinds)} for ids in (without, only or ())
    )
    chosen = {id: kind for id, kind in (known if only is None else allowed).items() if id not in excluded}
    if not chosen and known:
        raise UserError("no effect is left to look for: leave out fewer, or look for more")
    return chosen


def _list_ids(given: object) -> tuple[str, ...]:
    """List the ids of one or several effects."""
    ids = convert_to_tuple(given)
    if not all(isinstance(id, str) for id in ids):
        raise TypeError(f"{quote_value(given)} names no effects: give ids, such as 'stribeck'")
    return ids


def select_visible_effects(kinds: Mapping[str, type[Term]], recordings: Sequence[Recording]) -> dict[str, type[Term]]:
    """Select effects that recordings can show.

    Effects of whole turns need a joint that turns, and effects of torque a recording with torque. Other effects need
    their quantity in a recording, for example a temperature.

    Raises:
        IdentificationError: if effects are given, and recordings can show none.
    """
    if any(recording.units.is_prismatic for recording in recordings):
        sliding = {id: kind for id, kind in kinds.items() if kind.at or not kind.is_revolute_only}
        if kinds and not sliding:
            raise IdentificationError(f"{next(iter(kinds))} needs a joint that turns: look for other effects")
        kinds = sliding
    if recordings and all(recording.is_free for recording in recordings):
        free = {id: kind for id, kind in kinds.items() if not is_torque_needed(kind)}
        if kinds and not free:
            raise IdentificationError(
                f"{next(iter(kinds))} shows only under torque, and no recording has any: record with torque, or look "
                "for other effects"
            )
        kinds = free
    measured = {"", *(name for recording in recordings for name, value in vars(recording).items() if value is not None)}
    shown = {id: kind for id, kind in kinds.items() if kind.needs in measured}
    if kinds and not shown:
        id, kind = next(iter(kinds.items()))
        column = f"{kind.needs}_{kind.at}" if kind.at else kind.needs
        raise IdentificationError(
            f"{id} needs the joint's {kind.needs}, which no recording has: record it, or say which column it is, "
            f"{format_setting('columns', {column: 'NAME'})}"
        )
    return shown


def apply_limits(
    terms: Sequence[Term], library: Mapping[str, type[Term]], fixed: Mapping[str, float] | None, bounds: Bounds | None
) -> tuple[tuple[Term, ...], dict[str, type[Term]]]:
    """Fix or bound parameters of terms and effects by name: `gravity`, `cogging.order`.

    A term that a parameter of zero switches off is refused.
    """
    for term in terms:
        for parameter in term.nonlinear_parameters:
            if parameter.can_be_zero and getattr(term, parameter.name) == 0:
                raise UserError(
                    f"{term.id} of the model is 0, and no fit starts there: leave {term.id} out of the model"
                )
    limits = make_limits(fixed or {}, bounds or {})
    if not limits:
        return tuple(terms), dict(library)
    if not find_mechanism(terms).can_limit:
        raise UserError("values and bounds are known of pendulums alone: leave them out for an arm")
    check_names(limits, (*(type(item) for item in terms), *list_nameable().values(), *library.values()))
    limited = tuple(limit_term(item, limits) for item in terms)
    if not library and (absent := limits.keys() - collect_limits(limited)):
        raise UserError(f"the model has no parameter '{min(absent)}': add its effect to the terms, or leave it out")
    return limited, {id: limit_kind(kind, limits) for id, kind in library.items()}


def check_options(criterion: object, progress: object = no_progress) -> None:
    """Raise a `TypeError` if a criterion is no `Criterion`, or a progress no function."""
    if not isinstance(criterion, Criterion):
        raise TypeError(f"criterion={quote_value(criterion)}: give limits by name, as in Criterion(p_value=0.01)")
    if not callable(progress):
        raise TypeError(f"progress={quote_value(progress)}: give a function of a text and a share, or leave it out")


def check_horizon(horizon: float | None, is_simulated: bool) -> None:
    """Raise an error if a horizon [s] is no positive finite number, or is given without a simulated free run."""
    if horizon is not None and not isinstance(horizon, float | int | np.number):
        raise TypeError(f"horizon={quote_value(horizon)}: give a number of seconds")
    if horizon is not None and not 0 < horizon < math.inf:
        raise UserError(f"the horizon cannot be {horizon:g} s: give a number above zero")
    if horizon is not None and not is_simulated:
        raise UserError(
            "a horizon is of motion that is simulated from torque: leave it out for an arm, and for servos with a "
            "drive, which are simulated over whole recordings"
        )


class HasModel(Protocol):
    """Result with a model."""

    @property
    def model(self) -> Model:
        """Return the model."""


ModelSource = Model | HasModel | str | Path


def check_model(given: ModelSource) -> Model:
    """Return a model, of a result or file if given these, and check that it has inertia or links."""
    if isinstance(given, str | Path):
        given = Model.load(given)
    if not isinstance(given := getattr(given, "model", given), Model):
        raise TypeError(
            f"{quote_value(given)} is not a model: give a model, the path of its file, or a result with a model"
        )
    if not any(item.kind == "inertial" for item in given.terms):
        raise ModelError(NO_INERTIA)
    return given


def convert_to_tuple(given: object) -> tuple[Any, ...]:
    """Convert one or several objects to a tuple; a text or a dataclass is one object."""
    is_one = isinstance(given, str | bytes) or is_dataclass(given)
    return tuple(given) if isinstance(given, Iterable) and not is_one else (given,)
