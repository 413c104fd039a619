"""Results as tables of words; the command line prints them, notebooks show them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from estimators.checks.residual import SYMBOLS, Profile
from estimators.comparison import Comparison
from estimators.diagnosis.result import Candidate, Detectable, Verdict
from estimators.schemes.identification import Identification
from estimators.selection.data import Step
from pendulum_env.physics import Model
from pendulum_env.words import Table, bar, listing

RUNNERS_UP = 5  # rejected candidates that are shown
SCORE = (
    "score: probability that an effect is what the data call for at its place; nats: logarithm of how many times "
    "likelier it makes data that it was not fitted to"
)
_DISTANCES = ("recording", "torque [N m]", "fit [%]", "noise floor [N m]", "free-running position [rad]", "fit [%]")
_IN_LOOP = ("in the loop, mean [rad]", "RMS [rad]")


def errors_table(steps: Sequence[Step]) -> Table:
    """Errors step by step, with a bar that shrinks; ratios are held-out errors over the base's."""
    base = steps[0].errors["holdout"]
    if base.is_in_loop:
        return _loop_table(steps)
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


def _loop_table(steps: Sequence[Step]) -> Table:
    """The same of errors in the loop."""
    base, rows = steps[0].errors["holdout"].in_loop, []
    for step in steps:
        train, holdout = (step.errors[part].in_loop for part in ("train", "holdout"))
        label = "as it was" if step.added is None else f"+ {step.added}"
        rows.append((label, f"{train:.4g}", f"{holdout:.4g}", f"{holdout / base:.3g}", bar(holdout / base)))
    return Table(("model", "in the loop, fitted [rad]", "in the loop, held out [rad]", "ratio", ""), rows, left=("",))


def fit_text(steps: Sequence[Step]) -> str:
    """How much of held-out torque and motion the first and the last model explain, in a sentence."""
    if steps[0].errors["holdout"].is_in_loop:
        return "mean distance of whole recordings from simulations that know nothing but the goal"
    first, last = (step.errors["holdout"] for step in (steps[0], steps[-1]))
    course = " -> " if len(steps) > 1 else ""
    torque, position = (
        f"{old:.4g} %{course}{f'{new:.4g} %' if course else ''}"
        for old, new in ((first.torque_fit, last.torque_fit), (first.position_fit, last.position_fit))
    )
    return f"fit of what was held out: torque {torque}, position {position}"


def candidates_table(candidates: Sequence[Candidate], every: bool = False) -> tuple[Table, str]:
    """The candidates that matter, or all, and in words which ones are not shown; empty if none.

    Those that matter are all but the less likely of those left out.
    """
    settled = [c for c in candidates if c.verdict in (Verdict.SELECTED, Verdict.AMBIGUOUS)]
    rest = [c for c in candidates if c not in settled]
    shown, hidden = (rest, []) if every else (rest[:RUNNERS_UP], rest[RUNNERS_UP:])
    rows = [(c.effect, str(c.verdict).replace("_", " "), f"{c.score:.2f}", c.reason) for c in (*settled, *shown)]
    blind = [c.effect for c in hidden if c.verdict is Verdict.NOT_EXCITED]
    worse = len(hidden) - len(blind)
    parts = [f"{worse} more that are no better"] if worse else []
    parts += [f"{len(blind)} that could not be judged ({listing(blind)})"] if blind else []
    return Table(("effect", "verdict", "score", "reason"), rows, left=("verdict", "reason")), " and ".join(parts)


def detectable_table(found: Sequence[Detectable]) -> Table:
    """From which size on effects would have shown."""
    return Table(("effect", "would have shown"), [(one.effect, one.text) for one in found], left=("would have shown",))


def schemes_table(found: Identification, model: Model | None = None, label: str = "windows") -> Table:
    """Estimates of every scheme, one a row; a model that was fitted besides is the last, under its label."""
    columns = next(iter(found.schemes.values())).model.columns
    names = [column.name for column in columns]
    rows = []
    for id, result in found.schemes.items():
        values = [result.model.estimates[name].text for name in names]
        rows.append((id, *values, f"{result.residual_rms:.3g} {result.unit}"))
    if model is not None:
        withheld = {name for doubt in found.doubts for name in doubt.withheld}
        rows.append((label, *(model.withholding(withheld).estimates[name].text for name in names), ""))
    return Table(("scheme", *(f"{column.name} [{column.unit}]" for column in columns), "residual"), rows)


def noise_text(floor: float, in_loop: bool = False) -> str:
    """What noise alone would leave [N m], or [rad] in the loop, and how that is known, in a sentence."""
    if in_loop:
        return f"the encoder alone would leave {floor:.2g} rad"
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
        (*_DISTANCES, *(_IN_LOOP if found.joint.errors.is_in_loop else ())),
        [
            (
                item.name,
                f"{item.errors.torque_rms:.4g}",
                f"{item.errors.torque_fit:.4g}",
                f"{item.noise_floor:.4g}",
                f"{item.errors.position_rms:.4g}",
                f"{item.errors.position_fit:.4g}",
                *(f"{error:.4g}" for error in (item.errors.in_loop, item.errors.in_loop_rms) if np.isfinite(error)),
            )
            for item in distances
        ],
    )


def profile_table(profile: Profile) -> Table:
    """Mean residual over one quantity, with bars to either side of zero."""
    largest = float(np.abs(profile.mean).max()) or 1.0
    rows = [
        (f"{low:.3g} to {high:.3g}", f"{mean:.3g}", _to_either_side(mean / largest))
        for (low, high), mean in zip(pairwise(profile.edges), profile.mean.tolist(), strict=True)
    ]
    return Table((f"{SYMBOLS[profile.axis]} [{profile.unit}]", "mean residual [N m]", ""), rows, left=("",))


def _to_either_side(share: float, width: int = 12) -> str:
    """Bar from the middle to the left or to the right."""
    left, right = ("", bar(share, width)) if share > 0 else (bar(-share, width), "")
    return f"{left:>{width}}│{right:<{width}}"
