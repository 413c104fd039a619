"""Result of an identification: the estimates of all schemes, and findings on recordings and model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.standard_errors import add_torque_constant
from estimators.findings import Finding, bias_everything, collect_withheld
from estimators.free_swings import make_swing_terms, restore_known
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.fitting import Identified
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import JSON
from pendulum_env.formatting import join_words
from pendulum_env.lookup import find
from pendulum_env.notebook import Shown, summarise
from pendulum_env.physics import Mechanism, Model
from pendulum_env.recording.channel import NEWTON_METRE, TorqueConstant

SCHEMA = "pendulum-ident/identification@3"
SAVED_SCHEME = "filtered_dynamic"  # scheme of the saved model with links
MAX_NAMES = 3  # largest number of printed names of recordings


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Mapping[str, Identified], Shown):
    """Results of all schemes on the same recordings, by id of the scheme; equal only if they are the same object.

    Attributes:
        schemes: results by id of the scheme.
        findings: undetermined parameters, and possible faults of recordings or model.
        recordings: names of the recordings.
        ends: total duration of the recordings up to the end of each; empty if unknown [s].
        torque_unit: `N m`, or the unit of a current; parameters are then per unit of current.
        torque_constant: ratio of torque and current, if a current was converted; standard errors include its error.
        data: windows of the recordings; None if too little motion is clear of stick, and with links.
    """

    schemes: Mapping[str, Identified]
    findings: tuple[Finding, ...]
    recordings: tuple[str, ...]
    ends: tuple[float, ...] = ()
    torque_unit: str = NEWTON_METRE
    torque_constant: TorqueConstant | None = None
    data: TorqueWindows | None = field(default=None, repr=False)

    @property
    def mechanism(self) -> Mechanism:
        """Return the joints of the model."""
        return next(iter(self.schemes.values())).model.mechanism

    @property
    def primary(self) -> Identified:
        """Return the result of the scheme `SAVED_SCHEME` if it was used, else of the first scheme."""
        return self.schemes.get(SAVED_SCHEME, next(iter(self.schemes.values())))

    def __getitem__(self, scheme: str) -> Identified:
        return find("scheme", scheme, self.schemes)

    def __iter__(self) -> Iterator[str]:
        return iter(self.schemes)

    def __len__(self) -> int:
        return len(self.schemes)

    __eq__, __hash__ = object.__eq__, object.__hash__  # a Mapping compares its items and has no hash

    @property
    def model(self) -> Model:
        """Return the fit by `least_squares`, or that of `primary`, see `is_of_scheme`."""
        return self.primary.model if self.is_of_scheme else self.least_squares

    @property
    def is_of_scheme(self) -> bool:
        """Return whether `model` is that of a scheme: with links, or with one scheme."""
        return len(self.schemes) == 1 or not self.mechanism.can_simulate

    @cached_property
    def least_squares(self) -> Model:
        """Return the least-squares fit over windows, as in `compare` and `diagnose`.

        The estimates of an incomplete model, or under late torque, are marked as biased. Parameters withheld by
        findings, and an insignificant inertia, have no value.

        Raises:
            IdentificationError: if `data` is None.
        """
        if self.data is None:
            names = join_words(self.recordings)
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick: record longer or faster motion"
            )
        first = next(iter(self.schemes.values())).model
        recordings = [w.recording for w in self.data.windows]
        model, _ = fit_terms(RegressionData(self.data), make_swing_terms(first.terms, recordings))
        model = replace(add_torque_constant(model, self.data), log_format=first.log_format)
        model = restore_known(model, first.terms, recordings)
        unknown = collect_withheld(self.findings)
        inertia = model.estimates.get("inertia")
        if inertia is not None and not inertia.is_significant:
            unknown.add("inertia")
        return (model.mark_biased() if bias_everything(self.findings) else model).mark_unknown(unknown)

    def __repr__(self) -> str:
        count = len(self.recordings)
        names = join_words(self.recordings) if count <= MAX_NAMES else f"{count} recordings"
        return f"<Identification of {names}>\n{summarise(self)}"

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "recordings": list(self.recordings),
            "torque_unit": self.torque_unit,
            "torque_constant": self.torque_constant.json() if self.torque_constant is not None else None,
            "findings": [finding.json() for finding in self.findings],
            "schemes": {id: result.json() for id, result in self.schemes.items()},
        }
