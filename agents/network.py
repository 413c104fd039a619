"""A trained policy as it ships: a small network in NumPy, so that using it needs neither torch nor unpickling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.observer import CONSTRAINTS, mirrored
from pendulum_env._typing import Array
from pendulum_env.lookup import find
from pendulum_env.policy import State

SHIPPED = Path(__file__).parent / "policies"


@dataclass(frozen=True, eq=False)
class Network:
    """Perceptron with tanh between its layers; it sees the arm turn forwards.

    Attributes:
        weights: of the layers, each (outputs, inputs).
        biases: of the layers, each (outputs,).
        levels: torque as a share of the peak (L,), of which the one with the highest output is played; None if the only
            output is itself the share, after another tanh.
        constraint: it was trained under.
    """

    weights: Sequence[Array]
    biases: Sequence[Array]
    levels: Array | None
    constraint: str

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], State]:
        """Actions (1,) or (B, 1) of `ExcitationDesign`, without chance.

        Raises:
            ValueError: if the observation is of another length than those of its training.
        """
        if np.shape(observation)[-1] != self.weights[0].shape[1]:
            seen, known = np.shape(observation)[-1], self.weights[0].shape[1]
            raise ValueError(f"the policy was trained on observations of {known} numbers, this one has {seen}")
        x, sign = mirrored(observation)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.tanh(x @ weight.T + bias)
        output = x @ self.weights[-1].T + self.biases[-1]
        share = np.tanh(output[..., 0]) if self.levels is None else self.levels[output.argmax(axis=-1)]
        return (sign * share)[..., None].astype(np.float32), state

    def save(self, path: str | Path) -> None:
        """Write an NPZ file; arrays only."""
        layers: dict[str, Any] = {f"weight{k}": weight.astype(np.float32) for k, weight in enumerate(self.weights)}
        layers |= {f"bias{k}": bias.astype(np.float32) for k, bias in enumerate(self.biases)}
        if self.levels is not None:
            layers["levels"] = self.levels
        with open(path, "wb") as file:
            np.savez_compressed(file, constraint=np.array(self.constraint), **layers)

    @classmethod
    def load(cls, path: str | Path) -> Network:
        """Read what `save` wrote.

        Raises:
            ValueError: if the file is no policy.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                count = sum(name.startswith("weight") for name in file)
                weights, biases = (
                    [file[f"{what}{k}"].astype(float) for k in range(count)] for what in ("weight", "bias")
                )
                network = cls(weights, biases, file.get("levels"), str(file["constraint"]))
            if len(biases[-1]) != (1 if network.levels is None else len(network.levels)):
                raise ValueError("outputs and levels do not fit")
        except (KeyError, ValueError, EOFError):
            raise ValueError(f"{path}: is no policy, which is what `pendulum-ident train` writes") from None
        return network


def load(name: str) -> Network:
    """Policy that ships with the package, by the constraint it was trained under, or from a file NAME.npz.

    Raises:
        ValueError: if there is none of that name, or the file is no policy.
        OSError: if the file cannot be read.
    """
    if name.endswith(".npz"):
        return Network.load(name)
    return Network.load(find("policy", name, {id: SHIPPED / f"{id}.npz" for id in CONSTRAINTS}))
