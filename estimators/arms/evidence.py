"""Recordings of an arm as equations over short blocks of time, for which effects at joints compete.

Each row is the impulse balance of one joint, averaged over a block of samples that are all clear of that joint's stick
and reversals. The rigid body and friction are fitted along with whatever is tried: nothing is frozen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.arms.balance import VIEWS, rows
from estimators.arms.measurements import ArmMeasurements, measure_arm
from estimators.regression.equations import IdentificationError
from estimators.regression.least_squares import Balance
from estimators.schemes.six import GUARD, impulse_view, over_samples
from estimators.selection.candidates import Columns, columns_by_torque, depends_on_torque, nudge_of, pushes_of
from estimators.selection.score import STRETCH, Stretches
from estimators.signals.measurements import Measurements, remember
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import JointTerm
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Samples, Term

BLOCK = 0.01  # [s], shorter than what friction does near a reversal; the filter reaches over some, see `_neighbours`
FEWEST = 40  # blocks of each joint


Over = Callable[[Array, Index, float], Array]


def _means(series: Array, blocks: Index, period: float) -> Array:
    """Averages of a series (N, ...) over blocks of samples."""
    return np.asarray(series[blocks].mean(axis=1))


def _rates(series: Array, blocks: Index, period: float) -> Array:
    """Averages of its time derivative [1/s]."""
    return np.asarray((series[blocks[:, -1]] - series[blocks[:, 0]]) / (period * (blocks.shape[1] - 1)))


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
        return self._links(_means)

    def _links(self, over: Over) -> Array:
        bodies = [
            np.stack([e.phi for e in rows(part.m, self.body, (), VIEWS["impulse"])], axis=1) for part in self.parts
        ]
        return np.concatenate(
            [
                over(phi[:, k], part.blocks[k], part.m.period)
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
                _means(series(part.m.joints[k]), part.blocks[k], part.m.period)
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
        """Averages of a term's columns over the blocks of its joint, with how they depend on the torque."""
        torque = self.torque[self.of(own.joint)]

        def lost(term: Term, pushes: Array) -> Array:
            return np.column_stack([self._columns(own, push)[1] for push in pushes.tolist()])

        nudged = [self._columns(own, nudge_of(torque))] if depends_on_torque(own.term) else None
        return columns_by_torque([own.term], [self._columns(own, 0.0)], nudged, lost, torque)[0]

    def _columns(self, own: JointTerm, more: float, over: Over = _means) -> tuple[Array, Array]:
        linear, fixed = [], []
        for part in self.parts:
            m, blocks = _pushed(part.m.joints[own.joint], more, own.term), part.blocks[own.joint]
            views = [over(impulse_view(m, column), blocks, part.m.period) for column in own.term.columns]
            lost = [over(impulse_view(m, column), blocks, part.m.period) for column in own.term.fixed]
            linear.append(np.column_stack(views) if views else np.empty((len(blocks), 0)))
            fixed.append(sum(lost, np.zeros(len(blocks))))
        return np.concatenate(linear), np.concatenate(fixed)

    def _placed(self, links: Array, owned: Sequence[tuple[JointTerm, Array]]) -> Array:
        """Columns of the body (R, P), and of terms beside them, on the rows of their joints."""
        phi = np.zeros((len(self.joint), links.shape[1] + sum(part.shape[1] for _, part in owned)))
        phi[:, : (first := links.shape[1])] = links
        for own, part in owned:
            phi[self.of(own.joint), first : (first := first + part.shape[1])] = part
        return phi

    def balance(self, terms: Sequence[JointTerm], weights: Array) -> Balance:
        """Equations of body and terms, each joint's scaled by its weight (n,)."""
        owned = [(own, self.columns(own)) for own in terms]
        phi = self._placed(self.links, [(own, part.linear) for own, part in owned])
        slopes = self._placed(np.zeros_like(self.links), [(own, part.slope) for own, part in owned])
        columns = [column for own in terms for column in own.term.columns]
        free = np.full(self.links.shape[1], np.inf)
        least, most = np.r_[-free, [c.least for c in columns]], np.r_[free, [c.most for c in columns]]
        w, y = weights[self.joint], self.torque.copy()
        acting, passed, lead = y.copy(), np.ones(len(y)), np.zeros(len(y))
        for own, part in owned:
            here = self.of(own.joint)
            acting[here] -= part.fixed
            y[here] -= part.fixed * (own.term.lead == 0)
            passed[here] *= part.passed
            lead[here] += own.term.lead
        made = Balance(phi * w[:, None], acting * w, slopes, least, most, np.ones(len(w)))
        bent = [(own.joint, part.taken) for own, part in owned if part.taken is not None]
        if bent:
            pushes = np.stack([pushes_of(self.torque[self.of(k)]) for k in range(len(weights))])[self.joint]
            response = pushes.copy()
            for joint, taken in bent:
                response[self.of(joint)] -= taken
            made = replace(made, response=response * w[:, None], pushes=pushes * w[:, None])
        if lead.any():
            rates = self._placed(self._links(_rates), [(own, self._columns(own, 0.0, _rates)[0]) for own in terms])
            ahead = replace(made, phi=(phi + lead[:, None] * rates) * w[:, None], y=y * w)
            made = replace(made, recorded=ahead)
        return replace(made, passed=passed)

    def residual(self, terms: Sequence[JointTerm], theta: Array) -> Array:
        """Torque (R,) that body and terms of linear parameters theta (P,) leave [N m]."""
        return self.balance(terms, np.ones(len(self.body.joints))).error(theta)

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


def _pushed(m: Measurements, more: float, term: Term) -> Measurements:
    """Measurements of a joint under a torque that is larger all along [N m], with the term's state if it has any."""
    return remember(replace(m, torque=m.torque + more, held=m.held + more) if more else m, [term])
