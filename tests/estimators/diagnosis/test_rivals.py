"""Standard errors include the choice among effects that the data cannot distinguish."""

from types import SimpleNamespace

import pytest

from estimators.decisions.decision import Decision
from estimators.decisions.gate import Gate
from estimators.diagnosis.ranking import Tie, widen_by_rivals
from estimators.diagnosis.result import Candidate
from estimators.findings import Verdict
from pendulum_env.physics import BASE, Model, effect

DRAG, STRIBECK = ((*BASE, effect(id)()) for id in ("quadratic_drag", "stribeck"))
OF_RIVAL = [0.1, 2.0, 0.5, 0.6, 0.3]


@pytest.mark.parametrize("probability", [0.2, 0.5])
def test_the_variance_is_that_of_the_mixture_of_both_models(probability):
    own = Model.build(DRAG, [0.1, 2.0, 0.3, 0.9, 0.05], [0.001, 0.0, 0.02, 0.03, 0.01])
    models = {DRAG: own, STRIBECK: Model.build(STRIBECK, OF_RIVAL, 0.01)}
    evidence = SimpleNamespace(fits=SimpleNamespace(fit_model=models.get))
    tie = Tie((DRAG[-1].id, STRIBECK[-1].id))
    selected = Candidate(DRAG[-1].id, 1.0, Verdict.SELECTED, 0.5, None, terms=DRAG)
    rival = Candidate(STRIBECK[-1].id, probability, Verdict.AMBIGUOUS, 0.5, tie, terms=STRIBECK)
    wider = widen_by_rivals(own, evidence, [selected, rival]).estimates
    for name, difference in (("inertia", 0.0), ("viscous", 0.2), ("coulomb", -0.3), ("quadratic_drag", 0.0)):
        expected = own.estimates[name].std ** 2 + probability * difference**2
        assert wider[name].std ** 2 == pytest.approx(expected) and wider[name].value == own.estimates[name].value
    assert wider["gravity"].std == 0.0
    assert widen_by_rivals(own, evidence, [selected]) is own


@pytest.mark.parametrize("share", [0.1, 0.4])  # explained by drag; 0.2 is needed
def test_the_variance_has_the_change_by_an_effect_that_predicts_better_and_is_too_small(share):
    own = Model.build(BASE, [0.1, 2.0, 0.3, 0.9], 0.01)
    models = {BASE: own, DRAG: Model.build(DRAG, [0.1, 2.0, 0.1, 1.2, 0.05], 0.01)}
    evidence = SimpleNamespace(fits=SimpleNamespace(fit_model=models.get))
    gates = (
        Gate("gain", 20.0, 3.0, True),
        Gate("p_value", 0.01, 0.05, True),
        Gate("explained_share", share, 0.2, share > 0.2),
    )
    gain = SimpleNamespace(p_value=0.01)
    drag = Candidate(DRAG[-1].id, 0.4, Verdict.REJECTED, 0.9, None, gain, decision=Decision(gates), terms=DRAG)
    wider = widen_by_rivals(own, evidence, [drag]).estimates
    for name, difference in (("inertia", 0.0), ("viscous", 0.2), ("coulomb", 0.3)):
        expected = 0.01**2 + 0.99 * difference**2 * (share < 0.2)
        assert wider[name].std ** 2 == pytest.approx(expected)
