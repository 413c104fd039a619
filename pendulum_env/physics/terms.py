"""Properties of sets of terms: ids, links, hidden states and parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pendulum_env._typing import ArrayLike
from pendulum_env.physics.term import Samples, Term, return_zero


def list_ids(terms: Sequence[Term]) -> frozenset[str]:
    """List the ids of terms."""
    return frozenset(term.id for term in terms)


def list_forms(terms: Sequence[Term]) -> frozenset[tuple[str, ...]]:
    """List the ids of terms, each with the names of its free nonlinear parameters."""
    return frozenset((term.id, *(parameter.name for parameter in term.free if not parameter.follows)) for term in terms)


def has_link(terms: Sequence[Term]) -> bool:
    """Return whether a term has a link with unmeasured motion."""
    return any(term.link for term in terms)


def has_stop(terms: Sequence[Term]) -> bool:
    """Return whether a term has impacts at an end of the range."""
    return any(term.has_impacts for term in terms)


def find_link(terms: Sequence[Term]) -> Term:
    """Find the first term that has a link."""
    return next(term for term in terms if term.link)


def read_encoder(x: Samples, terms: Sequence[Term], at_output: bool) -> Samples:
    """Return the samples with position and velocity of the encoder's shaft, motor or link."""
    if not (at_output and has_link(terms)):
        return x
    position, velocity = x.memory[find_link(terms).id]
    return replace(x, position=position, velocity=velocity)


def move_to_motor(x: Samples, terms: Sequence[Term], at_output: bool) -> Samples:
    """Return the steady samples of the motor, given those with the position of the encoder."""
    if not (at_output and has_link(terms)):
        return x
    link = find_link(terms).id
    extension = x.position - x.memory[link][0]  # due to the weight of the link
    return replace(x, position=x.position + extension, memory={**x.memory, link: (x.position, x.velocity)})


def has_transmission(terms: Sequence[Term]) -> bool:
    """Return whether a term is a loose or elastic transmission."""
    return any(term.kind == "transmission" for term in terms)


def has_bristles(term: Term) -> bool:
    """Return whether a term is friction with an unmeasured state."""
    return term.kind == "dissipative" and term.has_hidden_state


def is_pure_delay(kind: type[Term]) -> bool:
    """Return whether an effect only delays the torque, by a lag or a delay."""
    return (kind.delay is not Term.delay or kind.lead is not Term.lead) and not kind().columns


def is_dry(term: Term) -> bool:
    """Return whether a term is dry friction without a state."""
    return term.kind == "dissipative" and not term.has_state() and any(c.dry is not return_zero for c in term.columns)


def is_hidden(term: Term) -> bool:
    """Return whether a term has an unmeasured state of a link or of friction."""
    return term.link or has_bristles(term)


def set_nonlinear_values(terms: Sequence[Term], values: Mapping[str, ArrayLike]) -> tuple[Term, ...]:
    """Set nonlinear parameters of terms by full name; equal values of a batch become one number."""
    result = []
    for term in terms:
        names = {parameter.name: term.get_full_name(parameter.name) for parameter in term.nonlinear_parameters}
        arrays = {short: np.asarray(values[name]) for short, name in names.items() if name in values}
        changes = {short: float(value.flat[0]) if np.ptp(value) == 0 else value for short, value in arrays.items()}
        result.append(replace(term, **changes) if changes else term)
    return tuple(result)


def count_term_parameters(term: Term) -> int:
    """Count the parameters of a term, without known ones."""
    return sum(not column.is_known for column in term.columns) + sum(not parameter.follows for parameter in term.free)


def count_parameters(terms: Sequence[Term]) -> int:
    """Count the parameters of terms, without known ones."""
    return sum(count_term_parameters(term) for term in terms)
