"""Sections of a report, and their data."""

from dataclasses import dataclass
from functools import cached_property

from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.decisions.errors import Step
from estimators.diagnosis.result import Diagnosis
from estimators.identification import identify
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.result import Identification
from estimators.schemes.six import SCHEMES
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.narrator.parts import Content


@dataclass(frozen=True)
class Section:
    """Titled part of the page."""

    id: str  # anchor on the page
    short: str  # title in the navigation
    title: str  # heading
    content: Content


@dataclass(frozen=True)
class ReportData:
    """Diagnosis with derived data, each computed once."""

    diagnosis: Diagnosis
    first: str = "base model"  # name of the first model
    command: str = ""  # equivalent command lines, if known

    @property
    def data(self) -> FitData:
        """Return the data of the diagnosis; raises ValueError if it was read from a file."""
        if self.diagnosis.data is None:
            raise ValueError("the diagnosis has no data: give it those of its recordings, see FitData")
        return self.diagnosis.data

    @cached_property
    def schemes(self) -> Identification | None:
        """Return the schemes for the final model; None if the data do not suffice."""
        return identify_schemes(self.data.recordings, self.diagnosis.model)

    @property
    def ends(self) -> list[Step]:
        """Return the plotted steps: the first and, if effects were added, the last."""
        steps = self.diagnosis.steps
        return [steps[0], steps[-1]][: len(steps)]

    @property
    def units(self) -> JointUnits:
        """Return the units of the model's quantities; for an arm those of a rotating joint."""
        return self.diagnosis.model.units()

    @property
    def angle(self) -> tuple[float, str]:
        """Return the displayed unit of positions: factor from SI, and name."""
        return to_shown_unit(1.0, self.units.unit("rad"))

    @property
    def model_labels(self) -> list[tuple[str, str]]:
        """Return the label and colour of each plotted model."""
        return [(self.first, "--base"), ("final model", "--final")][: len(self.ends)]

    @cached_property
    def parts(self) -> list[list[RegressionData]]:
        """Return fitted and held-out data for each plotted model, with its link states if it has a link."""
        return [[part.with_link_states(step.model) for step in self.ends] for part in self.data.parts[:2]]

    def compute_residuals(self, part: int) -> list[Array]:
        """Return measured minus modelled torque (R,) [N m] of each plotted model; `part`: 0 fitted, 1 held out."""
        pairs = zip(self.parts[part], self.ends, strict=True)
        return [data.residual(step.model.terms, step.model.theta) for data, step in pairs]


def identify_schemes(recordings: tuple[Recording, ...], model: Model) -> Identification | None:
    """Identify a pendulum by all schemes; None if the data do not suffice."""
    try:
        return identify(recordings, model.terms, SCHEMES)
    except IdentificationError:
        return None
