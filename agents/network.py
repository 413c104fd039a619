"""Trained policies as small NumPy networks, which need neither torch nor pickle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.observer import ARM, CONSTRAINTS, OBSERVATION_SIZE, mirror_observation
from pendulum_env._typing import Array
from pendulum_env.errors import FileError, UserError
from pendulum_env.files import replace_file
from pendulum_env.lookup import find
from pendulum_env.policy import State
from pendulum_env.reading import quote_value, read_arrays

MAX_WEIGHT = 1e6  # larger weights are refused: no training finds them, and their sums may overflow
POLICY_FOLDER = Path(__file__).parent / "policies"
POLICY_NAMES = (*CONSTRAINTS, ARM)  # of the policies in the package


@dataclass(frozen=True, eq=False, repr=False)
class Network:
    """Perceptron with tanh between its layers; observations of a pendulum are mirrored to positive velocity.

    Attributes:
        weights: of the layers, each (outputs, inputs).
        biases: of the layers, each (outputs,).
        levels: torques as shares of the peak (L,); the one with the highest output is played. With links, speeds of a
            joint as shares of the largest; each joint has L outputs.
        constraint: of the training: "peak", "rms" or "arm".
    """

    weights: Sequence[Array]
    biases: Sequence[Array]
    levels: Array
    constraint: str

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], State]:
        """Return actions (n,) or (B, n) of `ExcitationDesign` or `ArmExcitationDesign`.

        Actions are random unless `deterministic`. The state is `(numpy.random.Generator,)`; by default each call makes
        a new one.

        Raises:
            ValueError: if the length of the observation differs from the training.
        """
        if np.shape(observation)[-1] != self.weights[0].shape[1]:
            n_inputs, n_expected = np.shape(observation)[-1], self.weights[0].shape[1]
            trained = f"the policy ({self.constraint}) was trained on observations of {n_expected} numbers"
            raise UserError(f"{trained}, not {n_inputs}: use the observations of its task")
        x, sign = (observation, np.ones(())) if self.constraint == ARM else mirror_observation(observation)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.tanh(x @ weight.T + bias)
        output = x @ self.weights[-1].T + self.biases[-1]
        odds = output.reshape(*output.shape[:-1], -1, len(self.levels))  # logarithms
        if not deterministic:
            state = state or (np.random.default_rng(),)
            odds = odds + state[0].gumbel(size=odds.shape)
        best = odds.argmax(axis=-1)
        return (sign[..., None] * self.levels[best]).astype(np.float32), state

    def save(self, path: str | Path) -> None:
        """Write the arrays to an NPZ file.

        Raises:
            OSError: if the file cannot be written.
        """
        layers: dict[str, Any] = {f"weight{k}": weight.astype(np.float32) for k, weight in enumerate(self.weights)}
        layers |= {f"bias{k}": bias.astype(np.float32) for k, bias in enumerate(self.biases)}
        with replace_file(path) as file:
            np.savez_compressed(file, constraint=np.array(self.constraint), levels=self.levels, **layers)

    @classmethod
    def load(cls, path: str | Path) -> Network:
        """Read a file written by `save`.

        Raises:
            FileError: if the file cannot be read, or is no policy.
        """
        hint = "a policy is what `pendulum-ident train` writes"
        arrays = read_arrays(path, hint)
        try:
            return cls._from_arrays(arrays)
        except ValueError as error:
            raise FileError(f"{path}: is no policy: {error}; {hint}") from None

    @classmethod
    def _from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Network:
        count = max(1, sum(name.startswith("weight") for name in arrays))
        names = [f"{kind}{k}" for kind in ("weight", "bias") for k in range(count)]
        for name in [*names, "levels", "constraint"]:
            if name not in arrays:
                raise ValueError(f"it lacks {name}")
        with np.errstate(over="ignore"):  # overflowing values are refused below
            *parameters, levels = (np.asarray(arrays[name], dtype=float) for name in [*names, "levels"])
        if not all((np.abs(array) <= MAX_WEIGHT).all() for array in parameters) or not (np.abs(levels) <= 1.0).all():
            raise ValueError(f"it holds weights beyond {MAX_WEIGHT:g}, or levels beyond 1, the peak")
        weights, biases, constraint = parameters[:count], parameters[count:], str(arrays["constraint"])
        if constraint not in POLICY_NAMES:
            raise ValueError(f"its constraint is {quote_value(constraint)}, none of {', '.join(POLICY_NAMES)}")
        outputs = biases[-1].size
        actions = outputs // max(1, levels.size) if constraint == ARM else 1
        n_inputs = weights[0].shape[-1] if weights[0].ndim else 0
        sizes = [n_inputs, *(bias.size for bias in biases)]
        fits = all(w.shape == size for w, size in zip(weights, zip(sizes[1:], sizes, strict=False), strict=True))
        if not (fits and outputs and outputs == actions * levels.size) or any(bias.ndim != 1 for bias in biases):
            raise ValueError("its layers, outputs and levels do not follow from one another")
        if constraint != ARM and n_inputs != OBSERVATION_SIZE:
            raise ValueError(f"its observations have {n_inputs} numbers, not {OBSERVATION_SIZE}")
        return cls(weights, biases, levels, constraint)


def load(name: str) -> Network:
    """Load a policy of the package, or from a file NAME.npz.

    The policies of the package are "peak" and "rms", by the constraint of the training, and "arm", for the links of
    `PlanarArm-v0`.

    Raises:
        ValueError: if the name is unknown, or the file cannot be read, or is no policy.
    """
    if name.endswith(".npz"):
        return Network.load(name)
    return Network.load(find("policy", name, {id: POLICY_FOLDER / f"{id}.npz" for id in POLICY_NAMES}))
