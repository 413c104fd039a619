"""A diagnosis told on the terminal."""

from __future__ import annotations

from estimators.diagnosis.result import Diagnosis
from estimators.show.tables import candidates_table, errors_table, fit_text, noise_text
from pendulum_env.physics import effect
from pendulum_env.words import BIASED, parameters_table
from workbench.terminal import Terminal
from workbench.words import enumerate_words


def tell(diagnosis: Diagnosis, terminal: Terminal, every: bool = False) -> None:
    """Print what was found: errors falling, parameters, candidates (or every one), what is left, what to do next."""
    base = diagnosis.steps[0].model
    terminal.heading("What is missing")
    if diagnosis.selected:
        for id in diagnosis.selected:
            terminal.say(f"- {id}: {effect(id).law}")
        if diagnosis.unexplained:
            terminal.say("- and more, which no effect of the library explains: see what is left unexplained")
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
    terminal.table(*errors_table(diagnosis.steps))
    terminal.say(fit_text(diagnosis.steps))
    terminal.say(noise_text(diagnosis.noise_floor, diagnosis.is_in_loop))
    terminal.heading("Parameters")
    terminal.table(*parameters_table(diagnosis.model))
    if diagnosis.unexplained:
        terminal.say(BIASED)
    terminal.heading("Candidates")
    ranking, more = candidates_table(diagnosis.candidates, every)
    terminal.table(*ranking)
    if more:
        terminal.say(f"and {more}: --all shows them")
    if diagnosis.unexplained:
        terminal.heading("Left unexplained")
        for region in diagnosis.unexplained:
            terminal.say(f"- {region.text}")
    if diagnosis.advice:
        terminal.heading("What to do next")
        for line in diagnosis.advice:
            terminal.say(f"- {line}")
