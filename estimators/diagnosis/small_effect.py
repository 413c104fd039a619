"""Effects that predict better, and explain too little."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimators.decisions.gate import Gate
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
    gates = _name_gates(small)
    share = gates["explained_share"]
    return [SmallEffect(small.effect, share.value, share.limit, gates["p_value"].value)]


def select_small_effect(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate with the largest gain that failed only by its explained share; None without any."""
    small = [candidate for candidate in candidates if _is_small(_name_gates(candidate))]
    return max(small, key=lambda candidate: _name_gates(candidate)["gain"].value, default=None)


def _name_gates(candidate: Candidate) -> dict[str, Gate]:
    """Return the gates of a candidate by name, in order."""
    return {gate.name: gate for gate in candidate.decision.gates}


def _is_small(gates: Mapping[str, Gate]) -> bool:
    """Return whether an effect with these gates predicts better, and failed by its explained share."""
    return [*gates][-1:] == ["explained_share"] and not gates["explained_share"].passed and "p_value" in gates
