"""The paper's experiment again, on a simulated pendulum whose parameters are known.

The plant is the dynamic row of the paper's Table 2, driven by its two random-phase sines and seen through its encoder.
Each run is identified in several ways: as this project does it, with one of its cares left out at a time, and by the
paper's equations as printed. What each care is worth is then a measured number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import gymnasium as gym
import numpy as np

from estimators.paper.as_printed import PRINTED, as_logged
from estimators.paper.ways import WAYS, Anatomy, dissect, rms
from estimators.schemes.identification import Identification, identify
from estimators.schemes.six import SCHEMES
from estimators.signals.measurements import measure
from pendulum_env._typing import JSON, Array
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, simulate
from pendulum_env.plant import paper_plant
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM

SCHEMA = "pendulum-ident/paper@1"
RUNS, SECONDS = 20, 30.0
RATE = 1000.0  # [Hz]
NINETY_FIVE = 1.96  # standard errors on either side that hold 95 % of a normal distribution
TABLE_2: dict[str, tuple[float | None, ...]] = {  # [I, mgl, b, fc]; the Hamiltonian pair is given its inertia
    "dynamic": (0.0895, 2.0100, 0.3638, 0.9163),
    "filtered_dynamic": (0.0903, 2.0171, 0.3874, 0.9229),
    "energy": (0.0937, 1.9496, 0.3291, 1.1109),
    "filtered_power": (0.0911, 1.9335, 0.3299, 1.1201),
    "hamiltonian": (None, 2.0100, 0.3638, 0.9163),
    "filtered_hamiltonian": (None, 2.0171, 0.3874, 0.9229),
}

Rollout = Callable[[np.random.Generator, float, str], Recording]


def simulated(rng: np.random.Generator, seconds: float, name: str) -> Recording:
    """One run of the paper's pendulum in the environment, with new phases and new noise each time."""
    env = gym.make(PENDULUM, rate=RATE, torque_noise=TORQUE_NOISE, max_episode_steps=-1)
    policy = OpenLoop(excitation("paper", rng, seconds), RATE)
    return rollout(env, policy, round(seconds * RATE), seed=int(rng.integers(2**31)), name=name)


class Score(NamedTuple):
    """Estimates of one scheme over all runs, [I, mgl, b, fc] each: median, and median and worst error as a share."""

    theta: Array
    median: Array
    worst: Array

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        parts = zip(("theta", "median_error", "worst_error"), self, strict=True)
        return {name: dict(zip(PARAMETERS, part.tolist(), strict=True)) for name, part in parts}


class Norms(NamedTuple):
    """The paper's norm (10) of measured minus calculated torque [N m], by scheme, and for the true parameters."""

    models: Mapping[str, float]
    truth: float


PARAMETERS = tuple(column.name for term in BASE for column in term.columns)


