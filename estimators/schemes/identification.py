"""Identification: the parameters of a model from recordings, by each of the six schemes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from estimators.arguments import Recordings, Terms, apply_limits, select_recordings, select_terms
from estimators.checks.completeness import check_arm, check_joint
from estimators.checks.torque_constant import add_torque_constant
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData, fit_terms
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import make_swing_terms, restore_known
from estimators.regression.equations import IdentificationError
from estimators.schemes.balance import Joints, adapt_to_arms, stack_series
from estimators.schemes.fitting import Identified, Segments, fit_equations, make_regressions, stack
from estimators.schemes.identifiability import (
    CONSTANT,
    find_dependent_columns,
    find_undetermined,
    find_undetermined_links,
    find_unidentifiable,
    has_effective_torque,
)
from estimators.schemes.six import SCHEMES, LowPass, Regression, Regressor, Scheme, select_schemes
from estimators.signals.measurements import Measurements, measure_joints, measure_segments, remember
from estimators.weak_form.torque_windows import TorqueWindows, prepare
from pendulum_env._typing import JSON
from pendulum_env.arguments import check_order
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_body
from pendulum_env.formatting import join_words
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.notebook import render_html, summarise
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.limits import Bounds, LimitsError, collect_limits
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording import Recording
from pendulum_env.recording.columns import NONE
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.recording.study import collect_log_format
from pendulum_env.settings import format_setting

SCHEMA = "pendulum-ident/identification@2"
SAVED = "filtered_dynamic"  # scheme whose model of an arm is the one to go on with
SHOWN = 3  # recordings, at most, whose names are printed
FEWEST = 10  # that hold motion, below which standard errors mean little


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Mapping[str, Identified]):
    """Results of all schemes on the same recordings, by the id of the scheme.

    Two identifications are equal only if they are the same object.

    Attributes:
        schemes: results by id of the scheme.
        findings: parameters that the recordings do not determine, and what seems wrong with recordings or model.
        recordings: names.
        ends: seconds of recording taken in at the end of each recording; empty if unknown [s].
        torque_unit: `N m`, or that of a current in whose stead parameters are per unit of it.
        torque_constant: by which a current was turned into torque, if one was; standard errors include its own.
        data: windows of the recordings; None where too little of the motion is clear of stick for any, and of an arm.
    """

    schemes: Mapping[str, Identified]
    findings: tuple[Finding, ...]
    recordings: tuple[str, ...]
    ends: tuple[float, ...] = ()
    torque_unit: str = NEWTON_METRE
    torque_constant: TorqueConstant | None = None
    data: TorqueWindows | None = field(default=None, repr=False)

    @property
    def body(self) -> Mechanism:
        """Return the joints of the model."""
        return next(iter(self.schemes.values())).model.body

    def __getitem__(self, scheme: str) -> Identified:
        return find("scheme", scheme, self.schemes)

    def __iter__(self) -> Iterator[str]:
        return iter(self.schemes)

    def __len__(self) -> int:
        return len(self.schemes)

    __eq__, __hash__ = object.__eq__, object.__hash__  # a Mapping compares its items and has no hash

    @cached_property
    def windows(self) -> Model:
        """Return the least-squares fit over windows, as in `compare` and `diagnose`; raises as `fitted`."""
        first, *_ = models = [one.model for one in self.schemes.values()]
        disputed = {name for model in models for name, estimate in model.estimates.items() if estimate.is_biased}
        recordings = [] if self.data is None else [w.recording for w in self.data.windows]
        terms = make_swing_terms(first.terms, recordings) if recordings else first.terms
        unknown = {name for finding in self.findings for name in finding.withheld}
        model = self.fit_windows(lambda data: fit_terms(RegressionData(data), terms)[0])
        model = restore_known(model, first.terms, recordings) if recordings else model
        inertia = model.estimates.get("inertia")
        if inertia is not None and not inertia.is_significant:
            unknown.add("inertia")
        return model.mark_biased(disputed).withhold(unknown)

    def fit_windows(self, fit: Callable[[TorqueWindows], Model]) -> Model:
        """Return the model of the fit over windows, in the unit of the recorded torque, with the torque constant.

        Raises:
            IdentificationError: if there are none.
        """
        if self.data is None:
            names = join_words(self.recordings)
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick: record longer or faster motion"
            )
        log_format = next(iter(self.schemes.values())).model.log_format
        return replace(add_torque_constant(fit(self.data), self.data, fit), log_format=log_format)

    def __repr__(self) -> str:
        count = len(self.recordings)
        names = join_words(self.recordings) if count <= SHOWN else f"{count} recordings"
        return f"<Identification of {names}>\n{summarise(self)}"

    def _repr_html_(self) -> str:
        return render_html(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "recordings": list(self.recordings),
            "torque_unit": self.torque_unit,
            "torque_constant": self.torque_constant.json() if self.torque_constant is not None else None,
            "findings": [finding.json() for finding in self.findings],
            "schemes": {id: result.json() for id, result in self.schemes.items()},
        }


@refuse_unknown_arguments
def identify(
    recordings: Recordings,
    terms: Terms = BASE,
    schemes: str | Sequence[str | Regressor] = SCHEMES,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
) -> Identification:
    """Fit the linear parameters of the terms to recordings, one set for all, by each scheme.

    Parameters are those of the joint without the known loads of the recordings. Where a current was logged, these tell
    the torque constant; where they do not, parameters are per ampere, and a finding says why.

    Of an arm, they are the base parameters of its links and those of what acts at its joints. A sample in which a joint
    sticks is left out of the row of that joint alone, and joints with less noise count more.

    Args:
        recordings: one or more; filters start anew with each, and noisier ones count less.
        terms: of the model, with their nonlinear parameters set, or by id; of an arm `arm_base(body)`, or
            `Links(body)` and terms at its joints.
        schemes: which to use, as they are or by id; one that borrows its inertia, or what makes the momentum of an arm,
            comes after the scheme that lends it.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"viscous": (0.0, None)}`, None for no limit; an estimate that would leave them
            stays at the bound.

    Raises:
        IdentificationError: if there is too little motion, or no torque at all.
        ValueError: if a name is unknown, a term is at no joint of an arm, or a scheme borrows from one that was not
            used before.
        TypeError: if something else is given than recordings, terms and schemes.
    """
    check_order("identify(recordings, terms, schemes)", (recordings, Recording), (terms, Term | Model))
    terms, chosen = select_terms(terms), select_schemes(schemes)
    body = find_body(terms)
    recordings = select_recordings(recordings, body=body)
    terms, _ = apply_limits(terms, {}, fixed, bounds)
    limits = collect_limits(terms)
    if absent := [name for name in (*(fixed or ()), *(bounds or ())) if name not in limits]:
        raise LimitsError(f"the model has no parameter '{absent[0]}': add its effect to the terms, or leave it out")
    found = (_identify_arm if isinstance(body, Body) else _identify_joint)(recordings, terms, chosen)
    log_format = collect_log_format(recordings)
    return replace(
        found,
        schemes={
            id: replace(own, model=replace(own.model, log_format=log_format)) for id, own in found.schemes.items()
        },
    )


def _identify_joint(
    recordings: Sequence[Recording], terms: Sequence[Term], schemes: Sequence[Regressor]
) -> Identification:
    """Identify one joint, whose torque constant may be unknown."""
    given = FitData.of(recordings, terms=terms)
    recordings, original = given.recordings, terms
    terms = make_swing_terms(original, recordings)
    segments = _measure_joints(recordings, terms)
    measurements = [m for own in segments for (m,) in own]
    if not (all(own.is_free for own in recordings) or any(has_effective_torque(m) for m in measurements)):
        raise IdentificationError(f"{_join_names(recordings)}: {_describe_undriven_torque(recordings)}")
    chosen, slowed = _limit_filters(schemes, segments)
    doubts = (*find_undetermined(measurements, terms, recordings[0].units), *slowed)
    results = _fit_schemes(chosen, segments, terms, recordings, make_regressions(terms))
    first = next(iter(results.values())).model
    if given.constant is not None:
        larger = 1 + given.constant.std / given.constant.value
        moved = [replace(one, torque=larger * one.torque) if one.torque_constant else one for one in recordings]
        there = _fit_schemes(chosen, _measure_joints(moved, terms), terms, recordings, make_regressions(terms))
        results = {id: own.with_constant_error(given.constant, there[id].model) for id, own in results.items()}
    else:
        results = {id: own.per(recordings[0].units).with_known(original, recordings) for id, own in results.items()}
    results, doubts = _withhold_estimates(results, measurements, doubts)
    data = None
    with suppress(IdentificationError):  # windows need more motion than some schemes
        data = prepare(recordings)
    mistakes, results = check_joint(first, results, given, data, terms)
    unknown = (given.doubt,) if given.doubt is not None else ()
    ends = tuple(np.cumsum([sum(len(m) * m.period for (m,) in own) for own in segments]).tolist())
    return Identification(
        results,
        (*doubts, *unknown, *mistakes),
        tuple(recording.name for recording in recordings),
        ends,
        given.unit,
        given.constant,
        data,
    )


def _describe_undriven_torque(recordings: Sequence[Recording]) -> str:
    """Describe torque that the motion does not follow, with the option that leaves it out."""
    column = "torque" if any(own.torque.any() for own in recordings) else "load_torque"
    series = [values for own in recordings if (values := getattr(own, column)) is not None]
    option = f"read the file without it, {format_setting('columns', {column: NONE})}"
    if any(np.ptp(values) > CONSTANT * np.abs(values).max() for values in series):
        return f"the {column} is noise alone: {option}"
    return (
        f"{column} is constant at {series[0][0]:.3g}, and the motion does not follow it: {option}, or mend its offset"
    )


def _identify_arm(
    recordings: Sequence[Recording], terms: Sequence[Term], schemes: Sequence[Regressor]
) -> Identification:
    """Identify an arm, whose first term is its links."""
    segments = [measure_joints(recording.joints) for recording in recordings]
    measured = [joints for own in segments for joints in own]
    for k, joint in enumerate(terms[0].mechanism.joints):
        if not any(joints[k].moving.any() for joints in measured):
            raise IdentificationError(
                f"{_join_names(recordings)}: joint '{joint}' never moves: record with all joints moving"
            )
    chosen, slowed = _limit_filters(adapt_to_arms(schemes), segments)
    of = make_regressions(terms)
    results = _fit_schemes(chosen, segments, terms, recordings, of)
    first = stack(segments, partial(of, chosen[0]))
    phi, columns = first.equations.phi, [column.name for term in terms for column in term.columns]
    doubts = [*slowed, *find_dependent_columns(phi[first.usable], columns, np.any(phi, axis=0))]
    parts = [stack_series(joints, "position", "velocity", "held") for joints in measured]
    seen = [np.concatenate(each) for each in zip(*parts, strict=True)]
    alike = {name for doubt in doubts for name in doubt.withheld}
    unknown = {id: frozenset(find_undetermined_links(one.model, *seen)) for id, one in results.items()}
    if alone := sorted(frozenset.intersection(*unknown.values()) - alike):  # by no scheme; others show no number for it
        doubts.append(Finding(Kind.UNIDENTIFIABLE, parameters=tuple(alone)))
    results = {id: replace(one, model=one.model.withhold(unknown[id] | alike)) for id, one in results.items()}
    found, results = check_arm(results, recordings, terms)
    return Identification(results, (*doubts, *found), tuple(recording.name for recording in recordings))


def _join_names(recordings: Sequence[Recording]) -> str:
    return ", ".join(recording.name for recording in recordings)


def _measure_joints(recordings: Sequence[Recording], terms: Sequence[Term]) -> Segments:
    """Measure the one joint of a pendulum, with the states of the terms along the motion."""
    return [[(remember(m, terms),) for m in measure_segments(recording)] for recording in recordings]


def _limit_filters(
    schemes: Sequence[Regressor], segments: Segments
) -> tuple[tuple[Regressor, ...], tuple[Finding, ...]]:
    """Limit the filters of schemes to the sampling rate, and return a finding on each limited filter."""
    rate = min(joints[0].rate for own in segments for joints in own)
    slowed = tuple(_slow_filter(scheme, rate) for scheme in schemes)
    if slowed == tuple(schemes):
        return slowed, ()
    return slowed, (Finding(Kind.FILTER_SLOWED, {"rate": Quantity(rate, unit="Hz")}),)


def _withhold_estimates(
    results: dict[str, Identified], measurements: Sequence[Measurements], doubts: tuple[Finding, ...]
) -> tuple[dict[str, Identified], tuple[Finding, ...]]:
    """Remove estimates that the recordings do not determine, and return findings on them.

    What no scheme tells is said; a scheme that alone does not tell a parameter shows no number for it.
    """
    alone = {id: find_unidentifiable(own.model, measurements, doubts) for id, own in results.items()}
    unsaid = {id: {name for doubt in own for name in doubt.withheld} for id, own in alone.items()}
    of_all = set.intersection(*unsaid.values())
    doubts = (*doubts, *(doubt for doubt in next(iter(alone.values())) if of_all.issuperset(doubt.withheld)))
    known = {name for doubt in doubts for name in doubt.withheld}
    return {id: replace(own, model=own.model.withhold(known | unsaid[id])) for id, own in results.items()}, doubts


def _fit_schemes(
    schemes: Sequence[Regressor],
    segments: Segments,
    terms: Sequence[Term],
    recordings: Sequence[Recording],
    of: Callable[[Regressor, Joints], list[Regression]],
) -> dict[str, Identified]:
    """Fit each scheme to the segments of recordings; `of` makes regressions, see `make_regressions`."""
    joints, names = terms[0].mechanism.joints, _join_names(recordings)
    results: dict[str, Identified] = {}
    for scheme in schemes:
        data = stack(segments, partial(of, scheme), terms)
        if len(np.unique(data.clusters[data.usable])) < FEWEST:
            raise IdentificationError(
                f"{names}: too little of the motion is clear of stick and reversals: record longer, faster or wider "
                "motion"
            )
        hidden = np.setdiff1d(data.joint, data.joint[data.usable])
        if len(hidden):
            raise IdentificationError(
                f"{names}: joint '{joints[hidden[0]]}' is never clear of stick and reversals: record longer, "
                "faster or wider motion of it"
            )
        if scheme.borrows is not None and scheme.borrows not in results:
            raise ValueError(f"{scheme.id} borrows from {scheme.borrows}: put {scheme.borrows} before it")
        lender = results[scheme.borrows].model if scheme.borrows is not None else None
        results[scheme.id] = fit_equations(scheme, data, terms, lender)
    return results


def _slow_filter(scheme: Regressor, rate: float) -> Regressor:
    """Limit the filter of a scheme to one radian per sample if it is above the Nyquist frequency."""
    operator = scheme.operator if isinstance(scheme, Scheme) else None
    if isinstance(operator, LowPass) and operator.cutoff >= np.pi * rate:
        return replace(scheme, operator=replace(operator, cutoff=rate))  # type: ignore[type-var]
    return scheme
