"""What a search asks of prepared data: windows answer it by torque, rollouts by the motion of a servo in its loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from estimators.regression.balance import Balance, Columns
from estimators.selection.errors import Errors
from estimators.simulation.free_running import Segments
from estimators.weak_form.dataset import Structure
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Trial:
    """A set of terms with the error of its fit, in torque [N m] or in the loop [rad]."""

    terms: tuple[Term, ...]
    fitted_rms: float


class Data(Protocol):
    """R equations of recordings: which belong together, and what noise leaves of them [N m], or [rad] of rollouts."""

    @property
    def windows(self) -> tuple[Windows, ...]:
        """Windows of each recording and joint; none of rollouts."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of their rows."""

    @property
    def weights(self) -> Array:
        """Relative weight of each equation (R,)."""

    @property
    def clusters(self) -> Index:
        """Block of time of each equation (R,), for standard errors."""

    @property
    def watched(self) -> Mapping[str, Sequence[Samples]]:
        """Samples with estimated state variables, by the id of their term."""

    def where(self, at: str) -> slice:
        """Rows of a joint; all rows for terms at no single joint."""

    def part(self, at: str) -> Data:
        """The data of a joint; all data for terms at no single joint."""

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Block of about `length` seconds and entry of each equation (R,); recording of each block (S,)."""

    def structure(self, residual: Array, inertia: float) -> Structure:
        """Structure of a residual (R,)."""

    def power(self, residual: Array) -> float:
        """Mean square of a residual (R,)."""

    def precision(self) -> float:
        """Error of what is computed from the recordings."""

    def noise(self, inertia: float) -> float:
        """Error due to measurement noise."""

    def errors(self, residual: Array) -> dict[str, float]:
        """Root mean square of a residual (R,) at each joint."""


class Fits(Protocol):
    """Fits of sets of terms, linear ones in P parameters, to R equations."""

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Columns of each variant of one effect, on the rows of its joint."""

    def placed(self, terms: Sequence[Term], parts: Sequence[Array]) -> Array:
        """Columns of some terms side by side (R, P)."""

    def balance(self, terms: Sequence[Term]) -> Balance:
        """Equations of some terms, with smaller weights for recordings of larger residuals."""

    def equations(self, terms: Sequence[Term]) -> Balance:
        """The same, weighted by noise alone."""

    def weights(self, terms: Sequence[Term]) -> Array:
        """Weight of each equation (R,)."""

    def solve(self, terms: Sequence[Term]) -> Array:
        """Linear parameters (P,) of the terms."""

    def solve_without(self, terms: Sequence[Term]) -> Array:
        """Linear parameters of the terms without each fold of blocks (FOLDS, P)."""

    def residual(self, terms: Sequence[Term]) -> Array:
        """What a fit of the terms does not predict (R,)."""

    def hidden_noise(self, terms: Sequence[Term]) -> list[tuple[slice, float]]:
        """Variance of noise that terms filter out of the equations, with their rows."""

    def frame(self, terms: Sequence[Term]) -> Array:
        """Orthonormal basis (R, P) of changes of the weighted errors by the parameters."""

    def shape_jacobian(self, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
        """Derivatives (R, S) by continuous shape parameters, and their names."""

    def as_fitted(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """The terms with shape parameters that follow others as these were fitted."""

    def settle(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """The terms fitted as closely as can be."""


class Screening(Protocol):
    """Variants of effects beside the terms of a model, by how well they fit."""

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Error of one set of terms."""

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """`terms` with each of several variants of one further effect added, and their errors."""

    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The terms with each variant of the grid of an effect, the smallest error first."""

    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of free shape parameters, the fewest first."""

    def looked_at(self, terms: Sequence[Term], effect: type[Term]) -> int:
        """Number of variants of the grid."""

    def refine(self, trial: Trial, id: str) -> Trial:
        """Search the continuous shape parameters of one term of a trial from where they are."""


class Comparable(Protocol):
    """Recordings, ready to be compared with models."""

    @property
    def in_loop(self) -> bool:
        """Whether the controller is simulated along, and a link with it."""

    @property
    def data(self) -> Data:
        """Equations."""

    @property
    def regression(self) -> Fits:
        """Fits of sets of terms."""

    @property
    def screen(self) -> Screening:
        """Variants of effects."""

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings, or parts of them."""

    @property
    def samples(self) -> Samples:
        """Samples of the motion."""

    @property
    def motions(self) -> dict[str, Samples]:
        """Those of each joint, by its name."""

    @property
    def reach(self) -> tuple[float, float]:
        """Least and largest position that was recorded [rad]."""

    def reach_of(self, joint: str) -> tuple[float, float]:
        """The same of a joint."""

    @property
    def segments(self) -> tuple[Segments, ...]:
        """Segments for simulation, of each recording; none where there is nothing to simulate apart."""

    def inertias(self, base: Sequence[Term]) -> dict[str, float]:
        """Inertia that each joint feels under a base model, by the joint's name [kg m^2]: it scales the noise."""

    def watching(self, model: Model) -> Comparable:
        """The same with the link of the model's transmission as the motion around each instant has it."""

    def residual(self, terms: Sequence[Term], theta: Array) -> Array:
        """Measured minus predicted (R,)."""

    def errors(self, model: Model) -> Errors:
        """Errors of a model."""
