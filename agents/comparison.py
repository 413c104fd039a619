"""Comparison of excitation policies and baselines by the errors of the online estimator on the same plants."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from agents.baselines import BASELINE, RANDOM
from agents.contenders import make_baselines as make_baselines
from agents.contenders import make_contender
from agents.evaluation import ACCURACIES, LIMITS, REPORT_TIMES, SEED_OFFSET, Outcome, evaluate_policy
from agents.observer import N_PARAMETERS
from estimators.progress import Progress, no_progress
from estimators.schemes.six import SCHEMES
from pendulum_env._typing import JSON, Array
from pendulum_env.errors import UserError
from pendulum_env.formatting import TextTable
from pendulum_env.plant import Effects, list_effects
from pendulum_env.reading import quote_value

SCHEMA = "pendulum-ident/evaluation@2"
RESAMPLES = 2000
MAX_ACTION = 1.05  # a larger action is not a rounding error of 1
PLANTS_PER_JOB = 160  # largest number of plants in one simulation; the result does not depend on the number of workers
Statistic = Callable[[Array, Array], Array]  # of N plants: (..., N) -> (...)


@dataclass(frozen=True)
class PolicyComparison:
    """Outcomes of policies on the same plants; `print` shows their tables.

    `bound` and `error` are RMS values over the plants, and ratios have bootstrap intervals of 95 % over the plants.
    `violations` is the share of ticks beyond an angle, a speed or a torque of the constraint. The second table has the
    ratio for each of the six schemes on the same measurements.

    Attributes:
        outcomes: by name of the policy, baselines first. `outcomes["mine"].parameter_errors` are the relative errors
            of inertia, gravity, viscous and dry friction (T, N, 4) after each tick of 20 ms, on N plants.
        settings: of the comparison.
    """

    outcomes: Mapping[str, Outcome]
    settings: Mapping[str, object]

    @property
    def baseline(self) -> str:
        """Return the name of the first policy, the reference of all others."""
        return next(iter(self.outcomes))

    @property
    def notes(self) -> tuple[str, ...]:
        """List problems of policies that make their figures meaningless, one sentence each."""
        notes = []
        for name, outcome in self.outcomes.items():
            if n_still := int(np.sum(outcome.speed == 0)):
                plants = "" if n_still == len(outcome.speed) else f" on {n_still} of {len(outcome.speed)} plants"
                notes.append(f"{name} never moves the joint{plants}: nothing can be estimated there")
            if (largest := float(outcome.action.max())) > MAX_ACTION:
                notes.append(f"{name} asks for up to {largest:.1f} times the peak torque: actions are shares of it")
        return tuple(notes)

    def json(self) -> JSON:
        """Return quartiles and RMS values of all figures, and ratios with intervals; infinite figures are null."""
        base = self.outcomes[self.baseline]
        policies = {name: _make_policy_json(outcome, base) for name, outcome in self.outcomes.items()}
        results = {"baseline": self.baseline, "policies": policies, "notes": [*self.notes]}
        return {"schema": SCHEMA, **self.settings, **results}

    def __str__(self) -> str:
        return "\n".join((self.tables, *self.notes))

    @property
    def tables(self) -> str:
        """Return the tables of errors by policy and time, and by scheme."""
        header = ["policy", "time [s]", "bound [%]", "error [%]", "error / bound", f"gain over {self.baseline}"]
        base, rows, by_scheme = self.outcomes[self.baseline], [], []
        for name, outcome in self.outcomes.items():
            violations = f"{100 * outcome.violated.any(axis=2).mean():.1f}"
            for k, moment in enumerate(REPORT_TIMES):
                error, bound = outcome.errors[k], outcome.bound[k]
                sizes = [_print_percent(float(compute_rms(values))) for values in (bound, error)]
                ratios = [_print_ratio(bound, error), _print_ratio(error, base.errors[k])]
                rows.append([name if k == 0 else "", f"{moment:g}", *sizes, *ratios, violations if k == 0 else ""])
            of_schemes = [compute_rms_ratio(outcome.bound[-1], errors) for errors in outcome.scheme_errors[-1]]
            by_scheme.append([name, *(f"{ratio:.2f}" for ratio in of_schemes)])
        tables = [str(TextTable([*header, "violations [%]"], rows))]
        if np.isfinite(base.bound).any():
            title = f"error / bound at {REPORT_TIMES[-1]:g} s"
            tables += ["", str(TextTable([title, *(scheme.id for scheme in SCHEMES)], by_scheme))]
        return "\n".join(tables)


def compare_policies(
    policies: Mapping[str, Any] | None = None,
    baselines: Sequence[str] = (BASELINE, RANDOM),
    *,
    constraint: str = "peak",
    plants: int = 40,
    seed: int = 0,
    effects: Effects = (),
    spread: float = 0.3,
    scheme: str = "filtered_dynamic",
    executor: Executor | None = None,
    progress: Progress = no_progress,
) -> PolicyComparison:
    """Compare policies by the errors of the online estimator after 10 s of excitation of the same new plants.

    A policy is one of these:

    - an object with `predict(observation, deterministic=...)`, such as a model of stable-baselines3. It gets the
      observations (B, 20) of `ExcitationDesignVector` and returns shares of the peak torque (B, 1). `state` and
      `episode_start` are passed if `predict` takes them;
    - a class of such objects, created without arguments;
    - an open-loop signal: an excitation of `pendulum_env.excitation`, or a function of time [s] that returns a torque
      [N m]. An excitation drawn for less than 10 s repeats.

    The result depends on the seed, not on the executor.

    Args:
        policies: by name.
        baselines: names among `agents.baselines.BASELINES`. The first is the reference of all gains.
        constraint: of the torque, "peak" (6 N m) or "rms" (3 N m root mean square, 15 N m at most).
        plants: number of plants.
        seed: of plants, noise and signals.
        effects: hidden in the plants, as `stribeck=0.4` or `{"stribeck": 0.4}`.
        spread: relative half width within which the parameters of the plants are drawn.
        scheme: of the estimator.
        executor: pool of processes; policies are pickled. None uses this process.
        progress: called with the name of a policy and the share of the work.

    Raises:
        ValueError: if a policy or a name is unknown, or a number is out of its range.

    Examples:
        >>> from agents import compare_policies
        >>> from pendulum_env.excitation import excitation
        >>> found = compare_policies({"chirp": excitation("chirp", 1, seconds=10)}, ["two-tone"], plants=2)
        >>> list(found.outcomes)
        ['two-tone', 'chirp']
        >>> found.outcomes["chirp"].parameter_errors.shape
        (500, 2, 4)
    """
    policies = policies or {}
    if not isinstance(policies, Mapping):
        raise TypeError(f"{quote_value(policies)} has no names of policies: give a mapping, such as {{'mine': policy}}")
    if shared_names := [name for name in policies if name in baselines]:
        raise UserError(f"a policy and a baseline are both called {shared_names[0]}: rename the policy")
    if plants < 1:
        raise UserError(f"plants is {plants}: give 1 or more")
    contenders = make_baselines(baselines, constraint)
    contenders |= {name: make_contender(name, policy, constraint) for name, policy in policies.items()}
    if not contenders:
        raise UserError("there is nothing to compare: give a policy or a baseline")
    sizes = [min(PLANTS_PER_JOB, plants - first) for first in range(0, plants, PLANTS_PER_JOB)]
    setting: dict[str, Any] = {"effects": list_effects(effects), "spread": spread, "scheme_id": scheme}
    jobs = [
        partial(evaluate_policy, make, constraint, size, seed=seed + 4 * SEED_OFFSET * part, **setting)
        for make in contenders.values()
        for part, size in enumerate(sizes)
    ]
    work: Callable[..., Iterable[Outcome]] = map if executor is None else executor.map
    outcomes_so_far: list[Outcome] = []
    names, count = [*contenders], len(sizes)
    for outcome in work(operator.call, jobs):
        outcomes_so_far.append(outcome)
        progress(names[(len(outcomes_so_far) - 1) // count], len(outcomes_so_far) / len(jobs))
    outcomes = {name: Outcome.join(outcomes_so_far[k * count : (k + 1) * count]) for k, name in enumerate(names)}
    settings: dict[str, object] = {"constraint": constraint, "plants": plants, "seed": seed, "scheme": scheme}
    settings |= {"effects": [*setting["effects"]], "spread": spread}
    return PolicyComparison(outcomes, settings)


def compute_information_ratio(policy: Array, base: Array) -> Array:
    """Compute the median of (det M / det M_base)^(1/4) over the plants; NaN where neither policy moves the joint."""
    with np.errstate(invalid="ignore"):
        return np.median(np.exp((policy - base) / N_PARAMETERS), axis=-1)


def compute_rms(values: Array) -> Array:
    """Compute the root mean square over the plants."""
    return np.sqrt(np.mean(np.square(values), axis=-1))


def compute_rms_ratio(policy: Array, base: Array) -> Array:
    """Divide the RMS of the base over the plants by that of the policy; NaN where one of them is infinite."""
    return _divide_finite(compute_rms(base), compute_rms(policy))


def compute_gain(policy: Array, base: Array) -> Array:
    """Divide the median of the baseline by that of the policy; NaN where one of them is infinite."""
    return _divide_finite(np.median(base, axis=-1), np.median(policy, axis=-1))


def compute_bootstrap_interval(statistic: Statistic, policy: Array, base: Array, seed: int = 0) -> tuple[float, float]:
    """Compute the bootstrap interval of 95 % of a statistic; both policies use the same resampled plants."""
    picks = np.random.default_rng(seed).integers(len(policy), size=(RESAMPLES, len(policy)))
    values = statistic(policy[picks], base[picks])
    with np.errstate(invalid="ignore"):  # of infinite values
        low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _divide_finite(upper: Array, lower: Array) -> Array:
    """Divide where both numbers are finite; NaN elsewhere."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(np.isfinite(upper) & np.isfinite(lower), upper / lower, np.nan)[()]


