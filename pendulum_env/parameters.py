"""Initial and current parameters of simulated plants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Mask
from pendulum_env.errors import UserError
from pendulum_env.lookup import find
from pendulum_env.physics import Model, Term, effects
from pendulum_env.physics.terms import set_nonlinear_values
from pendulum_env.plant import check_linear, check_nonlinear, refuse_unnamed

Values = Mapping[str, ArrayLike]  # parameters by name, scalars or, of a batch, (B,)


class PlantParameters:
    """Parameters of a plant, or of a batch of B plants of one model, by name.

    Linear parameters have the name of their column, nonlinear parameters are `effect.part`, as in `Model.estimates`.

    Attributes:
        model: plant that the environment was made with.
        values: current parameters by name, each () or (B,).
    """

    def __init__(self, model: Model, batch: tuple[int, ...] = ()) -> None:
        """Make the parameters of a model; `batch` is () or (B,)."""
        self.model, self._batch = model, batch
        self._linear = [column.name for column in model.columns]
        self._nonlinear = {term.get_full_name(p.name): (term.id, p) for term in model.terms for p in term.free}
        self._start: dict[str, Array] = {name: np.full(batch, e.value) for name, e in model.estimates.items()}
        self.values = dict(self._start)

    def reset(self, theta: Values | None = None) -> None:
        """Begin an episode.

        Args:
            theta: parameters by name, for this and later episodes.

        Raises:
            UserError: if a parameter is unknown or impossible; the parameters then stay unchanged.
        """
        previous, self.values = self.values, dict(self._start)
        try:
            if theta is not None:
                self.change(theta)
        except (TypeError, UserError):
            self.values = previous
            raise
        self._start = dict(self.values)

    def restart(self, is_reset: Mask) -> None:
        """Begin an episode of the plants in the mask `is_reset` (B,)."""
        self.values = {name: np.where(is_reset, self._start[name], value) for name, value in self.values.items()}

    def change(self, values: Values, is_changed: Mask | None = None) -> None:
        """Change parameters until the next reset, of all plants or of those in the mask `is_changed` (B,)."""
        for name, value in self._check_values(values).items():
            self.values[name] = value if is_changed is None else np.where(is_changed, value, self.values[name])

    @property
    def terms(self) -> tuple[Term, ...]:
        """Return the terms with the current nonlinear parameters."""
        return set_nonlinear_values(self.model.terms, self.values)

    @property
    def theta(self) -> Array:
        """Return the current linear parameters (P,) or (P, B), in the order of the model's columns."""
        return np.array([self.values[name] for name in self._linear])

    @property
    def current_model(self) -> Model:
        """Return the current plant; of a batch, the model that the environment was made with."""
        if self._batch:
            return self.model
        estimates = self.model.estimates
        changed = {name: float(value) for name, value in self.values.items() if value != estimates[name].value}
        return self.model.with_values(changed) if changed else self.model

    @property
    def info(self) -> dict[str, Any]:
        """Return the current parameters for `info`: numbers, or arrays (B,) with Gymnasium's masks."""
        if not self._batch:
            return {name: float(value) for name, value in self.values.items()}
        all_plants = np.ones(self._batch, dtype=bool)
        return {**self.values, **{f"_{name}": all_plants for name in self.values}}

    def _check_values(self, parameters: Values) -> dict[str, Array]:
        """Return the given parameters as arrays () or (B,); refuse unknown names and impossible values."""
        refuse_unnamed(parameters)
        checked = {}
        for name, value in parameters.items():
            if name.startswith("_"):  # Gymnasium's masks
                continue
            id = name.partition(".")[0]
            if name not in self.values and id in effects() and id not in self.model.effects:
                raise UserError(f"the plant has no effect '{id}' to change: make it with effects=['{id}=0']")
            find("parameter of the plant", name, self.values)
            try:
                array = np.array(np.broadcast_to(np.asarray(value, dtype=float), self._batch))
            except (TypeError, ValueError):
                expected = f"a number{', or one for each of the plants' * bool(self._batch)}"
                raise UserError(f"{name} of a plant cannot be {value!r}: give {expected}") from None
            for number in np.unique(array):
                if name in self._nonlinear:
                    check_nonlinear(*self._nonlinear[name], float(number))
                else:
                    check_linear(name, float(number))
            checked[name] = array
        self._check_nonlinear(checked)
        return checked

    def _check_nonlinear(self, values: Mapping[str, Array]) -> None:
        """Refuse nonlinear parameters that contradict each other, and dead times that differ within a batch."""
        if not values.keys() & self._nonlinear.keys():
            return
        merged = {**self.values, **values}
        terms = set_nonlinear_values(self.model.terms, merged)
        if any(np.ndim(term.delay) for term in terms):
            raise UserError("plants of a batch have one dead_time: give one number, or make each environment by itself")
        for k in range(max(1, *self._batch) if self._batch else 1):
            plant = {name: np.ravel(value)[k] for name, value in merged.items()}
            for term in set_nonlinear_values(self.model.terms, plant):
                if term.fault:
                    raise UserError(f"{term.id} of a plant cannot be so: {term.fault}")


class PlantProperties:
    """Mixin: properties of an environment's plant."""

    plant: PlantParameters

    @property
    def model(self) -> Model:
        """Return the current plant; of a batch, the model that the environment was made with."""
        return self.plant.current_model

    @property
    def theta(self) -> Array:
        """Return the current linear parameters (P,) or (P, B)."""
        return self.plant.theta

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the ids of the plant's effects."""
        return self.plant.model.effects
