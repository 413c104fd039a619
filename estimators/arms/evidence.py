"""Recordings of an arm as equations over short blocks of time, for which effects at joints compete.

Each row is the impulse balance of one joint, averaged over a block of samples that are all clear of that joint's stick
and reversals. The rigid body and friction are fitted along with whatever is tried: nothing is frozen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from estimators.arms.balance import VIEWS, rows
from estimators.arms.measurements import ArmMeasurements, measure_arm
from estimators.regression.equations import IdentificationError
from estimators.regression.least_squares import Balance
from estimators.schemes.six import GUARD, impulse_view, over_samples
from estimators.selection.candidates import NUDGE
from estimators.selection.score import STRETCH, Stretches
from estimators.signals.measurements import Measurements, remember
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import JointTerm
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Samples, Term

BLOCK = 0.01  # [s], shorter than what friction does near a reversal; the filter reaches over some, see `_neighbours`
FEWEST = 40  # blocks of each joint


class Columns(NamedTuple):
    """Averages of a term's columns over the blocks of its joint (R_i,), and their slopes by the torque."""

    linear: Array  # (R_i, P)
    fixed: Array  # (R_i,)
    linear_slope: Array
    fixed_slope: Array


@dataclass(frozen=True, eq=False)
class _Part:
    """One segment: its measurements, and samples of each block of each joint, (K_i, B) each."""

    m: ArmMeasurements
    blocks: tuple[Index, ...]
    recording: int
    began: float  # seconds of recording before it


