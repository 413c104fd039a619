"""Moves of the search as tables: state in, state out, with scores that are given instead of data."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.decisions.criterion import Criterion
from estimators.decisions.gate import Gate
from estimators.decisions.score import Bootstrap
from estimators.selection import candidates, evidence, gates, tables
from estimators.selection.candidates import screen_library
from estimators.selection.densities import Densities
from estimators.selection.evidence import Evidence
from estimators.selection.free_motion import FreeMotion
from estimators.selection.moves import (
    add_dry_friction,
    add_pair,
    drop_effect,
    extend_model,
    revise,
    swap_effect,
)
from estimators.selection.policies import ADD
from estimators.selection.shares import ExplainedShares
from estimators.selection.state import SearchState
from estimators.selection.tables import replace_by_table
from estimators.weak_form.point import Point
from estimators.weak_form.rows import ScoredTerms
from pendulum_env.physics import BASE, Term, effect
from pendulum_env.physics.table import FrictionBySpeed

BLOCKS = 20
LIBRARY = {"D": effect("quadratic_drag"), "A": effect("viscous_asymmetry"), "O": effect("torque_offset")}
BACKLASH = effect("backlash")
LETTERS = {kind.id: letter for letter, kind in (LIBRARY | {"T": FrictionBySpeed}).items()}
NOISE = 1000.0  # [nat] of gain from which the residual is noise


@pytest.fixture(autouse=True)
def single_variants(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each effect one variant."""
    monkeypatch.setattr(evidence, "count_tried", lambda data, terms, kind: 1)
    monkeypatch.setattr(gates, "compare_errors", compare_gains)
    monkeypatch.setattr(tables, "make_variants", lambda data, terms, kind: [kind()])
    for module, name in ((candidates, "rank_variants"), (candidates, "refine_variants"), (tables, "refine_variants")):
        monkeypatch.setattr(module, name, lambda data, terms, kind: [ScoredTerms((*terms, kind()), 0.0)])


def fit_exactly(terms: tuple[Term, ...]) -> SimpleNamespace:
    """Return a fit without standard errors, whose coefficients have no test."""
    return SimpleNamespace(std=np.zeros(sum(len(term.columns) for term in terms)))


def compare_gains(
    after: SimpleNamespace, before: SimpleNamespace, motions: dict, margin: float, *_: bool
) -> list[Gate]:
    """Make the gates of held-out errors: a model with more gain has a lower error."""
    bounds = Gate("physical_bounds", 0.0, 0.0, True)
    return [bounds, Gate("holdout_torque", -after.gain, -before.gain, after.gain > before.gain)]


class KnownEvidence(Evidence):
    """Evidence whose models have given gains over the base model [nat]; a model without one has none.

    The explained share is the gain over what the best model would gain.
    """

    def __init__(self, gains: dict[str, float], tables: tuple[type[Term], ...] = ()) -> None:
        self.gains, self.criterion, self.tables = gains, Criterion(), tables
        self.library = {kind.id: kind for kind in LIBRARY.values()}
        train = SimpleNamespace(
            layout=SimpleNamespace(predicts_torque=True, has_fast_fits=True, clusters=np.arange(BLOCKS)),
            segments=(),
            motions={},
            recorded_motions={},
            data=SimpleNamespace(link_states={}, windows=()),
            equations=lambda terms: SimpleNamespace(fit=lambda clusters: fit_exactly(terms)),
            maker=SimpleNamespace(
                fit=lambda terms, exactly: Point(terms, np.empty(0)),
                score_terms=lambda terms: ScoredTerms(tuple(terms), 0.0),
            ),
        )
        self.fits = SimpleNamespace(
            train=train,
            base=BASE,
            linked=None,
            release_known=lambda terms: terms,
            fit_model_with_std=lambda terms: SimpleNamespace(estimates={}, terms=terms),
            find_violations=lambda terms: [],
            fit=lambda terms: SimpleNamespace(model=SimpleNamespace(terms=terms, estimates={}), gain=self.total(terms)),
            refit_to_motion=lambda step: step,
        )
        self.residuals = SimpleNamespace(
            joints=("",),
            is_noise=lambda terms: self.total(terms) >= NOISE,
            are_refitted=lambda terms: False,
            relative_rms=lambda terms: 1.0,
            is_noise_at=lambda at, terms: self.total(terms) >= NOISE,
        )
        bootstrap = Bootstrap(np.zeros(BLOCKS, dtype=np.intp), np.random.default_rng(0))
        self.densities = KnownDensities(self.fits, self.residuals, self.criterion, bootstrap)
        self.densities.total = self.total
        self.motion = FreeMotion(self.fits, self.criterion)
        self.shares = KnownShares(self.residuals, self.motion)
        self.shares.total = self.total

    def total(self, terms: tuple[Term, ...]) -> float:
        return self.gains.get(letters(terms), 0.0)

    def progress(self, text: str, share: float) -> None:
        """Nothing is printed."""


class KnownShares(ExplainedShares):
    """Shares of what the best model gains."""

    def compute_of_torque(self, after: tuple[Term, ...], before: tuple[Term, ...], *_: bool, **__: bool) -> float:
        return (self.total(after) - self.total(before)) / max(NOISE - self.total(before), 0.1 * NOISE)


class KnownDensities(Densities):
    """Densities that give each block the same part of the gain; all blocks are held out."""

    held_out = slice(None)

    def compute(self, terms: tuple[Term, ...]) -> np.ndarray:
        return np.full(BLOCKS, self.total(terms) / BLOCKS)


