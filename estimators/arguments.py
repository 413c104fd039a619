"""What people hand to the functions of this package: names or things, one or several; wrong ones are told at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from estimators.schemes.six import SCHEMES, Regressor, scheme
from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.physics import BASE, Model, ModelError, Term, effects
from pendulum_env.physics.library import term
from pendulum_env.physics.limits import Limits, check_names, limited, limited_term, limits_of
from pendulum_env.reading import shown
from pendulum_env.recording import Recording

Recordings = Recording | Sequence[Recording]
Terms = str | Sequence[str | Term]
Schemes = str | Sequence[str | Regressor]


def chosen_recordings(given: Recordings, *, empty: bool = False) -> tuple[Recording, ...]:
    """One recording, or several; time counts from the start of each: logs often have seconds since 1970.

    Args:
        given: what the caller has.
        empty: whether there may be none.

    Raises:
        TypeError: if it is something else, such as a file's name.
        ValueError: if there is none.
    """
    several = (given,) if isinstance(given, Recording) else _listed(given)
    for item in several:
        if not isinstance(item, Recording) or item.position.ndim > 1:  # of an arm
            raise TypeError(
                f"{shown(item)} is not a recording: read a file with pendulum_env.recording.read_recording, or make "
                "one of arrays with Recording"
            )
    if not several and not empty:
        raise ValueError("there is no recording to work on: give one or several")
    return tuple(one if one.time[0] == 0.0 else replace(one, time=one.time - one.time[0]) for one in several)


def chosen_terms(given: Terms | None) -> tuple[Term, ...]:
    """Terms as they are, or by id with their default shape parameters; None are the paper's four.

    Raises:
        ValueError: if there is no term of a name, or no term at all.
        TypeError: if something is no term, such as a model.
    """
    if given is None:
        return BASE
    if isinstance(given, Model):
        raise TypeError("a model is not a list of terms: pass model.terms")
    terms = tuple(term(item)() if isinstance(item, str) else item for item in _listed(given))
    for item in terms:
        if not isinstance(item, Term):
            raise TypeError(f"{shown(item)} is not a term: give its id, such as 'stribeck', or Stribeck()")
    if not terms:
        raise ValueError("a model needs at least one term: leave the terms out for the paper's four")
    return terms


def chosen_effects(
    library: Mapping[str, type[Term]] | None, only: Iterable[str] | None, without: Iterable[str]
) -> dict[str, type[Term]]:
    """Effects that may be named: of a library, or of all that are known, only some, or all but some.

    Raises:
        ValueError: if an id is unknown, or none is left.
    """
    known = effects() if library is None else dict(library)
    barred, allowed = ({id: find("effect", id, known) for id in _listed(ids)} for ids in (without, only or ()))
    chosen = {id: kind for id, kind in (known if only is None else allowed).items() if id not in barred}
    if not chosen and known:
        raise Mistake("no effect is left to look for: leave out fewer, or look for more")
    return chosen


def within_limits(
    terms: Sequence[Term], library: Mapping[str, type[Term]], fixed: Mapping[str, float] | None, bounds: Limits | None
) -> tuple[tuple[Term, ...], dict[str, type[Term]]]:
    """Terms and effects whose parameters are known, or stay within bounds, by name: `gravity`, `cogging.order`.

    Raises:
        LimitsError: if no term has such a parameter, or its bounds leave nothing.
    """
    limits = limits_of(fixed or {}, bounds or {})
    if not limits:
        return tuple(terms), dict(library)
    check_names(limits, (*(type(item) for item in terms), *effects().values(), *library.values()))
    return (
        tuple(limited_term(item, limits) for item in terms),
        {id: limited(kind, limits) for id, kind in library.items()},
    )


def chosen_schemes(given: Schemes) -> tuple[Regressor, ...]:
    """Schemes as they are, or by id; "all" are the six.

    Raises:
        ValueError: if there is no scheme of a name, one is named twice, or there is none at all.
        TypeError: if something is no scheme.
    """
    if isinstance(given, str) and given == "all":
        return SCHEMES
    chosen = tuple(scheme(item) if isinstance(item, str) else item for item in _listed(given))
    for item in chosen:
        if isinstance(item, type) or not hasattr(item, "regression"):
            raise TypeError(
                f"{shown(item)} is not a scheme: give an id, such as 'energy', or scheme('energy', guard=0.02)"
            )
    ids = [item.id for item in chosen]
    if not ids:
        raise ValueError(f"there is no scheme to use: give ids of {', '.join(item.id for item in SCHEMES)}")
    if len(set(ids)) < len(ids):  # they could not be told apart in the result
        raise ValueError(f"a scheme is named twice in {', '.join(ids)}: use each once")
    return chosen


def model_that_moves(given: Model) -> Model:
    """A model with inertia.

    Raises:
        TypeError: if it is no model, such as a file's name.
        ModelError: if it lacks inertia.
    """
    if not isinstance(given, Model):
        raise TypeError(f"{shown(given)} is not a model: read a file with Model.load, or take the model of a result")
    if "inertia" not in given.estimates:
        raise ModelError("the model lacks the term inertia, without which nothing moves")
    return given


def _listed(given: object) -> tuple[Any, ...]:
    return tuple(given) if isinstance(given, Iterable) and not isinstance(given, str | bytes) else (given,)
