"""Conversion of policies of every accepted form into policies of `ExcitationDesignVector`."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from agents.baselines import BASELINES, SignalPolicy, make_baseline
from agents.network import Network
from agents.observer import CONSTRAINTS, EPISODE, TICK, Batch
from pendulum_env._typing import Array
from pendulum_env.errors import UserError, format_error
from pendulum_env.lookup import find
from pendulum_env.policy import Policy, State
from pendulum_env.reading import quote_value

Contender = Callable[[int], Policy]  # makes a policy from a seed
ARGUMENTS = ("state", "episode_start", "deterministic")  # optional arguments of `predict`


class CheckedPolicy:
    """Policy with checked actions; `predict` of the wrapped policy may take fewer arguments and return only actions."""

    def __init__(self, name: str, policy: Any) -> None:
        """Wrap a policy that messages call by a name."""
        parameters = inspect.signature(policy.predict).parameters
        takes_all = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
        self.name, self._policy = name, policy
        self._arguments = [argument for argument in ARGUMENTS if takes_all or argument in parameters]

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Return shares of the peak torque (B, 1) for observations (B, N).

        Raises UserError if the policy fails, or does not return one finite number for each pendulum.
        """
        arguments = dict(zip(ARGUMENTS, (state, episode_start, deterministic), strict=True))
        try:
            answer = self._policy.predict(observation, **{name: arguments[name] for name in self._arguments})
            action, state = answer if isinstance(answer, tuple) else (answer, None)
            shares = np.asarray(action, dtype=np.float32)
        except UserError:
            raise
        except Exception as error:
            raise UserError(f"policy {self.name} fails: {format_error(error)}") from error
        batch = len(observation)
        if shares.shape not in ((batch,), (batch, 1)) or not np.isfinite(shares).all():
            remedy = f"return finite numbers of shape ({batch}, 1)"
            inputs = f"observations of shape {np.shape(observation)}"
            raise UserError(f"policy {self.name} returns {quote_value(action)} for {inputs}: {remedy}")
        return shares.reshape(batch, 1), state


def make_contender(name: str, policy: Any, constraint: str) -> Contender:
    """Return a function that makes the policy from a seed; it is picklable if the policy is.

    A policy is an object with `predict`, a class of such objects, an excitation, or a function of time [s] that returns
    a torque [N m]. Raises ValueError if the form of the policy is unknown, or the policy does not fit the task.
    """
    make = partial(_make_policy, name, policy, constraint)
    make(0)
    return make


def make_baselines(names: Any, constraint: str) -> dict[str, Contender]:
    """Return functions that make the named `BASELINES`; raises ValueError if a name is unknown."""
    for name in names:
        find("baseline", name, BASELINES)
    find("constraint", constraint, CONSTRAINTS)
    return {name: partial(make_baseline, name, constraint) for name in names}


def load_class(text: str) -> type:
    """Import a class given as `module:Class`, perhaps from the current folder; raises UserError if that fails."""
    module, _, name = text.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        kind = getattr(import_module(module), name, None)
    except Exception as error:  # an import runs the user's code
        raise UserError(f"{text}: the import of {module} fails: {format_error(error)}") from error
    if not isinstance(kind, type):
        raise UserError(f"{text}: module {module} has no class {name}")
    return kind


def _make_policy(name: str, policy: Any, constraint: str, seed: int) -> Policy:
    if isinstance(policy, type):
        try:
            policy = policy()
        except Exception as error:
            raise UserError(f"policy {name} cannot be made without arguments: {format_error(error)}") from error
    if isinstance(policy, Network) and policy.constraint != constraint:
        raise UserError(f"policy {name} was trained under the constraint {policy.constraint}, not {constraint}")
    if hasattr(policy, "predict"):
        return CheckedPolicy(name, policy)
    signal = getattr(policy, "signal", policy)
    if not callable(signal):
        expected = "an object with predict, a class, an excitation or a function of time"
        raise UserError(f"policy {name} is {quote_value(policy)}: give {expected}")
    return SignalPolicy(partial(np.array, _sample_signal(name, signal, constraint)))


def _sample_signal(name: str, signal: Callable[[float], Any], constraint: str) -> Array:
    """Sample the torque of a signal at the start of each tick (T,) [share of the peak]."""
    peak = find("constraint", constraint, CONSTRAINTS).peak
    try:
        torque = np.array([float(signal(tick * TICK)) for tick in range(round(EPISODE / TICK))])
    except Exception as error:
        raise UserError(f"signal {name} fails: {format_error(error)}") from error
    if not (np.abs(torque) <= peak * (1 + 1e-9)).all():  # NaN fails the comparison
        raise UserError(f"signal {name} reaches {np.abs(torque).max():g} N m: keep it within the peak of {peak:g} N m")
    return torque / peak
