"""Errors of the offline estimates against the Cramer-Rao bound, and the coverage of their 95 % intervals.

python -m benchmarks.cramer_rao

Noise model of the bound: position has white noise of the variance of the encoder's quantisation (count^2 / 12), and
the recorded torque is the acting torque plus white noise. Both are Gaussian and independent. The initial state is
unknown, and the plant has no disturbance. Because the acting torque is known only with noise, the sufficient statistics
are the innovations of an extended Kalman filter. Their sensitivities give the Fisher information; the one-sample steps
are differences of the independent simulation, stick included.

Source: Ljung, System Identification, 2nd edition, sections 7.4 and 10.3.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from benchmarks.parallel import each
from benchmarks.scoring import positive, take_workers
from benchmarks.truth import Truth
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.variants import refine_variants
from estimators.selection.refits import SEGMENT
from estimators.simulation import output_error
from estimators.simulation.free_running import choose_segments
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE, Model, effect
from pendulum_env.recording import Recording
from workbench.terminal import Terminal

Array = NDArray[np.float64]

AIM = 1.2  # largest accepted error over the bound
INTERVAL = 1.96  # standard errors, 95 % of a normal distribution


@dataclass(frozen=True)
class Study:
    """Plant, experiment and estimated parameters of a bound.

    Attributes:
        estimated: name of each parameter in the model and, for an effect, in the plant.
    """

    name: str
    plant: Plant
    experiment: Experiment
    estimated: tuple[tuple[str, str, str], ...] = ()  # name in the model, effect, name in the plant

    @property
    def names(self) -> tuple[str, ...]:
        return (*(term.id for term in BASE), *(name for name, _, _ in self.estimated))

    @property
    def position_noise(self) -> float:
        """Return the standard deviation of the quantisation of the encoder [rad]."""
        return 2 * np.pi / (self.experiment.counts or np.inf) / np.sqrt(12)

    def changed(self, name: str, amount: float) -> tuple[Plant, float]:
        """Return the plant with one parameter larger by the share `amount`, and the absolute change."""
        for known, id, own in self.estimated:
            if known == name:
                value = self.plant.effects[id][own]
                changed = {id: self.plant.effects[id] | {own: value * (1 + amount)}}
                return replace(self.plant, effects=self.plant.effects | changed), value * amount
        value = getattr(self.plant, name)
        return replace(self.plant, **{name: value * (1 + amount)}), value * amount


PAPER = Experiment(rate=500.0, seconds=10.0, excitation="two_tone", seed=1)
COARSE = replace(PAPER, counts=8192)
DRAG = Plant(effects={"quadratic_drag": {"drag": 0.04}})
STRIBECK = Plant(effects={"stribeck": {"strib_d": 0.45, "strib_v": 0.6}})
STUDIES = (
    Study("paper's run", Plant(), PAPER),
    Study("coarse encoder (8192 counts)", Plant(), COARSE),
    Study("steps at 200 Hz", Plant(), replace(PAPER, rate=200.0, excitation="steps")),
    Study("quadratic drag", DRAG, PAPER, (("quadratic_drag", "quadratic_drag", "drag"),)),
    Study(
        "Stribeck",
        STRIBECK,
        PAPER,
        (("stribeck", "stribeck", "strib_d"), ("stribeck.stribeck_velocity", "stribeck", "strib_v")),
    ),
)

# --------------------------------------------------------------------------------------------------------------- bound


@dataclass(frozen=True)
class Steps:
    """One-sample steps of the state (q, v) along a run of N samples, to first order.

    Attributes:
        state: effect of the state on the next one (N, 2, 2).
        torque: effect of the torque (N, 2).
        theta: effect of P parameters (N, 2, P).
    """

    state: Array
    torque: Array
    theta: Array


def linearise(study: Study, run: SimulatedRecording) -> Steps:
    """Compute the steps as differences of the independent simulation, restarted at every sample."""
    q, v, u = run.exact_position, run.velocity, run.command
    perturbations = (1e-6, 1e-5, 1e-4)  # [rad], [rad/s], [N m]
    plain = _steps(study.plant, run, q, v, u)
    parts = [
        (_steps(study.plant, run, q + perturbations[0], v, u) - plain) / perturbations[0],
        (_steps(study.plant, run, q, v + perturbations[1], u) - plain) / perturbations[1],
        (_steps(study.plant, run, q, v, u + perturbations[2]) - plain) / perturbations[2],
    ]
    for name in study.names:
        plant, amount = study.changed(name, 1e-4)
        parts.append((_steps(plant, run, q, v, u) - plain) / amount)
    slopes = np.stack(parts, axis=-1)
    return Steps(slopes[..., :2], slopes[..., 2], slopes[..., 3:])


def _steps(plant: Plant, run: SimulatedRecording, q: Array, v: Array, u: Array) -> Array:
    """Return the states (q, v) one sample after each of N states, (N, 2)."""
    hertz = run.experiment.rate
    starts = zip(q.tolist(), v.tolist(), strict=True)
    step = Experiment(rate=hertz, seconds=2 / hertz, counts=None, torque_noise=0.0)
    ends = simulate([(plant, replace(step, start=start)) for start in starts], commands=[np.full(2, t) for t in u])
    return np.array([(end.exact_position[1], end.velocity[1]) for end in ends])


def bound(steps: Steps, position_noise: float, torque_noise: float) -> Array:
    """Return the Cramer-Rao bound of the standard errors of P parameters (P,), with an unknown initial state."""
    count = steps.theta.shape[2]
    moved = np.zeros((2, count + 2))  # sensitivity of the predicted state to parameters and initial state
    moved[:, count:] = np.eye(2)
    spread, information = np.zeros((2, 2)), np.zeros((count + 2, count + 2))  # covariance of the prediction
    for A, B, G in zip(steps.state, steps.torque, steps.theta, strict=True):
        S = spread[0, 0] + position_noise**2
        information += np.outer(moved[0], moved[0]) / S
        gain = spread[:, 0] / S
        moved = A @ (moved - np.outer(gain, moved[0]))
        moved[:, :count] += G
        spread = A @ (spread - np.outer(gain, spread[0])) @ A.T + torque_noise**2 * np.outer(B, B)
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.sqrt(np.diag(covariance)[:count])


# ----------------------------------------------------------------------------------------------------------- estimates


def draw_recording(study: Study, run: SimulatedRecording, seed: int) -> Recording:
    """Return a recording of the run with random measurement noise."""
    rng = np.random.default_rng(seed)
    position = run.exact_position + study.position_noise * rng.standard_normal(len(run.time))
    torque = run.command + run.experiment.torque_noise * rng.standard_normal(len(run.time))
    return Recording(run.time, position, torque, name=study.name)


def fit_windows(prepared: RegressionData, hidden: Sequence[str]) -> Model:
    """Fit the base terms and some effects over windows; nonlinear parameters are searched."""
    terms = BASE
    for id in hidden:
        terms = min(refine_variants(prepared, terms, effect(id)), key=lambda trial: trial.fitted_rms).terms
    return fit_terms(prepared, terms)[0]


def fit_segments(prepared: RegressionData, start: Model) -> Model:
    """Refine a fit by maximum likelihood of the innovations in short segments."""
    segments = [choose_segments(windows, SEGMENT) for windows in prepared.data.windows]
    return output_error.fit_maximum_likelihood(segments, Point(start.terms, start.theta))


def estimate(seed: int, study: Study, run: SimulatedRecording) -> tuple[Model, Model]:
    """Return the estimates over windows and over segments of one realisation."""
    prepared = RegressionData.from_recordings([draw_recording(study, run, seed)])
    windows = fit_windows(prepared, tuple(study.plant.effects))
    return windows, fit_segments(prepared, windows)


def print_bound(study: Study, realisations: int, workers: int, terminal: Terminal) -> None:
    """Print the bound, errors and coverage of one study."""
    (run,) = simulate([(study.plant, study.experiment)])
    least = bound(linearise(study, run), study.position_noise, study.experiment.torque_noise)
    truth = Truth.of(study.name, run.truth).parameters
    work: Callable[[int], tuple[Model, Model]] = partial(estimate, study=study, run=run)
    found = each(work, range(realisations), workers=workers, title=study.name, terminal=terminal)
    rows = []
    for name, smallest in zip(study.names, least.tolist(), strict=True):
        cells = []
        for models in zip(*found, strict=True):
            error = np.array([model.estimates[name].value - truth[name] for model in models])
            std = np.array([model.estimates[name].std for model in models])
            ratio = float(np.sqrt(np.mean(error**2))) / smallest
            cells += [f"{ratio:.2f}", f"{np.mean(np.abs(error) < INTERVAL * std):.0%}"]
        rows.append((name, f"{truth[name]:.4g}", f"{smallest:.2g}", *cells))
    terminal.print_heading(f"{study.name}: {len(found)} realisations of {study.experiment.seconds:g} s")
    heads = ("bound", "windows / bound", "within 95 %", "segments / bound", "within 95 %")
    terminal.print_table(("parameter", "truth", *heads), rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cramer_rao", description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=positive, default=100, help="realisations of each study (default %(default)s)")
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    for study in STUDIES:
        print_bound(study, arguments.n, arguments.workers, terminal)
    terminal.print(f"aim: within {AIM:g} of the bound")
    return 0


if __name__ == "__main__":
    sys.exit(main())
