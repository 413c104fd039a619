"""Sections of a report, and their data, computed once."""

from dataclasses import dataclass
from functools import cached_property

from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.result import Diagnosis
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.identification import identify
from estimators.schemes.result import Identification
from estimators.schemes.six import SCHEMES
from estimators.selection.errors import Step
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.narrator.parts import Content


@dataclass(frozen=True)
class Section:
    """Part of the page under one heading."""

    id: str  # anchor on the page
    short: str  # title in the navigation
    title: str  # heading
    content: Content


@dataclass(frozen=True)
class ReportData:
    """A diagnosis with the data that it rests on."""

    diagnosis: Diagnosis  # what was found
    first: str = "base model"  # what the model is called that the diagnosis started from
    command: str = ""  # lines that do the same, if it came from the command line or the app
    identified: Identification | None = None  # all schemes with the terms of the final model, if they are known

    @property
    def data(self) -> FitData:
        """Return the data of the diagnosis; raises ValueError for a diagnosis that was read from a file."""
        if self.diagnosis.data is None:
            raise ValueError("the diagnosis has no data: give it those of its recordings, see FitData")
        return self.diagnosis.data

    @cached_property
    def schemes(self) -> Identification | None:
        """Return all schemes with the terms of the final model, None where the recordings are too poor for them."""
        return self.identified or identify_schemes(self.data.recordings, self.diagnosis.model)

    @property
    def ends(self) -> list[Step]:
        """List the first model with its errors and, where effects were added, the last one: those that are drawn."""
        steps = self.diagnosis.steps
        return [steps[0], steps[-1]][: len(steps)]

    @property
    def units(self) -> JointUnits:
        """Return JointUnits that stands for the torque; of an arm that of a joint that turns."""
        return self.diagnosis.model.units()

    @property
    def angle(self) -> tuple[float, str]:
        """Return the factor from SI to the unit in which positions are shown, and that unit."""
        return to_shown_unit(1.0, self.units.unit("rad"))

    @property
    def model_labels(self) -> list[tuple[str, str]]:
        """Label and colour of each model."""
        return [(self.first, "--base"), ("final model", "--final")][: len(self.ends)]

    @cached_property
    def parts(self) -> list[list[RegressionData]]:
        """Fitted and held-out data for each drawn model, with the states of its link if it has one."""
        return [[part.with_link_states(step.model) for step in self.ends] for part in self.data.parts[:2]]

    def compute_residuals(self, part: int) -> list[Array]:
        """Return the measured minus modelled torque (R,) [N m] of each drawn model in a part of the data."""
        pairs = zip(self.parts[part], self.ends, strict=True)
        return [data.residual(step.model.terms, step.model.theta) for data, step in pairs]


def identify_schemes(recordings: tuple[Recording, ...], model: Model) -> Identification | None:
    """Identify a pendulum by all schemes; None where recordings are too poor for them."""
    try:
        return identify(recordings, model.terms, SCHEMES)
    except IdentificationError:
        return None
