"""A trained policy as it ships: a small network in NumPy, so that using it needs neither torch nor unpickling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.observer import CONSTRAINTS, INPUTS, mirrored
from pendulum_env._typing import Array
from pendulum_env.files import replacing
from pendulum_env.lookup import find
from pendulum_env.policy import State
from pendulum_env.reading import Unreadable, read_arrays, shown

LARGEST_WEIGHT = 1e6  # far beyond any that a training finds, and no sum of them overflows
SHIPPED = Path(__file__).parent / "policies"
NAMES = tuple(CONSTRAINTS)  # of those that ship, one for each


@dataclass(frozen=True, eq=False)
class Network:
    """Perceptron with tanh between its layers; it sees the arm turn forwards.

    Attributes:
        weights: of the layers, each (outputs, inputs).
        biases: of the layers, each (outputs,).
        levels: torque as a share of the peak (L,), of which the one with the highest output is played.
        constraint: it was trained under.
    """

    weights: Sequence[Array]
    biases: Sequence[Array]
    levels: Array
    constraint: str

    def __repr__(self) -> str:
        """One line: what it sees, its layers, what it may play, and for which bound it was trained."""
        layers = "-".join(str(one.shape[1]) for one in self.weights)
        return f"<Network of {layers} units, which plays {len(self.levels)} torques, trained under {self.constraint!r}>"

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
        return (sign * self.levels[output.argmax(axis=-1)])[..., None].astype(np.float32), state

    def save(self, path: str | Path) -> None:
        """Write an NPZ file; arrays only.

        Raises:
            OSError: if it cannot be written; it names the file.
        """
        layers: dict[str, Any] = {f"weight{k}": weight.astype(np.float32) for k, weight in enumerate(self.weights)}
        layers |= {f"bias{k}": bias.astype(np.float32) for k, bias in enumerate(self.biases)}
        with replacing(path) as file:
            np.savez_compressed(file, constraint=np.array(self.constraint), levels=self.levels, **layers)

    @classmethod
    def load(cls, path: str | Path) -> Network:
        """Read what `save` wrote.

        Raises:
            Unreadable: if the file cannot be read, or is no policy.
        """
        hint = "a policy is what `pendulum-ident train` writes"
        arrays = read_arrays(path, hint)
        try:
            return cls._of(arrays)
        except ValueError as error:
            raise Unreadable(f"{path}: is no policy: {error}; {hint}") from None

    @classmethod
    def _of(cls, arrays: Mapping[str, NDArray[Any]]) -> Network:
        count = sum(name.startswith("weight") for name in arrays)
        weights = [_numbers(arrays, f"weight{k}", 2) for k in range(count)]
        biases = [_numbers(arrays, f"bias{k}", 1) for k in range(count)]
        levels = _numbers(arrays, "levels", 1)
        constraint = str(arrays["constraint"]) if "constraint" in arrays else ""
        if constraint not in CONSTRAINTS:
            raise ValueError(f"its constraint is {shown(constraint)}, none of {', '.join(CONSTRAINTS)}")
        if not weights:
            raise ValueError("it lacks weight0")
        seen = weights[0].shape[1]  # one more with a limit on turns
        inputs = [seen if seen == INPUTS + 1 else INPUTS, *(len(bias) for bias in biases)]
        for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            if weight.shape != (len(bias), inputs[k]):
                raise ValueError(f"weight{k} has shape {weight.shape}, where {(len(bias), inputs[k])} follows")
        if len(biases[-1]) != len(levels):
            raise ValueError("outputs and levels differ in number")
        if np.abs(levels).max() > 1.0:
            raise ValueError("a level is beyond 1, the peak")
        return cls(weights, biases, levels, constraint)


def _numbers(arrays: Mapping[str, NDArray[Any]], name: str, axes: int) -> Array:
    """An array of a policy file that holds nothing but finite numbers.

    Raises:
        ValueError: if it is missing, or none.
    """
    if name not in arrays:
        raise ValueError(f"it lacks {name}")
    array = arrays[name]
    if array.dtype.kind not in "iuf" or array.ndim != axes or not array.size:
        raise ValueError(f"{name} has type {shown(str(array.dtype))} and shape {shown(array.shape)}")
    with np.errstate(over="ignore"):
        numbers = array.astype(float)
    if not (np.abs(numbers) <= LARGEST_WEIGHT).all():  # nor NaN
        raise ValueError(f"{name} holds a number that is not finite, or beyond {LARGEST_WEIGHT:g}")
    return numbers


def load(name: str) -> Network:
    """Policy that ships with the package, or from a file NAME.npz.

    By the constraint it was trained under, "peak" or "rms".

    Raises:
        ValueError: if there is none of that name, or the file cannot be read, or is no policy.
    """
    if name.endswith(".npz"):
        return Network.load(name)
    return Network.load(find("policy", name, {id: SHIPPED / f"{id}.npz" for id in NAMES}))
