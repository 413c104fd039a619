"""Stages of decisions between models: each function makes the gates of one question about two models.

`after` is the model that may take the place of `before`; often it has one effect more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from estimators.checks.signs import compute_significant_sign
from estimators.data.variants import compute_unique_share, rank_variants
from estimators.decisions.errors import Step
from estimators.decisions.gate import Gate, limit_gain, limit_p_value, limit_tie, limit_total
from estimators.decisions.score import Bootstrap, Gain
from estimators.regression.least_squares import Fit, compute_widening, invert_covariance
from estimators.selection.evidence import Evidence, Hypothesis, adds_dry_friction
from estimators.selection.physical import find_violations
from pendulum_env._typing import Array
from pendulum_env.physics import SIGNIFICANT, Model, Samples, Term, has_link, has_stop, list_ids, list_loads
from pendulum_env.physics.terms import count_parameters, list_forms


def require_gain(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the gain in prediction: above its penalty, and with a small p-value; see `Evidence.best_gain`."""
    yield from _limit_gain(after.evidence.best_gain(after.terms, before.terms), after, before)


def require_p_value(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the p-value of the gain in prediction; see `Evidence.best_gain`."""
    p_value = after.evidence.best_gain(after.terms, before.terms).p_value
    yield limit_p_value("p_value", p_value, after.evidence.criterion.p_value)


def require_gain_in_torque(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the gain in prediction by rows alone; link states may differ, and treatments that leave the same rows."""
    if not have_same_rows(after, before):
        yield Gate("same_rows", 0, 1, False)
        return
    bootstrap, (new, old) = _compare_densities(after, before)
    gain = bootstrap.gain(new, old, before.evidence.penalty(after.terms, before.terms))
    yield from _limit_gain(gain, after, before)


def have_same_rows(after: Hypothesis, before: Hypothesis) -> bool:
    """Return whether the blocks of two models have equal numbers of rows; densities are sums over rows."""
    if after.evidence is before.evidence:
        return True
    counts = ([np.bincount(p.layout.scored.block) for p in each.evidence.fits.parts] for each in (after, before))
    return all(np.array_equal(new, old) for new, old in zip(*counts, strict=True))


def _compare_densities(after: Hypothesis, before: Hypothesis) -> tuple[Bootstrap, list[Array]]:
    """Return random weights of the blocks by which two models are compared, and the densities of both there."""
    if after.evidence is before.evidence:
        return after.evidence.densities.compare(after.terms, before.terms)
    densities = [each.evidence.densities.compute(each.terms) for each in (after, before)]
    return before.evidence.densities.bootstrap, densities


def _limit_gain(gain: Gain, after: Hypothesis, before: Hypothesis) -> list[Gate]:
    """Make the gates on the gain of one model over another."""
    evidence = before.evidence
    return limit_gain(gain, evidence.penalty(after.terms, before.terms), evidence.criterion.p_value)


def require_gain_held_out(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the p-value of the gain on held-out data alone.

    Folds of the training data may lack angles of the part that they predict, and favour laws with few parameters.
    """
    bootstrap, (new, old) = after.evidence.densities.compare_held_out(after.terms, before.terms)
    gain = bootstrap.gain(new, old, after.evidence.penalty(after.terms, before.terms))
    yield limit_p_value("p_value", gain.p_value, after.evidence.criterion.p_value)


def require_known_parameters(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the gain over `before` with its known parameters free; else `after` imitates other values of them."""
    evidence = after.evidence
    if (freed := evidence.fits.release_known(before.terms)) != before.terms:
        yield limit_p_value(
            "known_parameters", evidence.best_gain(after.terms, freed).p_value, evidence.criterion.p_value
        )


def require_tie(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the probability of `after` in the place of `before`; zero if their rows differ."""
    probability, least = 0.0, after.evidence.criterion.tie_probability
    if have_same_rows(after, before):
        bootstrap, densities = _compare_densities(after, before)
        probability = float(bootstrap.probabilities(densities)[0])
    yield limit_tie(probability, least)


def require_share(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the share of the residual torque, or of the motion error, that `after` explains."""
    least = after.evidence.criterion.explained_share
    share = after.evidence.shares.compute(after.terms, before.terms, least)
    yield Gate("explained_share", share, least, share > least)


def require_share_of_torque(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the share of the residual torque alone."""
    least = after.evidence.criterion.explained_share
    share = after.evidence.shares.compute_of_torque(after.terms, before.terms)
    yield Gate("explained_share", share, least, share > least)


def require_needed_share(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the same share with the limit `Criterion.needed_share`.

    If `after` leaves structure, the share is that of all torque above the noise floor: an unknown law may cause a
    correlated part, and slow torque, which dominates the error of free motion. This error counts for effects that
    torque does not show.
    """
    evidence, least, terms = after.evidence, after.evidence.criterion.needed_share, (after.terms, before.terms)
    if evidence.residuals.is_noise(after.terms) or evidence.gain(*terms).p_value > evidence.criterion.p_value:
        name, share = "explained_share", evidence.shares.compute(*terms, least)
    else:
        name, share = "share_above_floor", evidence.shares.compute_of_torque(*terms, above_floor=True)
    yield Gate(name, share, least, share > least)


def require_parameters(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the coefficients of the added effects, see `compute_coefficient_chance`, and the base parameters.

    Models with a link, and effects that only free motion shows, have no gate on coefficients. Dry friction that the
    torque of few windows does not determine passes if free motion shows it.
    """
    evidence, terms, criterion = after.evidence, (after.terms, before.terms), after.evidence.criterion
    if not has_link(after.terms) and evidence.gain(*terms).p_value <= criterion.p_value:
        train = evidence.train
        fit = train.equations(after.terms).fit(train.layout.clusters)
        chance = compute_coefficient_chance(after.terms, fit, list_ids(before.terms))
        if chance > criterion.p_value and adds_dry_friction(*terms):
            chance = evidence.gain_in_friction(*terms).p_value
        yield limit_p_value("coefficients", chance, evidence.criterion.p_value)
    yield from require_base(after, before)


def compute_coefficient_chance(terms: Sequence[Term], fit: Fit, known: frozenset[str]) -> float:
    """Return the largest p-value of Hotelling's tests that all coefficients of a term without a `known` id are zero.

    Nonlinear parameters are given. Few blocks may be predicted better by chance with an effect that the data do not
    determine. The degrees of freedom are the mean of those of the coefficients.

    Source: Pustejovsky and Tipton, Journal of Business and Economic Statistics 36(4), 2018.
    """
    owner, chance = np.array([term.id for term in terms for _ in term.columns]), 0.0
    for id in set(owner.tolist()) - known:
        of_term = (owner == id) & (fit.std > 0)  # others are known, or at their bounds
        if not of_term.any():
            continue
        count, freedom = np.count_nonzero(of_term), float(np.mean(fit.freedom[of_term]))
        scaled = fit.theta[of_term] * compute_widening(fit.freedom[of_term])  # the covariance without its widening
        square = scaled @ invert_covariance(fit.covariance[np.ix_(of_term, of_term)]) @ scaled
        second = max(1.0, freedom - count + 1)
        chance = max(chance, float(scipy.special.fdtrc(count, second, square * second / (freedom * count))))
    return chance


def require_base(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the base parameters that a larger model of a pendulum keeps, see `compare_base`.

    A missing law of the angle biases the inertia of the smaller model. An effect of the angle may then keep the inertia
    that a table of the angle leaves, if this differs by more than 3 standard errors.
    """
    evidence = after.evidence
    larger, smaller = (evidence.fits.fit_model_with_std(each.terms) for each in (after, before))
    known = list_ids(before.terms)
    is_of_angle = all(term.kind == "potential" for term in after.terms if term.id not in known)
    for gate in compare_base(larger, smaller, evidence.train.motions, evidence.criterion.kept_inertia):
        is_lost = gate.name == "kept_inertia" and not gate.passed
        yield _compare_beside_tables(gate, smaller, evidence) if is_lost and is_of_angle else gate


def _compare_beside_tables(gate: Gate, smaller: Model, evidence: Evidence) -> Gate:
    """Return the gate of a lost inertia, by the inertia beside a table of the angle if that differs significantly."""
    old, total = smaller.estimates["inertia"], _compute_mean_inertia(smaller, evidence.train.motions[""])
    for table in (table for table in evidence.tables if table.kind == "potential"):
        for variant in rank_variants(evidence.train, tuple(smaller.terms), table)[:1]:
            beside = evidence.fits.fit_model_with_std(variant.terms)
            new = beside.estimates["inertia"]
            if new.is_significant and old.value - new.value > SIGNIFICANT * float(np.hypot(old.std, new.std)):
                share = gate.value * total / _compute_mean_inertia(beside, evidence.train.motions[""])
                return replace(gate, value=share, passed=share >= gate.limit)
    return gate


def compare_base(after: Model, before: Model, motions: Mapping[str, Samples], least_inertia: float) -> list[Gate]:
    """Return gates on the shares of inertia and of gravity that a larger model of a pendulum keeps.

    A model that loses inertia or gravity of the smaller model imitates the joint. A lag T before inertia J and friction
    b has the transfer function 1 / ((1 + T s) (J s + b)), in which T and J/b change places: a lag of J/b leaves T b of
    the inertia. Without the lag, a fit finds about J + T b, so that a lag shorter than J/b keeps more than half of the
    inertia, and its imitation less; a longer lag cannot be distinguished from its imitation. A spring with negative
    gravity imitates a hardening spring.

    Inertia, also a known one, must keep the share `least_inertia` of the smallest value within 3 standard errors of the
    smaller model. It includes the inertia that effects add, as a mean over the motion. Gravity must keep its sign where
    the smaller model determines it, within 3 standard errors of the larger model: an effect may explain all of the
    gravity. With another weight, as a tilt, it may have any sign. Its standard error may not exceed its former value:
    effects of the angle that leave it undetermined cancel it and imitate another law. Models with a link have no gates,
    as they are uncertain before the link's states are fitted. `motions` are the samples of joints, by name.
    """
    gates: list[Gate] = []
    shared = before.estimates.keys() & after.estimates.keys()
    if has_link(after.terms):
        return gates
    if "inertia" in shared and (old := before.estimates["inertia"]).is_significant and old.value > 0:
        new = after.estimates["inertia"]
        total = _compute_mean_inertia(before, motions[""])
        share = _compute_mean_inertia(after, motions[""]) / total
        limit = least_inertia * (1 - SIGNIFICANT * old.std / total)
        gates.append(Gate("kept_inertia", share, limit, share >= limit, std=new.std / total))
    if "gravity" in shared and compute_significant_sign(before, "gravity"):
        old, new = before.estimates["gravity"], after.estimates["gravity"]
        share, std = new.value / old.value, new.std / abs(old.value)
        keeps_sign = any(term.is_weight for term in after.terms) or share + SIGNIFICANT * std >= 0
        gates.append(Gate("kept_gravity", share, 0.0, keeps_sign and std <= 1.0, std=std))
    return gates


def _compute_mean_inertia(model: Model, x: Samples) -> float:
    """Return the inertia of a model of a pendulum with all its effects, mean over samples (N,) [kg m^2]."""
    masses = [float(np.mean(column.mass(x))) for column in model.columns]
    return float(model.theta @ np.array(masses))


def require_lower_errors(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test physical bounds and held-out errors, see `compare_errors`: of steps, or of fits to torque, else to motion.

    If only free motion shows the effects, torque errors may rise by `Criterion.equal_error_share`. Bounds that a fit
    without standard errors violates are tested again with these. The error of the position may rise if torque
    shows the effects, and the free motion of all segments is not significantly worse.
    """
    evidence, criterion = after.evidence, after.evidence.criterion

    def compare(new: Step, old: Step, has_motion: bool = True) -> list[Gate]:
        terms, train = (new.model.terms, old.model.terms), evidence.train
        is_hidden = evidence.gain(*terms).p_value > criterion.p_value and evidence.may_act_at_rest(*terms)
        margin = criterion.equal_error_share if is_hidden else 0.0
        gates = compare_errors(new, old, train.motions, train.recorded_motions, margin, has_motion)
        if not gates[0].passed and not any(estimate.std for estimate in new.model.estimates.values()):
            new = replace(new, model=evidence.fits.fit_with_std(new.model.terms).model)
            gates = compare_errors(new, old, train.motions, train.recorded_motions, margin, has_motion)
        return gates

    new, old = after.step, before.step
    gates = compare(new, old)
    if after.fitted is None and before.fitted is None and not all(gate.passed for gate in gates):
        gates = compare(evidence.fits.refit_to_motion(new), evidence.fits.refit_to_motion(old))
    if gates[-1].name == "holdout_position" and not gates[-1].passed:
        terms = new.model.terms, old.model.terms
        loss = evidence.motion.compare(*terms[::-1])[0]
        if loss.error and evidence.gain(*terms).p_value <= criterion.p_value:
            is_small = loss.p_value > criterion.p_value
            gates = [Gate("loss_in_motion", loss.p_value, criterion.p_value, is_small)]
            gates += compare(new, old, has_motion=False) if is_small else []
    yield from gates


def compare_errors(
    after: Step,
    before: Step,
    motions: Mapping[str, Samples],
    recorded: Mapping[str, Samples] | None = None,
    torque_margin: float = 0.0,
    has_motion: bool = True,
) -> list[Gate]:
    """Return the gates of a step over a smaller one: physical bounds, then held-out errors, up to the first failure.

    All violated bounds are returned. Held-out errors have to be below those of `before`: positions first, then torque
    of each joint with changed terms. Unknown errors have no gate, nor have positions without `has_motion`. Torque
    errors may exceed their limit by the relative `torque_margin`. `motions` and `recorded` are samples of the training
    data, as of `find_violations`.
    """
    new, old = after.errors["holdout"], before.errors["holdout"]
    common = list_forms(after.model.terms) & list_forms(before.model.terms)
    others = [term for step in (after, before) for term in step.model.terms if list_forms([term]).isdisjoint(common)]
    joints = {joint for term in others for joint in list_loads(term.at)} or set(motions)
    if violated := find_violations(after.model, {at: x for at, x in motions.items() if at in joints}, recorded):
        return violated
    for term in (term for term in after.model.terms if list_forms([term]).isdisjoint(common) and term.columns):
        if not any(after.model.estimates[column.name].value for column in term.columns):
            return [Gate("size", 0, 0, False)]
    gates = [Gate("physical_bounds", 0, 0, True)]
    angle, kinds = after.model.units().unit("rad"), [kind for kind in new.kinds if kind != "torque_rms" and has_motion]
    errors = [(kind.removesuffix("_rms"), new.get_error(kind), old.get_error(kind), angle) for kind in kinds]
    for joint_name in (joint for joint in new.joints if joint in joints):
        unit = after.model.units(joint_name).unit("N m")
        limit = (1.0 + torque_margin) * old.get_joint_error(joint_name)
        errors.append(
            (f"torque@{joint_name}" if joint_name else "torque", new.get_joint_error(joint_name), limit, unit)
        )
    for name, error, limit, unit in errors:
        if not np.isnan([error, limit]).any() and all(gate.passed for gate in gates):
            gates.append(Gate(f"holdout_{name}", error, limit, error < limit, unit))
    return gates


def require_better_form(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that the models differ in the form of one effect alone, and that the new form lowers held-out errors.

    The form must lower the torque error; the effect must lower all errors.
    """
    evidence, terms = after.evidence, (after.terms, before.terms)
    ids = {id for id, *_ in list_forms(after.terms) ^ list_forms(before.terms)}
    is_form = list_ids(after.terms) == list_ids(before.terms) and evidence.train.layout.predicts_torque
    n_changed = len(ids) if is_form else 0
    yield Gate("changed_forms", n_changed, 1, n_changed == 1)
    if n_changed == 1:
        (effect,) = (term for term in after.terms if term.id in ids)
        new, old = (evidence.fits.fit(each).errors["holdout"].get_joint_error(effect.at) for each in terms)
        yield Gate("holdout_torque", new, old, new < old, evidence.train.units(effect.at).unit("N m"))
        if new < old:
            without = tuple(term for term in after.terms if term is not effect)
            yield from require_lower_errors(after, Hypothesis(evidence, without))


def require_gain_of_parameters(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the gain of the parameters of a step over those of another on held-out torque."""
    yield limit_total(_compare_parameters(after, before))


def require_no_loss(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that the parameters of a step do not predict held-out torque significantly worse."""
    p_value, least = _compare_parameters(before, after).p_value, after.evidence.criterion.p_value
    yield Gate("loss_p_value", p_value, least, p_value > least)


def _compare_parameters(after: Hypothesis, before: Hypothesis) -> Gain:
    """Return the gain of the parameters of a step over those of another on held-out torque."""
    densities = (each.evidence.densities.predict_held_out(each.step.model) for each in (after, before))
    return after.evidence.densities.compare_parameters(*densities)


def require_lower_position(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the held-out error of free-running motion; it fails without motion."""
    new, old = (each.step.errors["holdout"].position_rms for each in (after, before))
    yield Gate("holdout_position", new, old, new < old, after.step.model.units().unit("rad"))


def require_determined_lag(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test a lag or delay that a larger model adds, if the motion may not determine it.

    In motion of one frequency it is not determined (`frequencies`). In a closed loop its residual must be noise:
    the controller reacts to each torque that the model lacks, and a lag or delay fits this reaction.
    """
    residuals, ids = after.evidence.residuals, list_ids(before.terms)
    if any(term.delays_torque and term.id not in ids for term in after.terms):
        if residuals.has_one_frequency:
            yield Gate("frequencies", 1, 2, False)
        elif residuals.has_feedback:
            size, limit = residuals.relative_rms(after.terms), after.evidence.criterion.misfit_ratio
            yield Gate("residual_in_loop", size, limit, size <= limit)


def require_excitation(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the recorded torque over the smallest significant torque of the last term of `after`.

    N rows with residual s of `after` show a torque of which a share u is outside the span of the other terms with a
    standard error of s / (u sqrt(N)).
    """
    *others, term = after.terms
    evidence, train = after.evidence, after.evidence.train
    rows, least = train.locate_rows(term.at), evidence.criterion.least_excitation
    residual, recorded = train.residual(after.terms)[rows], train.equations(others).y[rows]
    if not recorded.any():  # a free swing
        recorded = train.data.torque.applied[rows]
    noise, torque = (float(np.sqrt(np.mean(series**2))) for series in (residual, recorded))
    share = compute_unique_share(train, others, term)
    value = torque * share * len(residual) ** 0.5 / max(SIGNIFICANT * noise, 1e-300)
    yield Gate("excitation", value, least, value > least)


def require_noise(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that the residual of `after` is noise."""
    is_noise = after.evidence.residuals.is_noise(after.terms)
    yield Gate("noise", float(is_noise), 1, is_noise)


def require_fewer_parameters(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the number of parameters."""
    new, old = count_parameters(after.terms), count_parameters(before.terms)
    yield Gate("parameters", new, old, new < old)


def require_motion(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that `after` is no misfit to the motion."""
    evidence = after.evidence
    is_misfit = evidence.motion.is_misfit(after.fitted) if after.fitted else evidence.motion.has_misfit(after.terms)
    yield Gate("motion_misfit", float(is_misfit), 0, not is_misfit)


def require_stop(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that `after` has a stop, since only that explains the torque of a contact."""
    yield Gate("stops", float(has_stop(after.terms)), 1, has_stop(after.terms))


def require_inertia(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that the inertia of `after` is significant, by which its windows are cut; a link has its own inertia."""
    if not has_link(after.terms):
        step = after.fitted or after.evidence.fits.fit_with_std(after.terms)
        inertia, unit = step.model.estimates["inertia"], after.evidence.train.units().unit("kg m^2")
        yield Gate("inertia", inertia.value, SIGNIFICANT * inertia.std, inertia.is_significant, unit, inertia.std)


def require_motion_share(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that `before` does not follow the motion significantly better."""
    share = after.evidence.motion.compute_shares(before.terms, after.terms)[0]
    most = after.evidence.criterion.explained_share
    yield Gate("motion_share", share, most, share <= most)


def require_simpler_table(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that a model with a table has fewer parameters, or replaces two or more effects that leave structure."""
    n_replaced = _count_replaced(after, before)
    if n_replaced > 1 and not after.evidence.residuals.is_noise(before.terms):
        yield Gate("replaced_effects", n_replaced, 1, True)
    else:
        yield from require_fewer_parameters(after, before)


def _count_replaced(after: Hypothesis, before: Hypothesis) -> int:
    """Return the number of terms that a model lacks of another, if it leaves only noise; else 0."""
    n_replaced = len(set(list_ids(before.terms)) - set(list_ids(after.terms)))
    return n_replaced if after.evidence.residuals.is_noise(after.terms) else 0


def require_share_of_table(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test the explained share of a table: of the noise, or most of the structure that effects leave.

    If the table leaves structure, too, most of all torque above the noise floor. A table that leaves only noise in the
    place of two or more effects needs no share.
    """
    residuals, criterion = after.evidence.residuals, after.evidence.criterion
    if (n_replaced := _count_replaced(after, before)) > 1:
        yield Gate("replaced_effects", n_replaced, 1, True)
        return
    is_noise, leaves_noise = (residuals.is_noise(each.terms) for each in (before, after))
    above_floor = not (is_noise or leaves_noise)
    share = after.evidence.shares.compute_of_torque(after.terms, before.terms, above_floor=above_floor)
    least = criterion.explained_share if is_noise else criterion.needed_share
    yield Gate("explained_share", share, least, share > least)