def letters(terms: tuple[Term, ...]) -> str:
    """The effects of a model in the order of the alphabet: `AD`."""
    return "".join(sorted(LETTERS[term.id] for term in terms if term.id in LETTERS))


def state(evidence: Evidence, effects: str) -> SearchState:
    return SearchState(evidence, BASE, (*BASE, *(LIBRARY[letter]() for letter in effects)))


CLEAR = {"D": 1000.0, "AD": 1000.0, "DO": 1000.0, "ADO": 1000.0}  # only drag is missing
TWO = {"D": 700.0, "O": 300.0, "DO": 1000.0, "A": 650.0, "AO": 950.0, "AD": 701.0}
HIDDEN = {"D": 2.0, "O": 2.0, "DO": 1000.0}  # each effect shows only beside the other


@pytest.mark.parametrize(
    ("move", "gains", "before", "after"),
    [
        (extend_model, CLEAR, "", "D"),
        (extend_model, CLEAR, "D", None),
        (extend_model, TWO, "D", "DO"),
        (add_dry_friction, CLEAR, "", None),  # without segments of motion
        (extend_model, {"A": 3.0}, "", None),  # below the penalty for three effects and the p-value
        (extend_model, {"A": 100.0}, "", None),  # significant, but a tenth of the residual
        (extend_model, HIDDEN, "", "DO"),
        (drop_effect, CLEAR, "DO", "D"),
        (drop_effect, CLEAR, "D", None),
        (drop_effect, {}, "A", ""),
        (drop_effect, TWO, "DO", None),
        (swap_effect, TWO, "AO", "DO"),
        (swap_effect, TWO, "DO", None),
        (swap_effect, CLEAR, "A", None),  # one effect alone was the best
        (revise, CLEAR, "ADO", "D"),
        (revise, TWO, "AO", "DO"),
        (revise, TWO, "DO", "DO"),
    ],
)
def test_move_leads_from_state_to_state(move: Callable, gains: dict, before: str, after: str | None):
    begin = state(KnownEvidence(gains), before)
    found = move(begin)
    assert (None if found is None else letters(found.terms)) == after
    assert letters(begin.terms) == before  # the state itself does not change


@pytest.mark.parametrize(("gains", "after"), [(HIDDEN, "DO"), (CLEAR, None), ({"O": 599.0, "DO": 600.0}, None)])
def test_pair_is_added_if_each_effect_needs_the_other(gains: dict, after: str | None):
    begin = state(KnownEvidence(gains), "")
    found = add_pair(begin)
    assert (None if found is None else letters(found.terms)) == after


@pytest.mark.parametrize(
    ("gains", "before", "after", "has_table"),
    [
        ({"T": 1000.0}, "", "", True),  # no effect is such a law
        ({"D": 600.0, "T": 1000.0, "DT": 1000.0}, "D", "", True),  # drag only imitates the table
        ({"D": 1000.0, "T": 600.0, "DT": 1000.0}, "D", "D", False),
        ({"D": 600.0, "T": 650.0, "DT": 1000.0}, "D", "D", True),  # both are needed
        ({"AD": 1000.0, "T": 1100.0}, "AD", "", True),  # two effects of its kind that it beats
        ({"AD": 1000.0, "T": 1010.0}, "AD", "", True),  # by a small share
        ({"AD": 1000.0, "T": 990.0}, "AD", "AD", False),
        ({"DO": 1000.0, "T": 1100.0}, "DO", "DO", False),  # an offset is none of its kind
        ({}, "", "", False),
    ],
)
def test_table_replaces_effects_that_imitate_it(gains: dict, before: str, after: str, has_table: bool):
    found = replace_by_table(state(KnownEvidence(gains, (FrictionBySpeed,)), before))
    assert (letters(found.terms), found.table is not None) == (after, has_table)


@pytest.mark.parametrize(
    ("gains", "before", "gate"),
    [
        ({"": NOISE}, "", "residual_over_noise"),  # nothing is left to explain
        ({"D": NOISE}, "", "residual_over_noise"),  # a simpler effect explains all
        ({"D": 500.0}, "D", "earlier_effects"),
        ({}, "", None),
    ],
)
def test_screening_keeps_why_a_transmission_was_not_tried(gains: dict, before: str, gate: str | None):
    evidence = KnownEvidence(gains)
    evidence.library[BACKLASH.id] = BACKLASH
    terms, decision = screen_library(evidence, state(evidence, before).terms)[BACKLASH.id]
    assert [(own.name, own.passed) for own in decision.gates] == ([] if gate is None else [(gate, False)])
    assert (terms is None) == (gate is not None)


def test_gates_hold_gain_penalty_p_value_share_and_coefficients_up_to_the_first_that_fails():
    evidence, found = KnownEvidence({"A": 1.0, "D": 100.0, "O": 900.0}), {}
    for letter in "ADO":
        gates = evidence.decide(state(evidence, letter).terms, BASE, ADD).gates
        found[letter] = [(gate.name, gate.passed) for gate in gates]
        assert gates[0].value == pytest.approx(evidence.total(state(evidence, letter).terms))
        assert gates[0].limit == pytest.approx(np.log(len(LIBRARY)))  # one variant of each effect was tried
    passed = [("gain", True), ("p_value", True)]
    assert found["D"] == [*passed, ("explained_share", False)]
    assert found["O"] == [*passed, ("explained_share", True), ("coefficients", True)]
    assert found["A"] == [("gain", False), ("p_value", False)]
