"""What an excitation tells of the structure: how much better the true effect predicts than its nearest rival.

Rows of the base model, phi, are kept together with those of every effect that may be hidden, psi. If effect i is the
true one, with parameters a, the best that a model with effect j in its place can do leaves a torque unexplained whose
squares sum to a' S a, S being what is left of the information of psi_i once phi and psi_j are accounted for (its Schur
complement). With Gaussian errors of standard deviation s, the log score of the true structure then grows over that of
the rival by

    a' S a / (2 s^2)    [nat],

the prequential score of the one definition (`estimators.selection.score`) in expectation. The nearest rival is the one
with the least. Source: Hunter and Reiner, Technometrics 7(3), 1965; Atkinson and Fedorov, Biometrika 62(1), 1975
(T-optimality).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.knowledge import COUNT
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import LoadDependentFriction, PositionDependentFriction, QuadraticDrag, Stribeck
from pendulum_env.physics.potential import Cogging, GravityTilt
from pendulum_env.plant import typical

DISCRIMINATE = "discriminate"  # the criterion's name
# effects that a policy learns to tell apart, and sees the evidence of; none contains another, as a spring an offset
PROBES: tuple[Term, ...] = (
    TorqueOffset(),
    Stribeck(0.5),
    QuadraticDrag(),
    LoadDependentFriction(),
    PositionDependentFriction(),
    Cogging(12.0),
    GravityTilt(),
)
ONE_WAY = (Stribeck, QuadraticDrag, LoadDependentFriction)  # friction never drives
NOISE = 0.007  # [N m], of the torque on a tick that no model explains: what is measured under the usual sensors
FAINT = 1e-4  # information of the prior: (noise / size)^2 with sizes that nobody would doubt
ENOUGH = 300.0  # nat, beyond which a verdict stands anyway
SMALLEST, LARGEST = 0.03, 0.3  # of the typical size, between which hidden effects are drawn: larger ones show anyhow
LESSON = 6.0  # [s] of an episode of training
USUAL = 0.1  # of the typical size, that who plans reckons with
LOGS = 10.0  # by which logarithms are divided, for them to be about 1 in the end
STRUCTURE_FEATURES = 2 * len(PROBES)


class Structure:
    """What is known of the structure of B plants.

    Attributes:
        terms: effects that are kept account of, `PROBES` first.
        information: of base parameters, in nominal units, and of effects, in typical ones (B, P, P).
        moment: sum of rows times torque (B, P).
    """

    def __init__(self, more: Sequence[Term] = ()) -> None:
        """Take effects that may be hidden beside `PROBES`."""
        self.terms = (*PROBES, *(term for term in more if term not in PROBES))
        columns = [(k, column) for k, term in enumerate(self.terms) for column in term.columns]
        self._columns = [column for _, column in columns]
        self.owner = np.array([k for k, _ in columns])  # term of each column
        sizes = [typical(type(term)) for term in self.terms]
        self.usual = np.array([abs(sizes[k][c.name.removeprefix(f"{self.terms[k].id}.")]) for k, c in columns])
        self._places = [COUNT + np.flatnonzero(self.owner == k) for k in range(len(self.terms))]

    def start(self, batch: int) -> None:
        """Nothing is known of B plants."""
        size = COUNT + len(self._columns)
        self.information = np.tile(FAINT * np.eye(size), (batch, 1, 1))
        self.moment = np.zeros((batch, size))
        self._last = np.zeros((batch, size)), np.zeros(batch)  # row and torque of the tick before
        self._ways = np.zeros((2, batch))  # which way the joint went in the two ticks before; 0 where it was slow
        self.moment[:, :COUNT] = FAINT

    def rows(self, x: Samples) -> Array:
        """Torque of effects of typical size in the mean over a tick (..., C), of samples (held, ...)."""
        sign = np.sign(x.velocity)
        told = [np.broadcast_to(c.force(x) + c.dry(x) * sign, x.velocity.shape).mean(axis=0) for c in self._columns]
        return np.stack(told, axis=-1) * self.usual

    def take(self, base: Array, x: Samples, torque: Array, usable: Mask) -> None:
        """Take in a tick: rows of the base model (B, 4), samples (held, B), mean torque (B,), and where usable (B,).

        A tick counts once the next one is known: within a tick of a reversal, the estimators take nothing in either.
        """
        way = np.sign(x.velocity[-1]) * usable
        clear = (way != 0) & (self._ways[1] == way) & (self._ways[0] == way)
        rows, before = self._last[0] * clear[:, None], self._last[1]
        self.information = self.information + rows[:, :, None] * rows[:, None, :]
        self.moment = self.moment + rows * before[:, None]
        self._last = np.concatenate([base, self.rows(x)], axis=1), torque
        self._ways = np.stack([self._ways[1], way])

    def gained(self, hidden: Index, size: Array) -> Array:
        """Expected gain of the true effect over its nearest rival (B,) [nat].

        Args:
            hidden: place of the true effect among `terms` (B,).
            size: its parameters, as shares of typical ones, and 0 for all others (B, C).
        """
        return gained(self.information, self._places, hidden, size)

    def features(self) -> Array:
        """How much of each probe could have been seen, and how much of it was (B, STRUCTURE_FEATURES)."""
        known, about = self.information[:, :COUNT, :COUNT], self.information[:, :COUNT, COUNT:]
        both = np.linalg.solve(known, np.concatenate([about, self.moment[:, :COUNT, None]], axis=2))
        turned = np.swapaxes(about, 1, 2)
        left = self.information[:, COUNT:, COUNT:] - turned @ both[..., :-1]
        told = self.moment[:, COUNT:] - (turned @ both[..., -1:])[..., 0]
        seen, found = np.empty((2, len(PROBES), len(left)))
        for k in range(len(PROBES)):
            own = self._places[k] - COUNT
            part = left[:, own[:, None], own]
            seen[k] = np.trace(part, axis1=1, axis2=2)
            found[k] = np.einsum("bi,bi->b", told[:, own], np.linalg.solve(part, told[:, own, None])[..., 0])
        both = np.maximum(np.concatenate([seen, found]), 0.0) / (2 * NOISE**2)
        return np.asarray(np.log1p(both).T / LOGS)


def gained(information: Array, places: Sequence[Index], hidden: Index, size: Array) -> Array:
    """`Structure.gained` of informations (B, P, P)."""
    least = np.full(len(information), np.inf)
    effect = np.concatenate([np.zeros((len(size), COUNT)), size], axis=1)[..., None]  # (B, P, 1)
    torque = information @ effect
    whole = np.swapaxes(effect, 1, 2) @ torque
    for k, place in enumerate(places):
        rival = np.concatenate([np.arange(COUNT), place])
        about = torque[:, rival]
        # a' S a = a' M a - (M a)_R' M_RR^-1 (M a)_R
        left = whole - np.swapaxes(about, 1, 2) @ np.linalg.solve(information[:, rival[:, None], rival], about)
        least = np.where(hidden == k, least, np.minimum(least, left[:, 0, 0]))
    return np.asarray(np.maximum(least, 0.0) / (2 * NOISE**2))


def drawn(rng: np.random.Generator, terms: Sequence[Term], count: int) -> tuple[Index, Array]:
    """One effect for each of B plants: its place among the terms (B,), and its parameters as shares of typical (B, C).

    Sizes are uniform on a logarithmic scale; what may act either way does so as often, but friction never drives.
    """
    owner = np.repeat(np.arange(len(terms)), [len(term.columns) for term in terms])
    one_way = np.array([isinstance(term, ONE_WAY) for term in terms])[owner]
    hidden = rng.integers(len(terms), size=count)
    size = np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST), (count, 1)))
    sign = rng.choice([-1.0, 1.0], (count, len(owner)))
    return hidden, np.where(owner == hidden[:, None], size * np.where(one_way, 1.0, sign), 0.0)


def worth(gain: Array) -> Array:
    """What a gain is worth: log(1 + D) of as much as there is any use for."""
    return np.log1p(np.minimum(gain, ENOUGH))


def promised(information: Array) -> Array:
    """Mean over effects of the worth of D, of informations (..., P, P), if each were hidden at `USUAL` size [nat].

    Nobody who plans knows which it is. Of a column, what is left beside all others bounds D from below:
    1 / (M^-1)_cc.
    """
    left = 1.0 / np.einsum("...cc->...c", np.linalg.inv(information))[..., COUNT:]
    return np.asarray(worth(USUAL**2 * np.maximum(left - FAINT, 0.0) / (2 * NOISE**2)).mean(axis=-1))
