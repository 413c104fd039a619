"""What workers do for a session: search for what is missing, and add it."""

from __future__ import annotations

from functools import partial

from estimators.diagnosis.added import Addition
from estimators.diagnosis.addition import add
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import diagnose
from pendulum_env.physics import effect
from workbench.app.jobs import Job, Workers
from workbench.app.session import Session
from workbench.mistakes import InputError
from workbench.report.words import name


def start_diagnosis(session: Session, workers: Workers) -> None:
    """Search for the effects that the ladder's last model lacks."""
    state = session.state
    if not state.ladder:
        raise InputError(state.trouble or "load a recording first")

    def done(job: Job, found: Diagnosis) -> None:
        def keep() -> None:
            session.state = session.state.diagnosed(found, state.ladder)

        session.finish(job, keep)

    task = partial(diagnose, state.train, state.holdout, state.model.terms, **state.asked.effects, **state.asked.limits)
    session.start(Job("Diagnosing", task, workers, done, session.fail))


def start_addition(session: Session, workers: Workers, id: str) -> None:
    """Add an effect to the ladder's last model."""
    state = session.state
    if not state.ladder:
        raise InputError(state.trouble or "load a recording first")
    try:
        effect(id)
    except ValueError as error:
        raise InputError(str(error)) from None
    if id in state.model.effects:
        raise InputError(f"{name(id)} is in the model already")

    def done(job: Job, addition: Addition) -> None:
        def keep() -> None:
            session.state = session.state.grown(addition)

        session.finish(job, keep)

    task = partial(add, state.model, id, state.train, state.holdout, **state.asked.limits)
    session.start(Job(f"Adding {name(id)}", task, workers, done, session.fail))
