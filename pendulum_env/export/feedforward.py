"""Export of the torque that compensates friction, cogging and weight, as a function and tables in C or Python.

The function solves the torque balance at constant speed. The direction replaces the sign of the speed: at rest, it is
the direction of the wanted motion. Where a motor that saturates cannot balance the joint, its torque is limited to the
largest torque that does so elsewhere.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.export.dynamics import StepBuilder, make_identifier
from pendulum_env.export.program import ProgramText, load_environment, write_number
from pendulum_env.export.request import Exported, ExportError, Language, escape_text, write_title
from pendulum_env.export.sizes import ANGLES, SPEEDS, STATELESS, compute_torque, describe_size
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.potential import WEIGHT
from pendulum_env.physics.simulation import TorqueBalance
from pendulum_env.physics.symbols import make_symbol
from pendulum_env.physics.terms import is_pure_delay

ROUNDS = 60  # of the solution where friction follows the torque: errors fall by the coefficient, at most 0.7
TOLERANCE = 1e-3  # change in the last round, relative to the largest torque, beyond which there is no solution
N_ANGLES, N_SPEEDS = 256, 26  # rows of the tables


def select_terms(model: Model, has_links: bool = False) -> tuple[Model, tuple[str, ...]]:
    """Return the terms of a model whose torque follows from angle and speed, and phrases on the others.

    At a joint with links, the torque also carries these, so terms that depend on it are among the others.
    """
    kept, losses = [], list[str]()
    for term in model.terms:
        is_function = term.kind in STATELESS and not (term.has_impacts or term.needs or is_pure_delay(type(term)))
        is_function = is_function and not (has_links and follows_torque([term]))
        if term.id == BackEmf.id or (is_function and not term.has_memory):
            kept.append(term)
        elif term.kind != "inertial":
            losses.append(f"{term.id} ({term.law}; {describe_size(model, term)})")
    left_out = {name for term in model.terms if term not in kept for name in term.parameter_names}
    estimates = {name: estimate for name, estimate in model.estimates.items() if name not in left_out}
    return replace(model, terms=tuple(kept), estimates=estimates, correlation=()), tuple(losses)


def compute_feedforward(
    model: Model, position: Array, velocity: Array, direction: Array, limit: float = math.inf, rounds: int = ROUNDS
) -> Array:
    """Return the torque at constant speed (N,) [N m], at most `limit`; see `select_terms` for the model."""
    balance, torque = TorqueBalance(model.terms, model.theta), np.zeros_like(position)
    for _ in range(rounds if follows_torque(model.terms) else 1):
        x = Samples(torque, position, velocity, torque, {BackEmf.id: (np.ones(()),)})
        torque = torque - np.asarray(balance.net(x)) + np.asarray(balance.dry(x)) * direction
        torque = np.clip(torque, -limit, limit)
    return torque


def find_limit(model: Model) -> tuple[float, str]:
    """Return the largest torque [N m] that balances the joint, and a phrase on the angles where no torque does so.

    The limit is infinity if there is a solution at all `ANGLES` and `SPEEDS`, and also far beyond these speeds. The
    phrase is empty if there is one at `SPEEDS`. See `select_terms` for the model.
    """
    near = _make_grid()
    fast = SPEEDS[-1] * np.outer([1.0, -1.0], 2.0 ** np.arange(1, 8)).ravel()
    far = (np.tile(ANGLES, len(fast)), np.repeat(fast, len(ANGLES)))
    position, velocity = (np.concatenate(pair) for pair in zip(near, far, strict=True))
    first, before, torque = (
        compute_feedforward(model, position, velocity, np.sign(velocity), rounds=n) for n in (1, ROUNDS - 1, ROUNDS)
    )
    count = len(near[0])
    is_solved = np.abs(torque - before) <= TOLERANCE * np.abs(first[:count]).max()
    if is_solved.all():
        return math.inf, ""
    limit = float(np.abs(torque[is_solved]).max(initial=0.0))
    has_none = ~is_solved[:count].reshape(len(ANGLES), -1).all(axis=1)
    if not has_none.any():
        return limit, ""
    ends = np.flatnonzero(np.diff(has_none, prepend=False, append=False))
    ranges = ", ".join(f"{ANGLES[a]:.2f} to {ANGLES[b - 1]:.2f}" for a, b in ends.reshape(-1, 2))
    unit = model.units().unit
    return limit, (
        f"no torque balances the joint at {ranges} {unit('rad')} for some speeds up to {SPEEDS[-1]:g} {unit('rad/s')}"
    )


def _make_grid() -> tuple[Array, Array]:
    """Return positions and velocities (N,), all velocities at the first of `ANGLES` first."""
    position, velocity = np.meshgrid(ANGLES, np.concatenate([-SPEEDS, SPEEDS])[::10], indexing="ij")
    return position.ravel(), velocity.ravel()


def follows_torque(terms: Sequence[Term]) -> bool:
    """Return whether the law of a term depends on the motor torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def export(joints: Sequence[tuple[str, Model]], language: Language) -> Exported:
    """Write functions and tables for some joints with links, by name, or for one without name and links.

    Raises ExportError if a law of a model cannot be converted to an expression.
    """
    template = load_environment().get_template(f"feedforward.{'c' if language == 'c' else 'py'}.txt")
    parts = [_describe_joint(name, model, language) for name, model in joints]
    notes = [f"{part['name']} does not compensate {text}" for part in parts for text in part["losses"]]
    notes += [
        f"{part['name']} is limited to {part['limit']:.3g} {part['unit']}: {part['unsolved']}"
        for part in parts
        if part["unsolved"]
    ]
    used = {op for part in parts for program in (part["torque"], part["weight"]) for op in program.used}
    return Exported(template.render(joints=parts, used=used, number=partial(write_number, language)), tuple(notes))


