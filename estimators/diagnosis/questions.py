"""Open questions of a diagnosis for an experiment, and the smallest detectable size of absent effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.decisions.errors import Terms
from estimators.diagnosis.result import Candidate, Detectable
from estimators.diagnosis.suggestion import Aim
from estimators.findings import Finding, Verdict
from estimators.free_swings import find_known_values
from estimators.regression.least_squares import Equations, solve_least_squares, subtract_known_columns
from estimators.selection.candidates import find_best_variant
from estimators.selection.evidence import Evidence
from estimators.signals.residual import makes_whole_turns
from estimators.weak_form.torque_windows import TorqueWindows, find_largest_sizes
from pendulum_env._typing import Array
from pendulum_env.physics import Term, list_ids, list_nameable
from pendulum_env.plant import get_typical_values, paper_plant
from pendulum_env.units import is_of_torque

STRUCTURE_FACTOR = 2.0  # factor on the limits of structure, since neighbouring windows share about half of a torque
PENALTY_FACTOR = 3.0  # factor on the penalty, above which a gain is nearly always found


@dataclass(frozen=True)
class Question:
    """Question for an experiment: whether a rival model explains a torque.

    Attributes:
        aim: aim of the experiment.
        terms: terms of the rival model: with the effect in the place of a term, or without the effect.
        torque: effect of typical size with its linear parameters, as source of the torque to explain; None for the
            torque of the fitted model.
    """

    aim: Aim
    terms: tuple[Term, ...]
    torque: tuple[Term, Array] | None = None

    def measure_unexplained(self, data: TorqueWindows, equations: Equations) -> float:
        """Return the RMS torque of a simulated experiment that the rival model cannot explain [N m].

        `equations` are those of `terms` on `data`; known parameters keep their values.
        """
        known = find_known_values(self.terms)
        indices = [k for k, name in enumerate(c.name for term in self.terms for c in term.columns) if name in known]
        equations = subtract_known_columns(equations, indices, np.array(list(known.values())))
        phi, y = equations.phi, equations.y
        if self.torque is not None:
            term, theta = self.torque
            linear, fixed = data.columns([term])[0]
            y = linear @ theta + fixed
        return float(np.sqrt(np.mean((y - phi @ solve_least_squares(phi, y)) ** 2)))


def list_questions(
    evidence: Evidence,
    terms: Sequence[Term],
    groups: Sequence[tuple[str, ...]],
    candidates: Sequence[Candidate],
    doubts: Sequence[Finding],
    detectable: Sequence[Detectable] = (),
) -> list[Question]:
    """List the open questions of a diagnosis.

    Each effect that ties with a selected effect (`groups`) or, by `doubts`, with a determined term is a question; then
    each effect that was not excited, or has no possible `detectable` size, unless it acts beyond an end of the range
    alone.
    """
    hidden = {effect.effect for effect in detectable if not effect.is_excited}
    pairs = [(id, selected) for selected, *tied in groups for id in tied]
    pairs += [doubt.rivals for doubt in doubts if doubt.rivals is not None and doubt.rivals[1] not in doubt.withheld]
    present = list_ids(terms)
    questions = []
    for id, instead in pairs:
        others = [term for term in terms if term.id != instead]
        if id in evidence.library.keys() - present and len(others) < len(terms):
            trial = find_best_variant(evidence, tuple(others), evidence.library[id])
            if trial is not None:
                questions.append(Question(Aim(id, instead), trial.terms))
    for candidate in candidates:
        kind = evidence.library[candidate.effect]
        has_open_ends = any(kind().open_ends)
        is_asked = candidate.effect in {question.aim.effect for question in questions}
        is_hidden = candidate.verdict is Verdict.NOT_EXCITED or candidate.effect in hidden
        if is_hidden and not has_open_ends and not is_asked:
            inertia = evidence.train.recordings[0].known_inertia
            questions.append(Question(Aim(candidate.effect), tuple(terms), make_typical_effect(kind, inertia)))
    return questions


def make_typical_effect(kind: type[Term], inertia: float = 0.0) -> tuple[Term, Array]:
    """Return an effect of typical size and its linear parameters (P,).

    With the inertia of a free swing [kg m^2], torques are scaled by its ratio to the inertia of the paper's rig.
    """
    values = get_typical_values(kind())
    term = kind(**{parameter.name: values.pop(parameter.name) for parameter in kind.nonlinear_parameters})
    theta = np.array(list(values.values()))
    if inertia:
        is_torque = [is_of_torque(column.unit) for column in term.columns]
        theta = theta * np.where(is_torque, inertia / paper_plant().estimates["inertia"].value, 1.0)
    return term, theta


def find_detectable_size(evidence: Evidence, terms: Terms, kind: type[Term]) -> float | None:
    """Find the smallest detectable size of an effect added to the terms, in the unit of its first parameter.

    An effect with RMS torque r after a fit of the terms gains about N/2 log(1 + r^2 / s^2) nats over N windows with
    noise s. The gain must reach `PENALTY_FACTOR` penalties, and r must be significant structure. Return None if no size
    is detectable in N windows, or if the terms imitate the effect.
    """
    term, theta = make_typical_effect(kind)
    if not len(theta):
        return None
    (columns,) = evidence.train.maker.columns([term])
    torque, phi = columns.linear @ theta, evidence.train.equations(terms).phi
    outside = torque - phi @ np.linalg.lstsq(phi, torque, rcond=1e-10)[0]
    outside_rms = float(np.sqrt(np.mean(outside**2)))
    if outside_rms < 1e-9 * float(np.sqrt(np.mean(torque**2))) or outside_rms == 0.0:
        return None
    noise = max(evidence.residuals.noise_floor(), float(np.sqrt(np.mean(evidence.train.residual(terms) ** 2))))
    # least significant r^2 / (r^2 + s^2)
    correlated = STRUCTURE_FACTOR * evidence.criterion.z_score / float(np.sqrt(len(outside)))
    if correlated >= 1.0:
        return None
    nats = PENALTY_FACTOR * evidence.penalty((*terms, term), terms)
    least = max(
        noise * float(np.sqrt(np.expm1(2 * nats / len(outside)))),
        noise * float(np.sqrt(correlated / (1.0 - correlated))),
        STRUCTURE_FACTOR * evidence.criterion.noise_ratio * evidence.residuals.noise_floor(),
    )
    return float(np.linalg.norm(theta)) * least / outside_rms


def find_detectable_effects(
    evidence: Evidence, terms: Terms, library: Mapping[str, type[Term]]
) -> tuple[Detectable, ...]:
    """Return the smallest detectable size of each common effect, and the recorded range without a stop.

    A size is omitted if it exceeds the bounds of the law, or if its torque exceeds the applied torque: the
    data do not excite the effect. A joint that makes whole turns has no range.
    """
    effects, data, units = list[Detectable](), evidence.train.data, evidence.train.units()
    for kind in (kind for kind in library.values() if kind.is_common):
        size, (term, _) = find_detectable_size(evidence, terms, kind), make_typical_effect(kind)
        if size is not None:
            column = term.columns[0]
            is_possible = size <= find_largest_sizes(data, term)[0] and column.is_allowed(size)
            effects.append(Detectable(kind.id, size if is_possible else None, units.unit(column.unit)))
    if makes_whole_turns(evidence.train.samples.position):
        return tuple(effects)
    stops = [id for id, kind in list_nameable().items() if any(kind().open_ends)]
    unit, between = units.unit("rad"), evidence.train.get_range()
    return (*effects, *(Detectable(id, unit=unit, between=between) for id in stops))