@dataclass(frozen=True, eq=False)
class Experiment:
    """R runs, identified in every way, and one more run under a fresh excitation on which the models are tried.

    Attributes:
        seed, seconds: of the runs.
        found: for each run (R,), what each way finds, by its id.
        example: the first run; its models are the ones that are tried.
        fresh: the run that nothing was fitted to.
    """

    seed: int
    seconds: float
    found: tuple[Mapping[str, Identification], ...]
    example: Recording
    fresh: Recording

    @property
    def runs(self) -> int:
        """Number of runs R."""
        return len(self.found)

    @property
    def truth(self) -> Array:
        """True parameters (4,)."""
        return paper_plant().theta

    def theta(self, way: str, scheme: str) -> Array:
        """Estimates (R, 4)."""
        return np.array([found[way][scheme].model.theta for found in self.found])

    def score(self, way: str, scheme: str) -> Score:
        """How good a scheme is in one way of doing it."""
        theta = self.theta(way, scheme)
        error = np.abs(theta / self.truth - 1)
        return Score(np.median(theta, axis=0), np.median(error, axis=0), error.max(axis=0))

    def worst_median(self, way: str) -> float:
        """Largest median error of all schemes and parameters, as a share."""
        return max(float(self.score(way, scheme).median.max()) for scheme in TABLE_2)

    def coverage(self, scheme: str) -> float:
        """Share of our 95 % intervals, over runs and parameters, that hold the truth."""
        std = np.array([found["ours"][scheme].convergence.std[-1] for found in self.found])
        return float(np.mean(np.abs(self.theta("ours", scheme) - self.truth) <= NINETY_FIVE * std))

    def disagreement(self, scheme: str) -> float:
        """Largest difference, as a share, of a Hamiltonian scheme from the one whose inertia it is given."""
        lender = scheme.replace("hamiltonian", "dynamic")
        pairs = zip(self.theta("paper", scheme), self.theta("paper", lender), strict=True)
        return max(float(np.abs(given / lent - 1).max()) for given, lent in pairs)

    @cached_property
    def simulated_position(self) -> Array:
        """Open-loop motion under the fresh run's torque, (N, 1 + S): with the true parameters, then our S models."""
        models = [self.found[0]["ours"][scheme].model.theta for scheme in TABLE_2]
        theta = np.column_stack([self.truth, *models])  # (4, 1 + S)
        return simulate(BASE, theta, 1.0 / self.fresh.rate, self.fresh.torque, 0.0, 0.0).position[:-1]

    @property
    def following(self) -> Mapping[str, float]:
        """RMS of simulated minus measured position [rad] over the fresh run, in open loop from rest, by scheme."""
        errors = self.simulated_position[:, 1:].T - self.fresh.position
        return {scheme: rms(error) for scheme, error in zip(TABLE_2, errors, strict=True)}

    def torque(self, way: str, scheme: str | None = None) -> tuple[Array, Array, Array]:
        """Time, measured and calculated torque of the fresh run (N,), printed or ours; without a scheme, of the truth.

        Ours is NaN in stick, where the torque cannot be calculated from the motion.
        """
        theta = self.truth if scheme is None else self.found[0][way][scheme].model.theta
        dynamic, measured = (PRINTED[0], as_logged) if way == "printed" else (SCHEMES[0], measure)
        m = measured(self.fresh)
        equations, usable = dynamic.regression(m, BASE)
        return m.time, np.where(usable, equations.y, np.nan), np.where(usable, equations.phi @ theta, np.nan)

    def norms(self, way: str) -> Norms:
        """L2 norms of the torque error on the fresh run."""

        def norm(scheme: str | None) -> float:
            _, measured, calculated = self.torque(way, scheme)
            return rms(measured - calculated)

        return Norms({scheme: norm(scheme) for scheme in TABLE_2}, norm(None))

    @cached_property
    def anatomy(self) -> Anatomy:
        """Why the cares matter, measured on the first run."""
        return dissect(self.example, self.truth)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "runs": self.runs,
            "seconds": self.seconds,
            "seed": self.seed,
            "truth": dict(zip(PARAMETERS, self.truth.tolist(), strict=True)),
            "paper": {scheme: dict(zip(PARAMETERS, row, strict=True)) for scheme, row in TABLE_2.items()},
            "ways": {
                way.id: {
                    "text": way.text,
                    "schemes": {
                        scheme: {**self.score(way.id, scheme).json(), "runs": self.theta(way.id, scheme).tolist()}
                        for scheme in TABLE_2
                    },
                }
                for way in WAYS
            },
            "coverage": {scheme: self.coverage(scheme) for scheme in TABLE_2},
            "disagreement": {scheme: self.disagreement(scheme) for scheme in TABLE_2 if "hamiltonian" in scheme},
            "anatomy": self.anatomy._asdict(),
            "position_rms": dict(self.following),
            "torque_norm": {way: {**(norms := self.norms(way)).models, "truth": norms.truth} for way in SHOWN},
        }


SHOWN = ("printed", "ours")  # ways whose torque is looked at


def paper_experiment(
    runs: int = RUNS,
    seconds: float = SECONDS,
    seed: int = 0,
    *,
    rollout: Rollout = simulated,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Experiment:
    """Repeat the paper's experiment with random phases.

    Args:
        runs: number of runs, one or more.
        seconds: length of each.
        seed: of phases and noise.
        rollout: what makes a run from a generator, a length and a name.
        progress: called with what is being done and the share that is done.

    Raises:
        ValueError: if there is no run.
        IdentificationError: if the runs are too short to identify anything.
    """
    if runs < 1:
        raise ValueError(f"an experiment needs at least one run, got {runs}")
    rng = np.random.default_rng(seed)
    recordings, found = [], []
    for k in range(runs):
        progress(f"run {k + 1} of {runs}", k / (runs + 1))
        recordings.append(rollout(rng, seconds, f"run {k + 1}"))
        found.append({way.id: identify([recordings[-1]], BASE, way.schemes, measured=way.segments) for way in WAYS})
    progress("a fresh run", runs / (runs + 1))
    return Experiment(seed, seconds, tuple(found), recordings[0], rollout(rng, seconds, "fresh run"))
