"""Standard errors include the choice among effects that the data cannot distinguish."""

from types import SimpleNamespace

import pytest

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
