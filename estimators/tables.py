"""Results as tables of words; the command line prints them, notebooks show them."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.compare import Comparison
from estimators.diagnosis import Diagnosis, Step, Verdict
from estimators.identify import Identification
from pendulum_env.physics import Estimate, Model
from pendulum_env.words import Table, bar, plus_minus

RUNNERS_UP = 5  # rejected candidates that are shown


def errors_table(steps: Sequence[Step]) -> Table:
    """Errors step by step, with a bar that shrinks; ratios are held-out errors over the base's."""
    base = steps[0].errors["holdout"]
    rows = []
    for step in steps:
        train, holdout = step.errors["train"], step.errors["holdout"]
        torque = holdout.torque_rms / max(base.torque_rms, 1e-300)
        position = holdout.position_rms / max(base.position_rms, 1e-300)
        rows.append(
            (
                "as it was" if step.added is None else f"+ {step.added}",
                f"{train.torque_rms:.4g}",
                f"{holdout.torque_rms:.4g}",
                f"{torque:.3g}",
                f"{train.position_rms:.4g}",
                f"{holdout.position_rms:.4g}",
                f"{position:.3g}",
                bar(torque),
            )
        )
    headers = (
        "model",
        "torque, fitted [N m]",
        "torque, held out [N m]",
        "ratio",
        "position, fitted [rad]",
        "position, held out [rad]",
        "ratio",
        "",
    )
    return Table(headers, rows, left=("",))


def candidates_table(diagnosis: Diagnosis) -> tuple[Table, int]:
    """The candidates that matter, which are all but the less likely of those left out, and how many are not shown."""
    settled = [c for c in diagnosis.candidates if c.verdict in (Verdict.SELECTED, Verdict.AMBIGUOUS)]
    rest = [c for c in diagnosis.candidates if c not in settled]
    rows = [
        (c.effect, str(c.verdict).replace("_", " "), f"{c.score:.2f}", c.reason) for c in (*settled, *rest[:RUNNERS_UP])
    ]
    return Table(("effect", "verdict", "score", "reason"), rows, left=("verdict", "reason")), len(rest[RUNNERS_UP:])


def schemes_table(found: Identification, model: Model | None = None) -> Table:
    """Estimates of every scheme, one a row; the model that is saved, if there is one, is the last."""
    columns = next(iter(found.schemes.values())).model.columns
    names = [column.name for column in columns]
    rows = []
    for id, result in found.schemes.items():
        values = [_shown(result.model.estimates[name], name in result.withheld) for name in names]
        rows.append((id, *values, f"{result.residual_rms:.3g} {result.unit}"))
    if model is not None:
        withheld = {name for doubt in found.doubts for name in doubt.withheld}
        rows.append(("windows (saved)", *(_shown(model.estimates[name], name in withheld) for name in names), ""))
    return Table(("scheme", *(f"{column.name} [{column.unit}]" for column in columns), "residual"), rows)


def noise_text(floor: float) -> str:
    """What noise alone would leave [N m], and how that is known, in a sentence."""
    return f"measurement noise alone, judged by the scatter from sample to sample, would leave {floor:.3g} N m"


def kin(scheme: str, otherwise: int = 0) -> tuple[int, bool]:
    """How a scheme is drawn: its family, of three that share a colour each, and whether it is the filtered sister.

    A scheme of another name is drawn as of the family `otherwise`, modulo three.
    """
    families = (("dynamic",), ("energy", "power"), ("hamiltonian",))
    other = otherwise % len(families)
    family = next((k for k, words in enumerate(families) if any(word in scheme for word in words)), other)
    return family, "filtered" in scheme


def distances_table(found: Comparison) -> Table:
    """Errors of a model on every recording, and on all together if there are several."""
    distances = [*found.distances, found.joint] if len(found.distances) > 1 else found.distances
    return Table(
        ("recording", "torque [N m]", "noise floor [N m]", "free-running position [rad]"),
        [
            (
                item.name,
                f"{item.errors.torque_rms:.4g}",
                f"{item.noise_floor:.4g}",
                f"{item.errors.position_rms:.4g}",
            )
            for item in distances
        ],
    )


def _shown(estimate: Estimate, withheld: bool) -> str:
    return "unknown" if withheld else plus_minus(estimate.value, estimate.std)