def _print_percent(value: float) -> str:
    return f"{100 * value:.4f}" if np.isfinite(value) else "-"


def _print_ratio(policy: Array, base: Array) -> str:
    """Print the ratio of RMS values with its interval; "-" where it is unknown."""
    ratio, interval = compute_rms_ratio(policy, base), compute_bootstrap_interval(compute_rms_ratio, policy, base)
    return f"{ratio:.2f} ({interval[0]:.2f} to {interval[1]:.2f})" if np.isfinite(ratio) else "-"


def _make_policy_json(outcome: Outcome, base: Outcome) -> JSON:
    moments, bounds = [f"{moment:g} s" for moment in REPORT_TIMES], [f"{100 * bound:g} %" for bound in ACCURACIES]
    names = [f"error {moment}" for moment in moments] + [f"time to {bound}" for bound in bounds]
    series = zip(names, [*outcome.errors, *outcome.close], [*base.errors, *base.close], strict=True)
    gains = {name: _make_ratio_json(compute_gain, errors, baseline_errors) for name, errors, baseline_errors in series}
    gains["information"] = _make_ratio_json(compute_information_ratio, outcome.log_det[-1], base.log_det[-1])
    rms = [
        {
            "bound": _replace_infinite(compute_rms(bound)),
            "error": _replace_infinite(compute_rms(error)),
            "error_over_bound": _make_ratio_json(compute_rms_ratio, bound, error),
            "gain": _make_ratio_json(compute_rms_ratio, error, baseline_error),
            "bound_gain": _make_ratio_json(compute_rms_ratio, bound, baseline_bound),
            "schemes": {
                scheme.id: _replace_infinite(compute_rms_ratio(bound, errors))
                for scheme, errors in zip(SCHEMES, scheme_errors, strict=True)
            },
        }
        for bound, error, baseline_bound, baseline_error, scheme_errors in zip(
            outcome.bound, outcome.errors, base.bound, base.errors, outcome.scheme_errors, strict=True
        )
    ]
    violations = dict(zip(LIMITS, outcome.violated.mean(axis=(0, 1)).tolist(), strict=True))
    return {
        "rms": dict(zip(moments, rms, strict=True)),
        "violations": {**violations, "any": float(outcome.violated.any(axis=2).mean())},
        "error": dict(zip(moments, map(_compute_quartiles, outcome.errors), strict=True)),
        "cramer_rao": dict(zip(moments, map(_compute_quartiles, outcome.bound), strict=True)),
        "time_to": dict(zip(bounds, map(_compute_quartiles, outcome.close), strict=True)),
        "gain": gains,
        "torque_peak": float(np.abs(outcome.torque).max()),
        "torque_rms": _compute_quartiles(np.sqrt((outcome.torque**2).mean(axis=0))),
        "speed": _compute_quartiles(outcome.speed),
        "turns": _compute_quartiles(np.ptp(outcome.position, axis=0) / (2 * np.pi)),  # between the outermost angles
        "seconds_per_action": outcome.seconds_per_action,
    }


def _make_ratio_json(statistic: Statistic, policy: Array, base: Array) -> JSON:
    values = float(statistic(policy, base)), *compute_bootstrap_interval(statistic, policy, base)
    return dict(zip(("ratio", "low", "high"), map(_replace_infinite, values), strict=True))


def _compute_quartiles(values: Array) -> list[float | None]:
    """Return lower quartile, median and upper quartile."""
    return [_replace_infinite(value) for value in np.quantile(values, [0.25, 0.5, 0.75], method="closest_observation")]


def _replace_infinite(value: float | Array) -> float | None:
    return float(value) if np.isfinite(value) else None
