"""Gains of competing models over the running model: densities by chunk and by block, and their evidence."""

from __future__ import annotations

from collections import deque
from copy import deepcopy

import numpy as np

from estimators.online.evidence import EProcess, ReferenceDistribution
from estimators.online.settings import ONLINE
from pendulum_env._typing import Array


class Gains:
    """Gains of some effects, and of forgetting in the last place, over the running model.

    Attributes:
        chunks: log predictive densities of the last chunks, of the running model, with each effect and with forgetting.
        e_process: e-process of each effect, and in the last place of forgetting.
        reference: distribution of the gain of forgetting.
        chunks_per_block: number of chunks in a block.
        n_chunks: number of chunks so far.
        n_since_rise: number of chunks since the evidence of a change began to rise.
    """

    def __init__(
        self, competitors: int, chunk_time: float, block: float, reference: ReferenceDistribution | None = None
    ) -> None:
        """Begin with chunks and blocks of some duration [s]; the gains have their own copy of a known reference."""
        self.chunks_per_block = max(1, round(block / chunk_time))
        self.chunks: deque[Array] = deque(maxlen=ONLINE.models.blocks * self.chunks_per_block)
        self.e_process, self.reference = EProcess(competitors), deepcopy(reference) or ReferenceDistribution()
        self.n_chunks = self.n_since_rise = 0

    def take(self, chunk: Array) -> None:
        """Add the log predictive densities in a chunk (F,) [nat]."""
        self.chunks.append(chunk)
        self.n_chunks += 1
        gain = chunk[1:] - chunk[0]
        gain[-1] = self.reference.take_gain(float(gain[-1]))
        self.e_process.take(gain - ONLINE.limits.gain * ONLINE.bins.chunk)
        self.n_since_rise = self.n_since_rise + 1 if self.e_process.log_wealth[-1] > 0 else 0

    @property
    def has_block_ended(self) -> bool:
        """Return whether a block has ended with the last chunk."""
        return self.n_chunks % self.chunks_per_block == 0

    @property
    def blocks(self) -> Array:
        """Return log predictive densities by block (N, F); by chunk while blocks are few."""
        chunks = np.array(self.chunks)
        if len(chunks) < ONLINE.limits.blocks * self.chunks_per_block:
            return chunks
        whole = chunks[len(chunks) % self.chunks_per_block :]
        return np.asarray(whole.reshape(-1, self.chunks_per_block, chunks.shape[1]).sum(axis=1))

    @property
    def effect_evidence(self) -> float:
        """Return the share of the effects in the joint evidence, without forgetting [nat]."""
        log_wealth = self.e_process.log_wealth
        return float(np.logaddexp.reduce(log_wealth[:-1]) - np.log(len(log_wealth)))

    def compute_best_density(self, chunks: int) -> float:
        """Return the log density of a number of latest chunks under the best model without forgetting [nat]."""
        return float(np.array(self.chunks)[-chunks:, :-1].sum(axis=0).max())
