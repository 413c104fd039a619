"""A trained policy as it ships: a small network in NumPy, so that using it needs neither torch nor unpickling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.observer import ARM, CONSTRAINTS, INPUTS, mirrored
from pendulum_env._typing import Array
from pendulum_env.files import replacing
from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.policy import State
from pendulum_env.reading import Unreadable, read_arrays, shown

LARGEST_WEIGHT = 1e6  # far beyond any that a training finds, and no sum of them overflows
SHIPPED = Path(__file__).parent / "policies"
NAMES = (*CONSTRAINTS, ARM)  # of those that ship, one for each


@dataclass(frozen=True, eq=False, repr=False)
class Network:
    """Perceptron with tanh between its layers; it sees a pendulum turn forwards.

    Attributes:
        weights: of the layers, each (outputs, inputs).
        biases: of the layers, each (outputs,).
        levels: torque as a share of the peak (L,), of which the one with the highest output is played; of an arm the
            speed of each joint as a share of the largest, each with L outputs of its own.
        constraint: it was trained under, or "arm".
    """

    weights: Sequence[Array]
    biases: Sequence[Array]
    levels: Array
    constraint: str

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], State]:
        """Actions (n,) or (B, n) of `ExcitationDesign` or `ArmExcitationDesign`, drawn by their odds if asked.

        The state is what draws them, `(numpy.random.Generator,)`; without one, each call draws by chance.

        Raises:
            ValueError: if the observation is of another length than those of its training.
        """
        if np.shape(observation)[-1] != self.weights[0].shape[1]:
            seen, known = np.shape(observation)[-1], self.weights[0].shape[1]
            if self.constraint == ARM or (seen, known) != (INPUTS + 1, INPUTS):
                trained = f"the policy ({self.constraint}) was trained on observations of {known} numbers"
                raise Mistake(f"{trained}, this one has {seen}")
            observation = np.asarray(observation)[..., :INPUTS]  # one that knows no limit of turns does not see it
        x, sign = (observation, np.ones(())) if self.constraint == ARM else mirrored(observation)
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
        count = max(1, sum(name.startswith("weight") for name in arrays))
        names = [f"{kind}{k}" for kind in ("weight", "bias") for k in range(count)] + ["levels"]
        for name in [*names, "constraint"]:
            if name not in arrays:
                raise ValueError(f"it lacks {name}")
        for name in names:
            own, axes = arrays[name], 2 if name.startswith("weight") else 1
            if own.ndim != axes:
                raise ValueError(f"{name} has {own.ndim} axes, where {axes} {'are' if axes > 1 else 'is'} needed")
            are_numbers = own.dtype.kind in "iuf" and own.size > 0  # NaN fails the comparison
            if not (are_numbers and (np.abs(own.astype(np.longdouble)) <= LARGEST_WEIGHT).all()):
                raise ValueError(f"{name} holds something else than numbers up to {LARGEST_WEIGHT:g}")
        *parameters, levels = (arrays[name].astype(float) for name in names)
        weights, biases = parameters[:count], parameters[count:]
        seen, constraint = weights[0].shape[-1], str(arrays["constraint"])
        of_arm, outputs = constraint == ARM, biases[-1].size
        inputs = seen if of_arm or seen == INPUTS + 1 else INPUTS  # one more with limited turns
        sizes = [inputs, *(bias.size for bias in biases)]
        actions = outputs % levels.size == 0 if of_arm else outputs == levels.size
        if [w.shape for w in weights] != [*zip(sizes[1:], sizes, strict=False)] or not actions:
            raise ValueError("its layers, outputs and levels do not follow from one another")
        if constraint not in NAMES:
            raise ValueError(f"its constraint is {shown(constraint)}, none of {', '.join(NAMES)}")
        if np.abs(levels).max() > 1.0:
            raise ValueError("a level is beyond 1, the peak")
        return cls(weights, biases, levels, constraint)


def load(name: str) -> Network:
    """Policy that ships with the package, or from a file NAME.npz.

    By the constraint it was trained under, "peak" or "rms", or "arm": that for the links of `PlanarArm-v0`.

    Raises:
        ValueError: if there is none of that name, or the file cannot be read, or is no policy.
    """
    if name.endswith(".npz"):
        return Network.load(name)
    return Network.load(find("policy", name, {id: SHIPPED / f"{id}.npz" for id in NAMES}))
