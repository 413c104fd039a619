"""Fits of the base model to the recordings of servos under some conventions, and the choice among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import Policy, decide
from estimators.decisions.gate import Gate, limit_gain
from estimators.decisions.score import Bootstrap
from estimators.findings import Quantity
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.rows import Terms
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.windows import Part
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.recording import Recording
from robots.servos.drive import find_declared_conventions
from robots.servos.in_loop.likelihood import compute_log_densities
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP
from robots.servos.torque import list_drives, replace_drive

Settings = dict[str, str]  # conventions of a drive, by name


class ConventionFit(NamedTuple):
    """Fit of terms to the recordings under the settings of some conventions; `density` of each block (S,) [nat]."""

    settings: Settings
    rows: RolloutRows
    terms: Terms
    density: Array

    @classmethod
    def from_rows(cls, settings: Settings, rows: RolloutRows, terms: Terms) -> ConventionFit:
        """Return the fit of the terms by some rows."""
        density = compute_log_densities(rows.rollouts, rows.fits.linearise(terms).error)
        return cls(settings, rows, terms, np.bincount(rows.layout.scored.block, density).astype(float))

    def with_effect(self, effect: Term) -> ConventionFit:
        """Return the fit with another effect, whose nonlinear parameters are fitted."""
        terms = self.rows.fits.fit_nonlinear((*self.terms, effect))
        return ConventionFit.from_rows(self.settings, self.rows, terms)

    @property
    def likelihood(self) -> float:
        """Return the log density of all blocks [nat]."""
        return float(self.density.sum())

    def select(self, names: Sequence[str]) -> Settings:
        """Return the settings of some names."""
        return {name: value for name, value in self.settings.items() if name in names}


class Choice(NamedTuple):
    """Chosen fit, the likeliest fit under other settings, and the gain over it [nat]."""

    fit: ConventionFit
    alternative: ConventionFit
    gain: Quantity


def group_by_loop(recordings: Sequence[Recording]) -> list[list[int]]:
    """Group the indices of recordings by the controlled quantity and the shaft of the encoder.

    Recordings without a drive are another group.
    """
    kinds = [[(drive.control, drive.encoder) for drive in list_drives([recording])] for recording in recordings]
    distinct = [kind for k, kind in enumerate(kinds) if kind not in kinds[:k]]
    return [[k for k, other in enumerate(kinds) if other == kind] for kind in distinct]


def complete_drives(recordings: Sequence[Recording], settings: Mapping[str, Any]) -> tuple[Recording, ...]:
    """Return the recordings with settings of undeclared conventions; the requested torque is computed again.

    A convention that one drive declares holds for all of its group, see `group_by_loop`.
    """
    result = list(recordings)
    for numbers in group_by_loop(recordings):
        declarations = find_declared_conventions(list_drives(recordings[k] for k in numbers))
        for k in numbers:
            for drive in list_drives([recordings[k]]):
                result[k] = replace_drive(recordings[k], drive.complete_conventions({**settings, **declarations}))
    return tuple(result)


def fit_conventions(
    recordings: Sequence[Recording],
    settings: Sequence[Settings],
    base: Terms,
    part: Part,
    criterion: Criterion,
    has_counts: bool = False,
) -> list[ConventionFit]:
    """Fit the base model under each of some settings, which drives take for their undeclared conventions.

    Positions are compared in counts if `has_counts`.
    """
    fits = []
    for own in settings:
        variant = complete_drives(recordings, own)
        options: Any = {"shares": part, "has_counts": has_counts}
        rollouts = Rollouts.from_pieces(variant, LOOP.simulation.fine_steps, **options)
        torque = TorqueRows(prepare_windows(rollouts.recordings, part=part))
        rows = RolloutRows(rollouts, torque, criterion=criterion)
        fits.append(ConventionFit.from_rows(own, rows, rows.fit(base, exactly=True).terms))
    return fits


def choose_fit(fits: Sequence[ConventionFit], names: Sequence[str], p_value: float, criterion: Criterion) -> Choice:
    """Choose the first fit that the likeliest one does not overrule by a gain with at most some p-value.

    With n fits, the penalty is ln(n): the best of n may gain as much by chance. Alternatives differ in settings of
    `names`.
    """
    best, penalty = max(fits, key=lambda fit: fit.likelihood), float(np.log(len(fits)))
    bootstrap = Bootstrap(best.rows.layout.scored.of_block)

    def require_gain(after: ConventionFit, before: ConventionFit) -> list[Gate]:
        return limit_gain(bootstrap.gain(after.density, before.density, penalty), penalty, p_value)

    overrule = Policy("overrule", (require_gain,))
    chosen = next(fit for fit in fits if not decide(best, fit, overrule).passed)
    others = [fit for fit in fits if fit.select(names) != chosen.select(names)]
    different = [fit for fit in others if abs(fit.likelihood - best.likelihood) > criterion.loop.same] or others
    alternative = max(different, key=lambda fit: fit.likelihood)
    gain = bootstrap.gain(chosen.density, alternative.density)
    return Choice(chosen, alternative, Quantity(gain.total, gain.error))