def _describe_joint(name: str, model: Model, language: Language) -> dict[str, Any]:
    """Return the content of the template for a joint."""
    selected, losses = select_terms(model, has_links=bool(name))
    try:
        parts = StepBuilder.from_model(selected, 1.0)
        given: Any = {"time": 0.0, "memory": {BackEmf.id: (1.0,)}}
        x: Any = replace(parts.x, **given)
        weights = tuple(c for term in selected.terms if term.id in WEIGHT for c in term.columns)
        theta = dict(zip((c.name for c in selected.columns), parts.balance.theta, strict=True))
        torque = x.torque - parts.balance.net(x) + parts.balance.dry(x) * make_symbol("direction")
        weight = sum((theta[column.name] * column.force(x) for column in weights), 0.0)
        programs = [ProgramText.write([result], language) for result in (torque, weight)]
    except Exception as error:  # a user's law may raise anything
        raise ExportError(f"a law of this model cannot be written down as a formula: {error}") from None
    angles, speeds = np.arange(N_ANGLES) * 2.0 * np.pi / N_ANGLES, np.linspace(0.0, SPEEDS[-1], N_SPEEDS)
    limit, unsolved = find_limit(selected)
    zeros, rest, ways = np.zeros(N_ANGLES), np.zeros(N_SPEEDS), (1.0, -1.0)
    weight_by_angle = compute_torque(weights, selected, Samples(zeros, angles, zeros, zeros))
    by_angle = [compute_feedforward(selected, angles, zeros, zeros + way, limit) - weight_by_angle for way in ways]
    by_speed = [compute_feedforward(selected, rest, way * speeds, rest + way, limit) for way in ways]
    unit = model.units().unit
    tables = [
        ("angle", "angle [rad] at speed 0, without weight", np.column_stack([angles, *by_angle])),
        ("speed", f"speed [{unit('rad/s')}] at position 0", np.column_stack([speeds, *by_speed])),
    ]
    names = programs[0].names | programs[1].names
    return {
        "name": make_identifier(f"{name}_feedforward") if name else "feedforward",
        "title": escape_text(f"{name}: {write_title(model)}" if name else write_title(model)),
        "unit": unit("N m"),
        "motion": f"a position [{unit('rad')}], a speed [{unit('rad/s')}]",
        "parameters": [parameter for parameter in parts.parameters if parameter.name in names],
        "torque": programs[0],
        "weight": programs[1],
        "rounds": ROUNDS if "torque" in programs[0].names else 1,
        "tables": tables if np.ptp(by_angle, axis=1).max() > 0 and not model.is_prismatic else tables[1:],
        "losses": [escape_text(text) for text in losses],
        "limit": limit if math.isfinite(limit) else None,
        "unsolved": unsolved,
        "range": "positions from -3.14 to 3.14 m" if model.is_prismatic else "a turn",
        "speed": f"{SPEEDS[-1]:g} {unit('rad/s')}",
        "error": estimate_error(selected, model, limit),
    }


def estimate_error(selected: Model, model: Model, limit: float) -> float:
    """Return the RMS standard error of the torque from the linear parameters of a model, over a turn and `SPEEDS`."""
    position, velocity = _make_grid()
    torque = compute_feedforward(selected, position, velocity, np.sign(velocity), limit)
    x = Samples(torque, position, velocity, torque, {BackEmf.id: (np.ones(()),)})
    columns, names = selected.columns, list(model.estimates)
    place = [names.index(column.name) for column in columns]
    covariance = model.assumed_covariance[np.ix_(place, place)]
    slopes = np.column_stack([np.broadcast_to(column.torque(x, 0.0), position.shape) for column in columns])
    is_known = np.isfinite(np.diag(covariance))
    covariance[~is_known] = covariance[:, ~is_known] = 0.0
    return math.sqrt(float(np.mean(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))))
