"""Questions that a diagnosis leaves open, which an experiment may settle, and the smallest effects that would show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.diagnosis.result import Candidate, Detectable
from estimators.diagnosis.suggestion import Aim
from estimators.findings import Finding, Verdict
from estimators.free_swings import find_known_values
from estimators.regression.least_squares import Equations, give, solve_least_squares
from estimators.selection.candidates import find_best_variant
from estimators.selection.errors import Terms
from estimators.selection.evaluator import ModelEvaluator
from estimators.signals.residual import makes_whole_turns
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import Term, list_ids
from pendulum_env.plant import get_typical_values, paper_plant
from pendulum_env.units import is_of_torque

TOLD = ("stribeck", "quadratic_drag", "load_dependent_friction", "cogging", "spring")  # as long as they are known
CLEAR = 2.0  # times what counts as structure: windows next to each other share about half of it
DOUBT = 3.0  # times the gain that chance may give, which is then found nearly always


@dataclass(frozen=True)
class Question:
    """Question that an experiment may settle: whether a rival model explains the torque.

    Attributes:
        aim: what it is.
        terms: of the rival model: with the effect in place of the other, or without it.
        torque: effect of typical size whose torque is to be seen, with its linear parameters; None to see the model's.
    """

    aim: Aim
    terms: tuple[Term, ...]
    torque: tuple[Term, Array] | None = None

    def unexplained(self, data: TorqueWindows, equations: Equations) -> float:
        """Compute the RMS torque of a simulated experiment that the rival model cannot explain [N m]."""
        known = find_known_values(self.terms)
        given = [k for k, name in enumerate(c.name for term in self.terms for c in term.columns) if name in known]
        equations = give(equations, given, np.array(list(known.values())))
        phi, y = equations.phi, equations.y
        if self.torque is not None:
            term, theta = self.torque
            linear, fixed = data.columns([term])[0]
            y = linear @ theta + fixed
        return float(np.sqrt(np.mean((y - phi @ solve_least_squares(phi, y)) ** 2)))


def list_questions(
    evaluator: ModelEvaluator,
    terms: Sequence[Term],
    groups: Sequence[tuple[str, ...]],
    candidates: Sequence[Candidate],
    doubts: Sequence[Finding],
    detectable: Sequence[Detectable] = (),
) -> list[Question]:
    """List the open questions of a diagnosis.

    Effects that the data do not show are asked for: those that are not excited, and those of which no possible size
    would be detected.
    """
    hidden = {one.effect for one in detectable if not one.is_excited}
    pairs = [(id, selected) for selected, *alike in groups for id in alike]
    pairs += [doubt.rivals for doubt in doubts if doubt.rivals is not None]
    present = list_ids(terms)
    asked = []
    for id, instead in pairs:
        others = [term for term in terms if term.id != instead]
        if id in evaluator.library.keys() - present and len(others) < len(terms):
            trial = find_best_variant(evaluator, tuple(others), evaluator.library[id])
            if trial is not None:
                asked.append(Question(Aim(id, instead), trial.terms))
    for candidate in candidates:
        kind = evaluator.library[candidate.effect]
        out_of_reach = any(kind().open_ends)  # no motion is risked for a mere suspicion
        asked_already = candidate.effect in {question.aim.effect for question in asked}
        is_hidden = candidate.verdict is Verdict.NOT_EXCITED or candidate.effect in hidden
        if is_hidden and not out_of_reach and not asked_already:
            inertia = evaluator.train.recordings[0].known_inertia
            asked.append(Question(Aim(candidate.effect), tuple(terms), make_typical_effect(kind, inertia)))
    return asked


def make_typical_effect(kind: type[Term], inertia: float = 0.0) -> tuple[Term, Array]:
    """Make an effect of a typical size, and its linear parameters (P,).

    Of a free swing, torques are in the proportion of its inertia to that of the paper's rig.
    """
    values = get_typical_values(kind)
    term = kind(**{parameter.name: values.pop(parameter.name) for parameter in kind.nonlinear_parameters})
    theta = np.array(list(values.values()))
    if inertia:
        is_torque = [is_of_torque(column.unit) for column in term.columns]
        theta = theta * np.where(is_torque, inertia / paper_plant().estimates["inertia"].value, 1.0)
    return term, theta


def find_detectable_size(evaluator: ModelEvaluator, terms: Terms, kind: type[Term]) -> float | None:
    """Find the smallest detectable size of an effect added to the terms, in the unit of its first parameter.

    An effect whose torque has a root mean square r after a fit of the terms gains about N/2 log(1 + r^2 / s^2) nats
    over N windows whose noise is s; and r has to be structure, not noise, which N windows may be too few to tell. None
    if no size would do, or the data do not depend on it.
    """
    term, theta = make_typical_effect(kind)
    if not len(theta):
        return None
    (columns,) = evaluator.train.maker.columns([term])
    torque, phi = columns.linear @ theta, evaluator.train.equations(terms).phi
    left = torque - phi @ np.linalg.lstsq(phi, torque, rcond=1e-10)[0]
    shown = float(np.sqrt(np.mean(left**2)))
    if shown < 1e-9 * float(np.sqrt(np.mean(torque**2))) or shown == 0.0:
        return None
    noise = max(evaluator.residuals.noise_floor(), float(np.sqrt(np.mean(evaluator.train.residual(terms) ** 2))))
    correlated = (
        CLEAR * evaluator.criterion.z_score / float(np.sqrt(len(left)))
    )  # r^2 / (r^2 + s^2) that is significantly shared
    if correlated >= 1.0:
        return None
    nats = DOUBT * evaluator.penalty((*terms, term), terms)
    least = max(
        noise * float(np.sqrt(np.expm1(2 * nats / len(left)))),
        noise * float(np.sqrt(correlated / (1.0 - correlated))),
        CLEAR * evaluator.criterion.noise_ratio * evaluator.residuals.noise_floor(),
    )
    return float(np.linalg.norm(theta)) * least / shown


def find_detectable_effects(
    evaluator: ModelEvaluator, terms: Terms, library: Mapping[str, type[Term]]
) -> tuple[Detectable, ...]:
    """Find the smallest detectable size of effects in addition to the terms.

    A size whose torque exceeds all that was applied is impossible: the data do not excite such an effect.
    """
    found, data, units = list[Detectable](), evaluator.train.data, evaluator.train.units()
    for kind in (library[id] for id in TOLD if id in library):
        size, (term, _) = find_detectable_size(evaluator, terms, kind), make_typical_effect(kind)
        if size is not None:
            above = size if size <= data.find_largest_sizes(term)[0] else None
            found.append(Detectable(kind.id, above, units.unit(term.columns[0].unit)))
    stop = Detectable("hard_stop", unit=units.unit("rad"), between=evaluator.train.get_range())
    return tuple(found) if makes_whole_turns(evaluator.train.samples.position) else (*found, stop)
