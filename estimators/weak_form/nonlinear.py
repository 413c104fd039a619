"""Search over the nonlinear parameters of one term, with the linear parameters eliminated (variable projection).

The searches access the data only through functions that evaluate a whole batch of variants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from estimators.regression.gauss_newton import LocalErrors, StopRule, choose_least, gauss_newton
from estimators.regression.least_squares import SOLVER
from estimators.search_hints import find_hints
from pendulum_env._typing import Array
from pendulum_env.physics import NonlinearParameter, Samples, Term

T = TypeVar("T", bound=Term)
ResidualFunction = Callable[[Sequence[T]], list[Array]]  # weighted residual (R,) of the best fit with each variant


@dataclass(frozen=True)
class NonlinearSettings:
    """Numbers of the searches over nonlinear parameters."""

    iterations: int = 20  # largest number of Gauss-Newton steps
    shares: tuple[float, ...] = (1.0, 0.4, 0.1, 0.02)  # tried step lengths, as shares of a Gauss-Newton step
    leap: float = 0.7  # largest step [step units, or of the logarithm]: a factor of two
    damping: float = 1e-12  # keeps a step finite with collinear slopes
    difference: float = 1e-3  # step of a parameter for derivatives [step units]
    place: float = 0.01  # step unit of a position, share of the range of the motion
    jump: float = 0.1  # a law jumps if a hundredth of `difference` changes it by this share of the change over it
    scanned: int = 21  # values of an edge per scan
    widths: tuple[float, ...] = (1.0, 0.1, 0.01, 1e-3)  # half widths of successive scans, shares of the first
    rounds: int = 6  # rounds of the cross-entropy search
    draws: int = 48  # variants per round
    elite: int = 8  # best variants so far, around which the next round draws


NONLINEAR = NonlinearSettings()


def set_values(term: T, sought: Sequence[NonlinearParameter], values: Sequence[float] | Array) -> T:
    """Return the term with new values of some nonlinear parameters, clipped to their limits."""
    return replace(term, **{s.name: float(np.clip(v, s.low, s.high)) for s, v in zip(sought, values, strict=True)})


def list_continuous_parameters(term: Term) -> list[NonlinearParameter]:
    """List the free nonlinear parameters that are continuous and follow no other parameter."""
    return [parameter for parameter in term.free if not parameter.integer and not parameter.follows]


def list_nonlinear_names(terms: Sequence[Term]) -> list[str]:
    """List the full names of the continuous nonlinear parameters of some terms."""
    return [term.get_full_name(parameter.name) for term in terms for parameter in list_continuous_parameters(term)]


def list_released_variants(term: Term) -> list[list[Term]]:
    """List, per nonlinear parameter at its nominal value, variants with other values as starts of a search.

    An integer takes each value from its alternative start to its upper limit; only the first integer is released.
    Variants with a `fault` are left out.
    """
    variants_of_each, has_integer, starts = [], False, find_hints(type(term)).alternative_starts
    for parameter in term.nonlinear_parameters:
        start = starts.get(parameter.name)
        if start is None or parameter in term.free or (has_integer and parameter.integer):
            continue
        has_integer |= parameter.integer
        values = range(int(start), int(parameter.high) + 1) if parameter.integer else [start]
        variants = [set_values(term, [parameter], [value]) for value in values]
        variants_of_each.append([variant for variant in variants if not variant.fault])
    return variants_of_each


def list_reset_variants(term: Term) -> list[Term]:
    """List variants of the term, each with one released nonlinear parameter back at its nominal value."""
    starts = find_hints(type(term)).alternative_starts
    released = [parameter for parameter in term.free if parameter.name in starts]
    return [
        set_values(term, [parameter], [parameter.nominal]) for parameter in released if parameter.nominal is not None
    ]


def compute_nonlinear_slopes(
    term: T, torques: Callable[[Sequence[T]], Sequence[Array]], width: float = 1.0
) -> dict[str, Array]:
    """Return derivatives (R,) of a term's torque by its continuous nonlinear parameters, keyed by their full names.

    `torques` returns the torque (R,) of each of several variants of the term [N m]. The motion has a `width` [rad].
    """
    slopes = {}
    for parameter in list_continuous_parameters(term):
        value = term.nonlinear_values[parameter.name]
        # symmetric difference over a step that is small against the value and safe against rounding
        size = get_step_unit(parameter, value, width) if parameter.is_position else max(abs(value), 1e-6)
        step = NONLINEAR.difference * size
        more, less = torques([replace(term, **{parameter.name: value + d}) for d in (step, -step)])
        slopes[term.get_full_name(parameter.name)] = (more - less) / (2 * step)
    return slopes


def refine_nonlinear(
    term: T,
    residuals: ResidualFunction[T],
    edges: Sequence[NonlinearParameter] = (),
    gain: float = 0.0,
    longest: float = np.inf,
    width: float = 1.0,
) -> T:
    """Find the variant of a term with locally least squared residual; parameters in `edges` stay.

    Gauss-Newton with derivatives by differences evaluates all variants of an iteration in one batch. Parameters with a
    positive lower limit change by factors. The search ends if an iteration lowers the squared residual by less than a
    share `gain`. Time constants are at most `longest` [s], beyond which an exponential equals a line. The motion
    has a `width` [rad].

    Source: Golub and Pereyra, Inverse Problems 19(2), 2003.
    """
    sought = [
        replace(parameter, high=min(parameter.high, longest)) if parameter.unit == "s" else parameter
        for parameter in list_continuous_parameters(term)
        if parameter not in edges
    ]
    if not sought:
        return term
    factor = np.array([parameter.low > 0 for parameter in sought])
    known: dict[Term, Array] = {}  # residuals of the last batch

    def get_values(term: Term) -> tuple[Array, Array]:
        """Return the values of the sought parameters (S,), and the units of their steps (S,)."""
        values = np.array([term.nonlinear_values[parameter.name] for parameter in sought])
        return values, np.array(
            [get_step_unit(parameter, value, width) for parameter, value in zip(sought, values, strict=True)]
        )

    def linearise(term: T) -> LocalErrors[T]:  # slopes per step unit
        values, unit = get_values(term)
        error = known[term] if term in known else residuals([term])[0]
        steps = NONLINEAR.difference * unit * np.eye(len(sought))
        nearby = [set_values(term, sought, values + step) for step in steps]
        slopes = (np.column_stack(residuals(nearby)) - error[:, None]) / NONLINEAR.difference  # (R, S)
        return LocalErrors(term, float(error @ error), error, slopes)

    def choose_step(local: LocalErrors[T], steps: list[Array]) -> tuple[T, float]:
        values, unit = get_values(local.known)
        step = steps[0] / max(1.0, float(np.abs(steps[0]).max()) / NONLINEAR.leap)
        variants = [
            set_values(term, sought, np.where(factor, values * np.exp(share * step), values + share * step * unit))
            for share in NONLINEAR.shares
        ]
        known.clear()
        known.update(zip(variants, residuals(variants), strict=True))
        return choose_least(variants, [float(known[term] @ known[term]) for term in variants])

    return gauss_newton(
        term, linearise, choose_step, StopRule(NONLINEAR.iterations, (NONLINEAR.damping,), by_offset=True, of_cost=gain)
    )


def find_edges(term: Term, x: Samples) -> list[NonlinearParameter]:
    """List the continuous nonlinear parameters at which a law of a term jumps and has no useful derivative.

    An example is an instant, or the speed at which friction ends. Terms with state or impacts have only instants.
    Jumps are tested at the samples `x`.
    """
    may_jump = not (term.has_state() or term.has_impacts)
    parameters = list_continuous_parameters(term)
    return [parameter for parameter in parameters if parameter.instant or (may_jump and _has_jumps(term, parameter, x))]


def _has_jumps(term: Term, parameter: NonlinearParameter, x: Samples) -> bool:
    """Return whether a small change of a parameter leaves the laws of a term unchanged at all samples, or is a jump."""
    value = term.nonlinear_values[parameter.name]
    unit = get_step_unit(parameter, value, float(np.ptp(x.position)))

    def compute_change(share: float) -> float:  # largest, over samples, for a move by this many step units either way
        ends = [
            _evaluate_laws(set_values(term, [parameter], [value + step]), x) for step in (-share * unit, share * unit)
        ]
        return float(np.max(np.abs(ends[1] - ends[0])))

    far, near, close = map(compute_change, (NONLINEAR.leap, NONLINEAR.difference, 0.01 * NONLINEAR.difference))
    least = SOLVER.tiny * far
    return far > 0 and (near <= least or close <= least or close > NONLINEAR.jump * near)


def get_step_unit(parameter: NonlinearParameter, value: float, width: float = 1.0) -> float:
    """Return the step unit of a parameter: its absolute value, at least 0.1 if its lower limit is not positive.

    The unit of a position, about any zero, is a share of the `width` of the motion [rad], of 1 at rest.
    """
    if parameter.is_position:
        return NONLINEAR.place * (width or 1.0)
    return abs(value) if parameter.low > 0 else max(abs(value), 0.1)


def _evaluate_laws(term: Term, x: Samples) -> Array:
    """Return mass, force and dry part of each of P columns of a term, also fixed ones, at N samples (3 P, N)."""
    laws = [law(x) for column in (*term.columns, *term.fixed) for law in (column.mass, column.force, column.dry)]
    return np.array([np.broadcast_to(law, np.shape(x.velocity)) for law in laws])


def scan_edges(
    term: Term, residuals: ResidualFunction[Term], edges: Sequence[NonlinearParameter], reach: float
) -> Term:
    """Search each edge on a grid, then on finer grids around the best value; return the best variant.

    The first grid extends to either side by `reach` [s] if the parameter is an instant, else by `NONLINEAR.leap` step
    units.
    """
    for parameter in edges:
        for width in NONLINEAR.widths:
            value = term.nonlinear_values[parameter.name]
            step = width * (reach if parameter.instant else NONLINEAR.leap * get_step_unit(parameter, value))
            values = value + step * np.linspace(-1.0, 1.0, NONLINEAR.scanned)
            variants = [set_values(term, [parameter], [value]) for value in values]
            term = variants[int(np.argmin([float(residual @ residual) for residual in residuals(variants)]))]
    return term


def search_by_cross_entropy(variants: Sequence[Term], residuals: ResidualFunction[Term]) -> Term:
    """Search the variant of least residual by random draws around the best variants; for many local minima.

    The free continuous parameters must be positive: the draws are normal in their logarithms. The seed is fixed.

    Source: Rubinstein and Kroese, The Cross-Entropy Method, 2004.
    """
    rng = np.random.default_rng(0)
    sought = list_continuous_parameters(variants[0])

    def compute_errors(drawn: Sequence[Term]) -> list[float]:
        return [float(np.linalg.norm(residual)) for residual in residuals(drawn)]

    ranked = sorted(zip(compute_errors(variants), variants, strict=True), key=lambda pair: pair[0])[: NONLINEAR.elite]
    for _ in range(NONLINEAR.rounds):
        elite = np.log([[term.nonlinear_values[parameter.name] for parameter in sought] for _, term in ranked])
        spread = 1.2 * elite.std(axis=0) + 0.02
        draws = np.exp(elite.mean(axis=0) + spread * rng.standard_normal((NONLINEAR.draws, len(sought))))
        drawn = [set_values(variants[0], sought, draw) for draw in draws]
        ranked += zip(compute_errors(drawn), drawn, strict=True)
        ranked = sorted(ranked, key=lambda pair: pair[0])[: NONLINEAR.elite]
    return ranked[0][1]
