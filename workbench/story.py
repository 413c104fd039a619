"""A diagnosis told on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.diagnosis import Diagnosis, Step, Verdict
from pendulum_env.physics import Model, effect
from workbench.terminal import Terminal
from workbench.words import bar, enumerate_words, plus_minus

RUNNERS_UP = 5  # rejected candidates that are shown
ERROR_HEADERS = (
    "model",
    "torque, fitted [N m]",
    "torque, held out [N m]",
    "ratio",
    "position, fitted [rad]",
    "position, held out [rad]",
    "ratio",
    "",
)


def tell(diagnosis: Diagnosis, terminal: Terminal) -> None:
    """Print what was found: errors falling, parameters, what cannot be told apart, what is left, what to do next."""
    base = diagnosis.steps[0].model
    terminal.heading("What is missing")
    if diagnosis.selected:
        for id in diagnosis.selected:
            terminal.say(f"- {id}: {effect(id).law}")
    elif diagnosis.unexplained:
        terminal.say("something, but no effect of the library explains it: see what is left unexplained")
    else:
        terminal.say(f"nothing: {enumerate_words([term.id for term in base.terms])} explain these recordings")
    if diagnosis.disagreements:
        terminal.heading("Recordings that disagree")
        for disagreement in diagnosis.disagreements:
            terminal.say(f"- {disagreement.text}")
        terminal.say("what disagrees is not fitted: diagnose it on its own, or find out what was changed")
    terminal.heading("Errors")
    tell_errors(diagnosis.steps, terminal)
    terminal.say(f"measurement noise alone would leave {diagnosis.noise_floor:.3g} N m")
    terminal.heading("Parameters")
    tell_parameters(diagnosis.model, terminal)
    terminal.heading("Candidates")
    tell_candidates(diagnosis, terminal)
    if diagnosis.unexplained:
        terminal.heading("Left unexplained")
        for region in diagnosis.unexplained:
            terminal.say(f"- {region.text}")
    if diagnosis.advice:
        terminal.heading("What to do next")
        for line in diagnosis.advice:
            terminal.say(f"- {line}")


def tell_errors(steps: Sequence[Step], terminal: Terminal) -> None:
    """Print a table of errors step by step, with a bar that shrinks; ratios are held-out errors over the base's."""
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
    terminal.table(ERROR_HEADERS, rows, left=("",))


def tell_parameters(model: Model, terminal: Terminal) -> None:
    """Print a table of parameters with standard errors."""
    rows = [(name, plus_minus(e.value, e.std), e.unit) for name, e in model.estimates.items()]
    terminal.table(("parameter", "estimate", "unit"), rows, left=("unit",))


def tell_candidates(diagnosis: Diagnosis, terminal: Terminal) -> None:
    """Print the verdict on the candidates that matter: all but the less likely ones that were rejected."""
    settled = [c for c in diagnosis.candidates if c.verdict in (Verdict.SELECTED, Verdict.AMBIGUOUS)]
    rest = [c for c in diagnosis.candidates if c not in settled]
    shown = [*settled, *rest[:RUNNERS_UP]]
    terminal.table(
        ("effect", "verdict", "score", "reason"),
        [(c.effect, str(c.verdict).replace("_", " "), f"{c.score:.2f}", c.reason) for c in shown],
        left=("verdict", "reason"),
    )
    if len(rest) > RUNNERS_UP:
        terminal.say(f"and {len(rest) - RUNNERS_UP} more that are no better")
