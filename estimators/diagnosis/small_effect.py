"""Effects that predict better, and explain too little."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.diagnosis.result import Candidate, Diagnosis
from estimators.findings import Finding


@dataclass(frozen=True)
class SmallEffect(Finding):
    """Effect that predicts better, with a p-value, but explains a smaller share than the `least`."""

    effect: str
    share: float
    least: float
    p_value: float


def find_small_effect(diagnosis: Diagnosis) -> list[SmallEffect]:
    """Return a finding on the small effect; the list is empty if effects were selected or a residual is unexplained."""
    small = select_small_effect(diagnosis.candidates)
    if diagnosis.selected or diagnosis.unexplained or small is None:
        return []
    gates = {gate.name: gate for gate in small.decision.gates}
    share = gates["explained_share"]
    return [SmallEffect(small.effect, share.value, share.limit, gates["p_value"].value)]


def select_small_effect(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate with the largest gain that failed only by its explained share; None without any."""
    small = dict[float, Candidate]()
    for candidate in candidates:
        gates = {gate.name: gate for gate in candidate.decision.gates}
        if [*gates][-1:] == ["explained_share"] and not gates["explained_share"].passed and "p_value" in gates:
            small[gates["gain"].value] = candidate
    return small[max(small)] if small else None