@dataclass(frozen=True, eq=False)
class ArmEvidence:
    """Blocks of one or several recordings; rows stand joint by joint. Build it with `gather_arm`."""

    body: Body
    parts: tuple[_Part, ...]

    @cached_property
    def joint(self) -> Index:
        """Joint of each row (R,)."""
        counts = [sum(len(part.blocks[k]) for part in self.parts) for k in range(len(self.body.joints))]
        return np.repeat(np.arange(len(counts)), counts)

    def of(self, joint: int) -> Mask:
        """Rows of a joint (R,)."""
        return np.asarray(self.joint == joint)

    @cached_property
    def links(self) -> Array:
        """Rigid body's columns (R, P)."""
        bodies = [
            np.stack([e.phi for e in rows(part.m, self.body, (), VIEWS["impulse"])], axis=1) for part in self.parts
        ]
        return np.concatenate(
            [
                _means(phi[:, k], part.blocks[k])
                for k in range(len(self.body.joints))
                for part, phi in zip(self.parts, bodies, strict=True)
            ]
        )

    @cached_property
    def torque(self) -> Array:
        """Measured torque (R,) [N m]."""
        return self._each(lambda m: m.held)

    def _each(self, series: Callable[[Measurements], Array]) -> Array:
        return np.concatenate(
            [
                _means(series(part.m.joints[k]), part.blocks[k])
                for k in range(len(self.body.joints))
                for part in self.parts
            ]
        )

    @cached_property
    def stretches(self) -> Stretches:
        """Stretches of time, which the joints share; errors are scaled joint by joint."""
        stretch, recording = [], []
        for k in range(len(self.body.joints)):
            for part in self.parts:
                middle = part.blocks[k][:, 0] * part.m.period + part.began
                stretch.append((middle / STRETCH).astype(np.intp))
                recording.append(np.full(len(middle), part.recording))
        places, own = np.unique(np.concatenate(stretch), return_inverse=True)
        of_stretch = np.zeros(len(places), dtype=np.intp)
        of_stretch[own] = np.concatenate(recording)
        scales = np.concatenate(recording) * len(self.body.joints) + self.joint
        return Stretches(own, scales, of_stretch, own)

    def samples(self, joint: int) -> Samples:
        """Motion of a joint in the middle of its blocks (R_i,)."""
        middles = [part.blocks[joint][:, part.blocks[joint].shape[1] // 2] for part in self.parts]
        xs = [part.m.joints[joint].samples for part in self.parts]

        def of(name: str) -> Array:
            return np.concatenate([getattr(x, name)[at] for x, at in zip(xs, middles, strict=True)])

        return Samples(of("time"), of("position"), of("velocity"), of("torque"))

    def columns(self, own: JointTerm) -> Columns:
        """Averages of a term's columns over the blocks of its joint."""
        plain = self._columns(own, 0.0)
        if not (own.term.fixed or any(column.of_torque for column in own.term.columns)):
            return Columns(*plain, np.zeros_like(plain[0]), np.zeros_like(plain[1]))
        nudge = NUDGE * max(float(np.abs(self.torque[self.of(own.joint)]).max()), 1e-12)
        more = self._columns(own, nudge)
        return Columns(*plain, (more[0] - plain[0]) / nudge, (more[1] - plain[1]) / nudge)

    def _columns(self, own: JointTerm, more: float) -> tuple[Array, Array]:
        linear, fixed = [], []
        for part in self.parts:
            m, blocks = _pushed(part.m.joints[own.joint], more, own.term), part.blocks[own.joint]
            views = [_means(impulse_view(m, column), blocks) for column in own.term.columns]
            linear.append(np.column_stack(views) if views else np.empty((len(blocks), 0)))
            fixed.append(sum((_means(impulse_view(m, c), blocks) for c in own.term.fixed), np.zeros(len(blocks))))
        return np.concatenate(linear), np.concatenate(fixed)

    def muffled(self, own: JointTerm) -> float:
        """Variance of white torque noise that the term's fixed columns take out of its joint's blocks [(N m)^2]."""
        rng, raws, lefts = np.random.default_rng(0), [], []
        for part in self.parts:
            m, blocks = part.m.joints[own.joint], part.blocks[own.joint]
            one, other = (remember(each, [own.term]) for each in (m, m.noisier(rng)))
            raw = _means(other.held - one.held, blocks)
            taken = [impulse_view(other, column) - impulse_view(one, column) for column in own.term.fixed]
            raws.append(raw)
            lefts.append(raw - sum((_means(series, blocks) for series in taken), np.zeros(len(blocks))))
        return float(np.var(np.concatenate(raws)) - np.var(np.concatenate(lefts)))

    def balance(self, terms: Sequence[JointTerm], weights: Array) -> Balance:
        """Equations of body and terms, each joint's scaled by its weight (n,)."""
        owned = [(own, self.columns(own)) for own in terms]
        count = self.links.shape[1] + sum(part.linear.shape[1] for _, part in owned)
        phi, slopes = np.zeros((len(self.joint), count)), np.zeros((len(self.joint), count))
        y, passed = self.torque.copy(), np.ones(len(self.joint))
        first = self.links.shape[1]
        phi[:, :first] = self.links
        least, most = np.full(count, -np.inf), np.full(count, np.inf)
        for own, part in owned:
            here, last = self.of(own.joint), first + part.linear.shape[1]
            phi[here, first:last], slopes[here, first:last] = part.linear, part.linear_slope
            least[first:last] = [column.least for column in own.term.columns]
            most[first:last] = [column.most for column in own.term.columns]
            y[here] -= part.fixed
            passed[here] -= part.fixed_slope
            first = last
        w = weights[self.joint]
        return Balance(phi * w[:, None], y * w, slopes, passed, least, most, np.ones(len(w)))

    def residual(self, terms: Sequence[JointTerm], theta: Array) -> Array:
        """Torque (R,) that body and terms of linear parameters theta (P,) leave [N m]."""
        return np.asarray(self.balance(terms, np.ones(len(self.body.joints))).error(theta))

    def structure(self, residual: Array, joint: int) -> tuple[float, float]:
        """Torque that neighbouring blocks of a joint share of a residual (R,) [N m], and how sure that is."""
        product, power = self._neighbours(residual, joint)
        if len(product) == 0:
            return 0.0, 0.0
        sure = float(product.sum() / max(power.sum(), 1e-300) * np.sqrt(len(product)))
        return float(np.sqrt(max(product.mean(), 0.0))), sure

    def noise(self, residual: Array, joint: int) -> float:
        """Torque of a block that its neighbours do not share of a residual (R,) [N m]."""
        product, power = self._neighbours(residual, joint)
        if len(product) == 0:
            return float(np.std(residual[self.of(joint)]))
        return float(np.sqrt(max(power.mean() - max(product.mean(), 0.0), 0.0)))

    def _neighbours(self, residual: Array, joint: int) -> tuple[Array, Array]:
        """Products of a residual (R,) at blocks of a joint that are as near as noise allows, and their mean squares.

        White noise of sensors is white no more behind the filter: next but one, blocks share up to two thirds of it,
        with the other sign. The ends of its window weigh little, so that at its reach hardly any is shared.
        """
        own, first, products, powers = residual[self.of(joint)], 0, [], []
        for part in self.parts:
            blocks = part.blocks[joint]
            here = own[first : first + len(blocks)]
            first += len(blocks)
            length = blocks.shape[1]
            apart = 1 + -(-part.m.joints[joint].reach // length)
            near = np.flatnonzero(blocks[apart:, 0] - blocks[:-apart, 0] == apart * length)
            products.append(here[near] * here[near + apart])
            powers.append(0.5 * (here[near] ** 2 + here[near + apart] ** 2))
        return np.concatenate(products), np.concatenate(powers)


def gather_arm(recordings: Sequence[ArmRecording], body: Body) -> ArmEvidence:
    """Blocks of recordings of an arm.

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    parts, began = [], 0.0
    for number, recording in enumerate(recordings):
        for m in measure_arm(recording):
            length = max(2, round(BLOCK / m.period))
            starts = np.arange(0, len(m) - length + 1, length)
            every = starts[:, None] + np.arange(length)
            blocks = tuple(every[over_samples(joint.clear(GUARD))[every].all(axis=1)] for joint in m.joints)
            parts.append(_Part(m, blocks, number, began))
            began = np.ceil((began + len(m) * m.period) / STRETCH) * STRETCH
    for k, joint in enumerate(body.joints):
        if sum(len(part.blocks[k]) for part in parts) < FEWEST:
            names = ", ".join(recording.name for recording in recordings)
            raise IdentificationError(
                f"{names}: joint '{joint}' is hardly ever clear of stick and reversals: record longer, faster or wider "
                "motion"
            )
    return ArmEvidence(body, tuple(parts))


def _means(series: Array, blocks: Index) -> Array:
    return np.asarray(series[blocks].mean(axis=1))


def _pushed(m: Measurements, more: float, term: Term) -> Measurements:
    """Measurements of a joint under a torque that is larger all along [N m], with the term's state if it has any."""
    return remember(replace(m, torque=m.torque + more, held=m.held + more) if more else m, [term])
