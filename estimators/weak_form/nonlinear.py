"""Search over the nonlinear parameters of one term, with the linear parameters eliminated (variable projection).

The searches access the data only through functions that evaluate a whole batch of variants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.gauss_newton import Near, Rule, choose_least, gauss_newton
from estimators.regression.least_squares import SOLVER
from estimators.search_hints import find_hints
from pendulum_env._typing import Array
from pendulum_env.physics import NonlinearParameter, Samples, Term

Residuals = Callable[[Sequence[Term]], list[Array]]  # weighted residual (R,) of the best fit with each variant


@dataclass(frozen=True)
class NonlinearSettings:
    """Numbers of the searches over nonlinear parameters."""

    turns: int = 20  # largest number of Gauss-Newton steps
    shares: tuple[float, ...] = (1.0, 0.4, 0.1, 0.02)  # tried of a Gauss-Newton step
    leap: float = 0.7  # largest step, relative or of a logarithm: no longer than a factor of two
    damping: float = 1e-12  # against parameters that tell the same
    difference: float = 1e-3  # relative, of a parameter for derivatives
    jump: float = 0.1  # of a law's change over the difference: what changes as much over a hundredth of it jumps
    scanned: int = 21  # values of an edge that a scan tries at a time,
    widths: tuple[float, ...] = (1.0, 0.1, 0.01, 1e-3)  # of its ranges, each a spacing of the one before
    rounds: int = 6  # of the cross-entropy search,
    draws: int = 48  # variants that each of them draws,
    elite: int = 8  # and best ones so far that the next are drawn around


NONLINEAR = NonlinearSettings()


def set_values(term: Term, sought: Sequence[NonlinearParameter], values: Sequence[float] | Array) -> Term:
    """Return the term with new values of some nonlinear parameters, kept inside their limits."""
    return replace(term, **{s.name: float(np.clip(v, s.low, s.high)) for s, v in zip(sought, values, strict=True)})


def list_continuous_parameters(term: Term) -> list[NonlinearParameter]:
    """List the free nonlinear parameters that are continuous and follow no other parameter."""
    return [parameter for parameter in term.free if not parameter.integer and not parameter.follows]


def release(term: Term) -> list[list[Term]]:
    """List variants of the term that release one nonlinear parameter from its nominal value, for a search.

    An integer takes each of its values; only the first integer is released, since others are similar.
    """
    found, is_whole, starts = [], False, find_hints(type(term)).alternative_starts
    for parameter in term.nonlinear_parameters:
        start = starts.get(parameter.name)
        if start is None or parameter in term.free or (is_whole and parameter.integer):
            continue
        is_whole |= parameter.integer
        values = range(int(start), int(parameter.high) + 1) if parameter.integer else [start]
        variants = [set_values(term, [parameter], [value]) for value in values]
        found.append([variant for variant in variants if not variant.fault])
    return found


def reset(term: Term) -> list[Term]:
    """List variants of the term, each with one released nonlinear parameter back at its nominal value."""
    starts = find_hints(type(term)).alternative_starts
    released = [parameter for parameter in term.free if parameter.name in starts]
    return [
        set_values(term, [parameter], [parameter.nominal]) for parameter in released if parameter.nominal is not None
    ]


def compute_nonlinear_slopes(term: Term, torques: Callable[[Sequence[Term]], Sequence[Array]]) -> dict[str, Array]:
    """Return derivatives (R,) of a term's torque by its continuous nonlinear parameters, by `id.parameter`.

    Args:
        term: at whose nonlinear parameters.
        torques: torque (R,) of each variant of it [N m].
    """
    slopes = {}
    for parameter in list_continuous_parameters(term):
        value = term.nonlinear_values[parameter.name]
        # symmetric difference over a step that is small against the value and safe against rounding
        step = NONLINEAR.difference * max(abs(value), 1e-6)
        more, less = torques([replace(term, **{parameter.name: value + d}) for d in (step, -step)])
        slopes[term.get_full_name(parameter.name)] = (more - less) / (2 * step)
    return slopes


def refine_nonlinear(term: Term, residuals: Residuals, edges: Sequence[NonlinearParameter] = ()) -> Term:
    """Find the variant with the least squared residual near `term`; edges stay.

    The derivative of the projected residual is taken by differences; all differences of a turn, as well as all step
    lengths, are judged as one batch. Parameters with a positive lower limit move by factors.
    Source: Golub and Pereyra, Inverse Problems 19(2), 2003.
    """
    sought = [parameter for parameter in list_continuous_parameters(term) if parameter not in edges]
    if not sought:
        return term
    factor = np.array([parameter.low > 0 for parameter in sought])
    known: dict[Term, Array] = {}  # residuals of the last batch

    def at(term: Term) -> tuple[Array, Array]:
        """Return the values of the nonlinear parameters and the units of their steps."""
        values = np.array([term.nonlinear_values[parameter.name] for parameter in sought])
        return values, np.array(
            [get_step_unit(parameter, value) for parameter, value in zip(sought, values, strict=True)]
        )

    def near(term: Term) -> Near[Term]:
        values, unit = at(term)
        error = known[term] if term in known else residuals([term])[0]
        steps = NONLINEAR.difference * unit * np.eye(len(sought))
        nearby = [set_values(term, sought, values + step) for step in steps]
        slopes = (np.column_stack(residuals(nearby)) - error[:, None]) / NONLINEAR.difference  # (R, S)
        return Near(term, float(error @ error), error, slopes)

    def best(near: Near[Term], steps: list[Array]) -> tuple[Term, float]:
        values, unit = at(near.known)
        step = steps[0] / max(1.0, float(np.abs(steps[0]).max()) / NONLINEAR.leap)
        tried = [
            set_values(term, sought, np.where(factor, values * np.exp(share * step), values + share * step * unit))
            for share in NONLINEAR.shares
        ]
        known.clear()
        known.update(zip(tried, residuals(tried), strict=True))
        return choose_least(tried, [float(known[term] @ known[term]) for term in tried])

    return gauss_newton(term, near, best, Rule(NONLINEAR.turns, (NONLINEAR.damping,), by_offset=True))


def find_edges(term: Term, x: Samples) -> list[NonlinearParameter]:
    """List the continuous nonlinear parameters by which the laws of a term have no slope almost everywhere.

    These are instants, and parameters at which a law jumps, as friction that ends at a speed: while one moves, the law
    stays at most of the samples, and changes at others by an amount that does not shrink with the move. An impact has
    slopes by its stop, also where the law jumps by damping.
    """
    smooth = term.has_state() or term.has_impacts
    return [own for own in list_continuous_parameters(term) if own.instant or (not smooth and _has_jumps(term, own, x))]


def _has_jumps(term: Term, parameter: NonlinearParameter, x: Samples) -> bool:
    """Return whether the laws of a term jump at some samples while a parameter moves."""
    value = term.nonlinear_values[parameter.name]
    unit = get_step_unit(parameter, value)

    def change(share: float) -> float:
        ends = [
            _evaluate_laws(set_values(term, [parameter], [value + step]), x) for step in (-share * unit, share * unit)
        ]
        return float(np.max(np.abs(ends[1] - ends[0])))

    far, near, close = map(change, (NONLINEAR.leap, NONLINEAR.difference, 0.01 * NONLINEAR.difference))
    least = SOLVER.tiny * far
    return far > 0 and (near <= least or close <= least or close > NONLINEAR.jump * near)


def get_step_unit(parameter: NonlinearParameter, value: float) -> float:
    """Return the unit in which a parameter moves: its size, also near zero where it may be zero."""
    return abs(value) if parameter.low > 0 else max(abs(value), 0.1)


def _evaluate_laws(term: Term, x: Samples) -> Array:
    """Return the laws of all columns of a term at N samples (3 P, N)."""
    laws = [law(x) for column in (*term.columns, *term.fixed) for law in (column.mass, column.force, column.dry)]
    return np.array([np.broadcast_to(law, np.shape(x.velocity)) for law in laws])


def scan_edges(term: Term, residuals: Residuals, edges: Sequence[NonlinearParameter], reach: float) -> Term:
    """Search edges on a grid, and on finer grids around the best; an instant within `reach` [s]."""
    for parameter in edges:
        for width in NONLINEAR.widths:
            value = term.nonlinear_values[parameter.name]
            step = width * (reach if parameter.instant else NONLINEAR.leap * get_step_unit(parameter, value))
            values = value + step * np.linspace(-1.0, 1.0, NONLINEAR.scanned)
            tried = [set_values(term, [parameter], [value]) for value in values]
            term = tried[int(np.argmin([float(residual @ residual) for residual in residuals(tried)]))]
    return term


def cross_entropy(variants: Sequence[Term], residuals: Residuals) -> Term:
    """Search by repeated draws around the best variants so far; for errors with many local minima.

    Works on the logarithms of the free continuous parameters, which have to be positive.
    Source: Rubinstein and Kroese, The Cross-Entropy Method, 2004.
    """
    rng = np.random.default_rng(0)  # the same data give the same answer
    sought = list_continuous_parameters(variants[0])

    def errors(drawn: Sequence[Term]) -> list[float]:
        return [float(np.linalg.norm(residual)) for residual in residuals(drawn)]

    ranked = sorted(zip(errors(variants), variants, strict=True), key=lambda pair: pair[0])[: NONLINEAR.elite]
    for _ in range(NONLINEAR.rounds):
        elite = np.log([[term.nonlinear_values[parameter.name] for parameter in sought] for _, term in ranked])
        spread = 1.2 * elite.std(axis=0) + 0.02
        draws = np.exp(elite.mean(axis=0) + spread * rng.standard_normal((NONLINEAR.draws, len(sought))))
        drawn = [set_values(variants[0], sought, draw) for draw in draws]
        ranked += zip(errors(drawn), drawn, strict=True)
        ranked = sorted(ranked, key=lambda pair: pair[0])[: NONLINEAR.elite]
    return ranked[0][1]
