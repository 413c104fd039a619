"""Train the policy `peak` anew, by imitating the planner: python -m benchmarks.imitation OUT.npz.

In each of five rounds pendulums are driven, by the planner in the first and by the policy itself in the others, so that
it learns what to do where it comes to. The planner says what either torque would lead to, and the policy learns to lose
little by its choice, not only to choose alike. Takes two minutes of a core.
Source: Ross, Gordon and Bagnell, A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning, AISTATS 2011.
"""

from __future__ import annotations

import sys
from itertools import pairwise

import numpy as np
import torch

from agents.baselines import LookAhead, baseline
from agents.design_env import ExcitationDesignVector
from agents.network import Network
from agents.observer import INPUTS, mirrored
from pendulum_env._typing import Array

ROUNDS, TICKS = 5, 400
PENDULUMS = 128
ASKED, EARLY = 40, 60  # about how many of them the planner is asked in a tick; twice as many in so many first ticks
FIRST = 64  # and in the first round
SPREAD = 0.4  # within which plants are drawn
FLIPPED = 0.05  # share of the planner's torques that are turned round, to see more
BATCH, EPOCHS, LAST = 1000, 12, 40  # LAST: epochs of the last round
RATE = 2e-3  # of learning, falls linearly
HEAD_START = 50  # ticks added to t in the weight of what is lost
ALIKE = 0.3  # weight of choosing alike


def gains(planner: LookAhead, observation: Array) -> Array:
    """What the best sequences that begin backwards and forwards are worth (B, 2) [nat], seen forwards."""
    worth, forwards = planner.foreseen(observation)[1], planner.sequences[0] > 0
    return np.stack([worth[:, ~forwards].max(axis=1), worth[:, forwards].max(axis=1)], axis=1)


def train(rounds: int = ROUNDS, ticks: int = TICKS, seed: int = 0) -> Network:
    """A policy that plays full torque one way or the other, as the planner would."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rng, planner = np.random.default_rng(seed), baseline("look-ahead", "peak")
    assert isinstance(planner, LookAhead)
    sizes = (INPUTS, 64, 64, 2)
    layers = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
    net = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])

    def exported() -> Network:
        weights, biases = ([part.detach().numpy().copy() for part in net.parameters()][k::2] for k in range(2))
        return Network(weights, biases, np.array([-1.0, 1.0]), "peak")

    seen, worth = [], []
    for k in range(rounds):
        env = ExcitationDesignVector(PENDULUMS, spread=SPREAD)
        observation, _ = env.reset(seed=100 + k)
        for tick in range(ticks):
            asked = rng.permutation(PENDULUMS)[: 2 * ASKED if tick < EARLY else ASKED]
            if k == 0:
                asked = np.arange(FIRST)
            turned, sign = mirrored(observation[asked])
            gain = gains(planner, turned)
            seen.append(turned)
            worth.append(gain * (HEAD_START + tick))
            action = exported().predict(observation)[0]
            if k == 0:
                action[:] = 0.0
                action[asked, 0] = sign * np.where(gain[:, 1] >= gain[:, 0], 1.0, -1.0)
                action[rng.random(PENDULUMS) < FLIPPED] *= -1.0
            observation = env.step(action)[0]
        fit(net, np.concatenate(seen), np.concatenate(worth), LAST if k == rounds - 1 else EPOCHS)
    return exported()


def fit(net: torch.nn.Module, observation: Array, gain: Array, epochs: int) -> None:
    """Lower what is lost by the network's choices, and how often they differ where that matters."""
    x, g = (torch.tensor(values, dtype=torch.float32) for values in (observation, gain))
    optimizer, batches = torch.optim.Adam(net.parameters(), lr=RATE), len(x) // BATCH
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.02, epochs * batches)
    for _ in range(epochs):
        order = torch.randperm(len(x))
        for batch in order[: batches * BATCH].split(BATCH):
            shares = torch.log_softmax(net(x[batch]), dim=1)
            lost = g[batch].max(dim=1, keepdim=True).values - g[batch]
            usual = lost.sum(dim=1).mean()
            weight = (lost.sum(dim=1) / usual).clamp(max=5.0)
            unlike = torch.nn.functional.nll_loss(shares, g[batch].argmax(dim=1), reduction="none")
            loss = (shares.exp() * lost).sum(dim=1).mean() / usual + ALIKE * (weight * unlike).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()


if __name__ == "__main__":
    train().save(sys.argv[1])
