"""The next experiment: the torque signal that would settle what a diagnosis leaves open.

Open are effects that fit equally well, and effects that the recorded motion hardly shows. The fitted model is simulated
under a family of candidate signals, and the simulated recordings are put through the same windowed equations as real
ones. What the rival model cannot explain of them, its parameters fitted anew, is what the experiment would show: the
signal that makes it largest against the noise is suggested (T-optimality), of those that show plenty the gentlest.

Source: Atkinson and Fedorov, Biometrika 62(1), 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.checks.identifiability import Doubt
from estimators.diagnosis.result import Candidate, Verdict
from estimators.diagnosis.suggestion import RATE, Aim, Suggestion
from estimators.regression.equations import Equations
from estimators.selection.models import Models
from estimators.selection.moves import best
from estimators.weak_form.dataset import Dataset, dataset
from estimators.weak_form.windows import cut
from pendulum_env._typing import Array
from pendulum_env.excitation import Excitation, family
from pendulum_env.physics import Model, Term, simulate
from pendulum_env.plant import typical
from pendulum_env.recording import Recording
from pendulum_env.words import listing

SECONDS = 20.0  # of the experiment
USUAL = 6.0  # [N m], the paper's peak torque: what a motor is trusted with unless it is known to give more
SHOWN = 0.7  # times the noise floor: a difference as large as this is found
PLENTY = 20.0  # times the noise floor: enough to show a twentieth part of it, too
ALIKE = 0.05  # of the worth, a logarithm: signals as close as this are as good, and the smallest swing is chosen
NEAREST = 3  # effects that come closest to what none explains, which are looked for
FEWEST = 40  # windows clear of stick that an experiment has to give
GENTLER = (1.0, 0.3, 0.1)  # of the torque: what small angles and low speeds call for
FASTER = 30.0  # times the highest speed that was recorded: of a motion beyond, a model knows nothing
SAFE = 0.9  # share of a bounded angle or speed that is used: the model that foretells the motion is in doubt


@dataclass(frozen=True)
class Limits:
    """What the rig bears: torque [N m], angle to either side of hanging down [rad], and speed [rad/s]."""

    torque: float
    angle: float = np.inf
    speed: float = np.inf

    @property
    def moves_freely(self) -> bool:
        """Whether neither angle nor speed is bounded."""
        return bool(np.isinf(self.angle) and np.isinf(self.speed))

    @property
    def text(self) -> str:
        """`0.5 N m and 2 rad/s`."""
        bounds = ((self.torque, "N m"), (self.angle, "rad"), (self.speed, "rad/s"))
        return listing([f"{bound:.3g} {unit}" for bound, unit in bounds if np.isfinite(bound)])

    def bear(self, position: Array, velocity: Array) -> bool:
        """Whether a motion stays well within them."""
        angle, speed = np.abs(position).max(), np.abs(velocity).max()
        return bool(angle <= SAFE * self.angle and speed <= SAFE * self.speed)


@dataclass(frozen=True)
class Question:
    """Something that an experiment may settle, and how to see whether it would.

    Attributes:
        aim: what it is.
        terms: of the rival model: with the effect in place of the other, or without it.
        torque: effect of typical size whose torque is to be seen, with its linear parameters; None to see the model's.
    """

    aim: Aim
    terms: tuple[Term, ...]
    torque: tuple[Term, Array] | None = None

    def unexplained(self, data: Dataset, equations: Equations) -> float:
        """RMS torque of a simulated experiment that the rival model, with its equations, cannot explain [N m]."""
        y = equations.y
        if self.torque is not None:
            term, theta = self.torque
            linear, fixed = data.columns([term])[0]
            y = linear @ theta + fixed
        scale = np.maximum(np.linalg.norm(equations.phi, axis=0), 1e-300)
        theta = np.linalg.lstsq(equations.phi / scale, y, rcond=1e-10)[0] / scale
        return float(np.sqrt(np.mean((y - equations.phi @ theta) ** 2)))


def questions(
    models: Models,
    terms: Sequence[Term],
    groups: Sequence[tuple[str, ...]],
    candidates: Sequence[Candidate],
    doubts: Sequence[Doubt],
    is_open: bool,
) -> list[Question]:
    """What a diagnosis leaves open."""
    pairs = [(id, selected) for selected, *alike in groups for id in alike]
    pairs += [doubt.rivals for doubt in doubts if doubt.rivals is not None]
    present = {term.id for term in terms}
    asked = []
    for id, instead in pairs:
        others = [term for term in terms if term.id != instead]
        if id in models.library.keys() - present and len(others) < len(terms):
            trial = best(models, tuple(others), models.library[id])
            if trial is not None:
                asked.append(Question(Aim(id, instead), trial.terms))
    for candidate in candidates:
        kind = models.library[candidate.effect]
        out_of_reach = kind().beyond(*models.train.reach)  # a motion that is not risked for a mere suspicion
        asked_already = candidate.effect in {question.aim.effect for question in asked}
        if candidate.verdict is Verdict.NOT_EXCITED and not out_of_reach and not asked_already:
            asked.append(Question(Aim(candidate.effect), tuple(terms), of_typical_size(kind)))
    if not asked and is_open:  # something is there that no effect explains: what comes closest is worth another look
        nearest = sorted(candidates, key=lambda candidate: -candidate.score)
        rejected = [one.effect for one in nearest if one.verdict is Verdict.REJECTED][:NEAREST]
        asked = [Question(Aim(id), tuple(terms), of_typical_size(models.library[id])) for id in rejected]
    return asked


def of_typical_size(kind: type[Term]) -> tuple[Term, Array]:
    """An effect as a rig might have it, and its linear parameters (P,)."""
    values = typical(kind)
    shapes = {shape.name: values.pop(shape.name) for shape in kind.shapes}
    return kind(**shapes), np.array(list(values.values()))


def suggest(
    models: Models, model: Model, asked: Sequence[Question], limits: Limits, usual: float
) -> tuple[Suggestion | None, list[Aim], str | None]:
    """The experiment that settles most.

    Args:
        models: what the diagnosis worked with.
        model: that foretells the motion.
        asked: what is open.
        limits: of the rig.
        usual: torque that is trusted without limits [N m].

    Returns:
        It, if there is one; what no torque up to the usual settles, whatever the limits; and what only the limits keep
        from being settled, in one sentence.
    """
    suggestion, unsettled = _choose(models, model, asked, limits)
    free = Limits(max(limits.torque, usual))
    if not unsettled or limits == free:
        return suggestion, unsettled, None
    hopeless = _choose(models, model, [question for question in asked if question.aim in unsettled], free)[1]
    forbidden = [aim.text for aim in unsettled if aim not in hopeless]
    if not forbidden:
        return suggestion, hopeless, None
    more = "more torque" if limits.moves_freely else "more"
    text = f"no experiment within {limits.text} would {listing(forbidden, 'or')}: allow {more} if the rig bears it"
    return suggestion, hopeless, text


def _choose(
    models: Models, model: Model, asked: Sequence[Question], limits: Limits
) -> tuple[Suggestion | None, list[Aim]]:
    """The experiment within limits that settles most, and what none of them settles."""
    runs = rehearse(models, model, limits) if asked else []
    if not runs:  # within limits there is none; without, the model ran away under all, and nobody knows
        return None, [] if limits.moves_freely else [question.aim for question in asked]
    shown = np.zeros((len(runs), len(asked)))  # against the noise floor
    for j, run in enumerate(runs):
        if len(run.data.weights) >= FEWEST:
            rivals = {terms: run.data.equations(terms) for terms in {question.terms for question in asked}}
            told = [question.unexplained(run.data, rivals[question.terms]) for question in asked]
            shown[j] = np.array(told) / models.left.floor
    answerable = shown.max(axis=0) > SHOWN
    # one question well settled and one open is worse than both settled
    worth = np.log1p(np.minimum(shown[:, answerable], PLENTY)).sum(axis=1)
    best = min(np.flatnonzero(worth >= worth.max() - ALIKE), key=lambda j: runs[j].swing)
    settled = tuple(question.aim for question, ratio in zip(asked, shown[best], strict=True) if ratio > SHOWN)
    hopeless = [question.aim for question, hope in zip(asked, answerable, strict=True) if not hope]
    return (runs[best].suggestion(settled) if settled else None), hopeless


@dataclass(frozen=True)
class Run:
    """A candidate signal with the motion that the fitted model makes of it, as windowed equations."""

    signal: Excitation
    data: Dataset
    peak_speed: float  # [rad/s]

    @property
    def swing(self) -> float:
        """Between the lowest and the highest angle [rad]."""
        return float(np.ptp(self.data.windows[0].recording.position))

    def suggestion(self, settled: tuple[Aim, ...]) -> Suggestion:
        """The experiment, with what to expect of it."""
        (windows,) = self.data.windows
        position, torque = windows.recording.position, windows.recording.torque
        reach = float(position.min()), float(position.max())
        return Suggestion(self.signal, SECONDS, settled, float(np.abs(torque).max()), reach, self.peak_speed)


def rehearse(models: Models, model: Model, limits: Limits) -> list[Run]:
    """Simulate candidate signals, sampled and windowed much as the recordings are; gives those within the limits.

    Motions that are far faster than any recorded are left out: a light joint with hardly any friction runs away.
    """
    windows = models.train.data.windows[0]
    recorded = windows.recording.rate
    rate, half_width = min(RATE, recorded), (len(windows.kernel) // 2) / recorded
    time = np.arange(round(SECONDS * rate)) / rate
    fastest = FASTER * max(float(np.abs(w.samples.velocity).max()) for w in models.train.data.windows)
    shares = GENTLER[:1] if limits.moves_freely else GENTLER
    signals = [signal for s in shares for signal in family(np.random.default_rng(0), SECONDS, s * limits.torque)]
    torques = np.column_stack([signal.signal(time) for signal in signals])
    path = simulate(model.terms, model.theta, 1 / rate, torques, 0.0, 0.0)
    motions = zip(signals, torques.T, path.position[:-1].T, path.velocity.T, strict=True)
    return [
        Run(
            signal,
            dataset([cut(Recording("experiment", time, position, torque), half_width)]),
            float(np.abs(velocity).max()),
        )
        for signal, torque, position, velocity in motions
        if limits.bear(position, velocity) and np.abs(velocity).max() <= fastest
    ]
