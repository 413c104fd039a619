"""Effects that predict better, and explain too little."""

from dataclasses import dataclass

from estimators.diagnosis.result import Diagnosis
from estimators.findings import Finding


@dataclass(frozen=True)
class SmallEffect(Finding):
    """Effect that predicts better, with a p-value, but explains a smaller share than the `least`."""

    effect: str
    share: float
    least: float
    p_value: float


def find_small_effect(diagnosis: Diagnosis) -> list[SmallEffect]:
    """Return a finding on the effect with the largest gain that failed only by its explained share.

    The list is empty if effects were selected or a residual is unexplained.
    """
    if diagnosis.selected or diagnosis.unexplained:
        return []
    pairs = [(candidate, {gate.name: gate for gate in candidate.decision.gates}) for candidate in diagnosis.candidates]
    small = [(c, gates) for c, gates in pairs if [*gates][-1:] == ["explained_share"] and "p_value" in gates]
    if not small:
        return []
    candidate, gates = max(small, key=lambda pair: pair[1]["gain"].value)
    share = gates["explained_share"]
    return [SmallEffect(candidate.effect, share.value, share.limit, gates["p_value"].value)]
