"""Each limit decides: its replacement by infinity, or by its other extreme, changes a decision."""

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import diagnose
from estimators.checks.alignment import Alignment
from estimators.checks.channel import ChannelFits
from estimators.checks.channel_rows import is_brake
from estimators.checks.closed_loop import find_feedback, have_one_frequency
from estimators.checks.homogeneity import find_disagreements, find_misfits, fit_each_recording
from estimators.checks.remedies import find_wrong_columns
from estimators.data.split import CutSettings, split_recordings
from estimators.decisions.criterion import Criterion
from estimators.diagnosis.treatments import narrow_windows
from estimators.selection import policies
from estimators.selection.candidates import screen_effect
from estimators.selection.evidence import Evidence
from estimators.selection.moves import add_effect, propose_pairs
from estimators.selection.path import find_model_path
from estimators.selection.process_noise import find_process_noise
from estimators.selection.state import SearchState
from estimators.signals.channel import Channel
from pendulum_env.physics import BASE, Model, effect
from pendulum_env.recording import Recording
from robots.servos.conclusion import find_speed_rate, find_torque_scale
from robots.servos.drive import ServoDrive
from robots.servos.in_loop.convention_fits import ConventionFit, choose_fit
from robots.servos.torque import compute_commanded_torque
from tests.cases import make_plain_model, recorded

EXPERIMENT = Experiment(rate=200.0, seconds=12.0, seed=2)
LOOP = Experiment(500.0, 12.0, "pd_loop", seed=2, counts=8192, torque_noise=0.02)
HIDDEN = {
    "": {},
    "stribeck": {"stribeck": {"strib_d": 0.4, "strib_v": 0.4}},
    "weak": {"stribeck": {"strib_d": 0.04, "strib_v": 0.4}},
}
STRIBECK, DRAG, COGGING = (effect(id)() for id in ("stribeck", "quadratic_drag", "cogging"))


@cache
def make_parts(id: str):
    """Return the training and held-out rows of a recording with one hidden effect, or none."""
    return split_recordings(recorded(Plant(effects=HIDDEN[id]), EXPERIMENT))


def make_evidence(criterion: Criterion, id: str) -> Evidence:
    library = {term.id: effect(term.id) for term in (STRIBECK, DRAG, COGGING)}
    return Evidence.from_data(*make_parts(id), criterion=criterion, library=library)


def decide_models(criterion: Criterion) -> dict[tuple[str, str, str], list[bool]]:
    """Return the passed gates of each policy, for each data set and candidate."""
    outcome = {}
    for id in ("", "weak", "stribeck"):
        evidence = make_evidence(criterion, id)
        for candidate in (STRIBECK, DRAG):
            terms = (*BASE, candidate)
            for name in ("ADD", "NEED", "CONFIRM", "SWAP", "TIE", "KEEP_BASE", "EXCITE", "FOLLOW"):
                decision = evidence.decide(terms, BASE, getattr(policies, name))
                outcome[name, id, candidate.id] = [gate.passed for gate in decision.gates]
        outcome["screen", id, ""] = [screen_effect(evidence, BASE, type(STRIBECK)).terms]
        outcome["noise", id, ""] = [evidence.residuals.is_noise(terms) for terms in (BASE, (*BASE, STRIBECK))]
    return outcome


OF_POLICIES = {
    "p_value": "ADD",
    "explained_share": "ADD",
    "needed_share": "NEED",
    "kept_inertia": "KEEP_BASE",
    "tie_probability": "TIE",
    "coarse_share": "screen",
    "least_excitation": "EXCITE",
    "z_score": "noise",
    "noise_ratio": "noise",
    "misfit_ratio": "FOLLOW",
    "accuracy": "FOLLOW",
}


@pytest.mark.parametrize(("limit", "policy"), OF_POLICIES.items())
def test_a_limit_of_models_decides_in_its_policy(limit, policy):
    changed = replace(Criterion(), **{limit: 1 - 1e-12 if limit == "p_value" else np.inf})
    before, after = decide_models(Criterion()), decide_models(changed)
    assert policy in {key[0] for key in before if before[key] != after[key]}


def with_limit(name: str, value: float) -> Criterion:
    """Return the criterion with another value of a limit, or of one of its records."""
    record, _, limit = name.rpartition(".")
    if not record:
        return replace(Criterion(), **{limit: value})
    return replace(Criterion(), **{record: replace(getattr(Criterion(), record), **{limit: value})})


@cache
def make_runs() -> tuple[Recording, ...]:
    """Return two equal runs, and one whose torque is logged with another factor."""
    runs = recorded(Plant(), *(replace(EXPERIMENT, seed=seed) for seed in (2, 3, 4)))
    return (*runs[:2], replace(runs[2], torque=1.5 * runs[2].torque))


def make_state(criterion: Criterion, *effects: str) -> SearchState:
    return SearchState(make_evidence(criterion, "stribeck"), BASE, (*BASE, *(effect(id)() for id in effects)))


def count_fits_of_orders(criterion: Criterion) -> int:
    """Return the number of models fitted to find the order of two effects that the data do not have."""
    evidence = make_evidence(criterion, "")
    fitted, fit = set(), evidence.fits.fit_with_std
    object.__setattr__(evidence.fits, "fit_with_std", lambda terms: fitted.add(terms) or fit(terms))
    find_model_path(SearchState(evidence, BASE, (*BASE, STRIBECK, DRAG)))
    return len(fitted)


def measure_gain(criterion: Criterion) -> float:
    parts = split_recordings(recorded(Plant(effects=HIDDEN["weak"]), EXPERIMENT), criterion=criterion)
    return Evidence.from_data(*parts, criterion=criterion).gain((*BASE, STRIBECK), BASE).p_value


def shorten_windows(criterion: Criterion) -> float:
    """Return the factor on the windows of a search that explains the torque, but not the motion."""
    evidence = SimpleNamespace(
        criterion=criterion,
        residuals=SimpleNamespace(is_noise_by_part=lambda terms: (True, True)),
        motion=SimpleNamespace(is_misfit=lambda step: True),
    )
    data = SimpleNamespace(actions=[], cut=CutSettings(), with_treatment=lambda finding, cut: cut.window_share)
    model, result = SimpleNamespace(has_known_inertia=True), SimpleNamespace(terms=BASE, steps=[0])
    return narrow_windows(SimpleNamespace(evidence=evidence, data=data, model=model, result=result))


def find_noise(criterion: Criterion) -> bool:
    train = make_parts("")[0]
    return find_process_noise(train.data, train.residual(BASE), 0.09, criterion.white) is not None


def count_shifts(criterion: Criterion, share: float) -> int:
    """Return the number of laws of a noisy log that is late by a share of a sample."""
    run = make_runs()[0]
    noise = np.random.default_rng(0).normal(0.0, 0.6 * share, len(run))
    late = (1 - share) * run.torque + share * np.append(run.torque[:1], run.torque[:-1]) + noise
    fits = ChannelFits.from_recordings([replace(run, torque=late)], criterion=criterion)
    return 0 if fits is None else len(fits.fit_shifts())


def swing_at(frequency: float) -> Recording:
    time = np.arange(4000) / 200.0
    return Recording(time, np.sin(2 * np.pi * frequency * time), 0 * time, name=f"{frequency} Hz")


def list_disagreements(criterion: Criterion) -> list[int]:
    train, holdout = split_recordings(make_runs()[:2], make_runs()[2:])
    return [d.number for d in find_disagreements(fit_each_recording([train.data, holdout.data], BASE, criterion))]


def list_explained(criterion: Criterion) -> list[bool]:
    return [fit.is_explained for fit in fit_each_recording([make_parts("stribeck")[0].data], BASE, criterion)]


def list_poor(criterion: Criterion) -> list[int]:
    datasets = [make_parts(id)[0].data for id in ("", "weak")]
    return [misfit.recording for misfit in find_misfits(fit_each_recording(datasets, BASE, criterion))]


def find_upright_zero(criterion: Criterion) -> int:
    recording = swing_at(0.2)
    recording = replace(recording, torque=np.ones(len(recording)))
    model = Model.build(BASE, np.array([0.1, -0.5, 0.1, 0.1]), np.full(4, 1e-3))
    return len(find_wrong_columns(model, [recording], criterion))


def opposes_motion(criterion: Criterion) -> bool:
    velocity = np.r_[np.ones(19), -1.0]
    samples = SimpleNamespace(velocity=velocity, load=SimpleNamespace(torque=np.full(20, -1.0)))
    return is_brake(SimpleNamespace(samples=samples), criterion.columns)


def choose_convention(criterion: Criterion, gains: Sequence[float]) -> tuple[str, str]:
    """Return the kept convention and its alternative, of fits with some gains in each of ten blocks [nat]."""
    rows = SimpleNamespace(layout=SimpleNamespace(scored=SimpleNamespace(of_block=np.zeros(10, dtype=int))))
    fits = [ConventionFit({"reads": str(k)}, rows, BASE, np.full(10, gain)) for k, gain in enumerate(gains)]
    choice = choose_fit(fits, ("reads",), criterion.loop.counts_p_value, criterion)
    return choice.fit.settings["reads"], choice.alternative.settings["reads"]


def imitates_inertia(criterion: Criterion) -> bool:
    drive = ServoDrive(output="torque", kp=5.0, kd=1.0, limit=6.0)
    servo = SimpleNamespace(drive=drive)
    return find_speed_rate(make_plain_model(), [servo], criterion.loop) is not None


def has_wrong_scale(criterion: Criterion) -> bool:
    goal = np.sin(np.arange(400) / 50.0)
    drive = ServoDrive(output="torque", kp=5.0, limit=6.0, rate=200.0)
    recording = Recording(np.arange(400) / 200.0, 0 * goal, 0 * goal, drive=drive, reference=goal)
    recording = replace(recording, torque=1.5 * compute_commanded_torque(recording))
    return find_torque_scale([recording], criterion.loop) is not None


def find_turned_load(criterion: Criterion) -> int:
    """Return the number of findings on a load torque that is logged with the opposite sign."""
    hidden = {"periodic_disturbance": {"dist_a": 0.9, "dist_w": 4.3, "dist_ph": 0.4}}
    (run,) = recorded(Plant(effects=hidden), EXPERIMENT)
    run = replace(run, load_torque=-0.9 * np.sin(4.3 * run.time + 0.4))
    return len(find_wrong_columns(make_plain_model(), [run], criterion))


def measure_score(criterion: Criterion) -> float:
    runs = recorded(Plant(effects=HIDDEN["stribeck"]), EXPERIMENT)
    return diagnose(runs, only=["stribeck"], criterion=criterion).candidates[0].score


# decision by one limit, and the extreme that replaces it
DECISIONS: dict[str, tuple[float, Callable[[Criterion], object]]] = {
    "block": (4.0, measure_gain),
    "drift_piece": (2.0, lambda c: make_evidence(c, "weak").densities.compute_refitted(BASE).sum()),
    "shorter_window": (np.inf, shorten_windows),
    "equal_error_share": (-np.inf, lambda c: count_shifts(c, 0.08)),
    "search.max_effects": (0, lambda c: make_state(c).has_room(1)),
    "search.n_restarts": (0, lambda c: len(list(propose_pairs(make_state(c))))),
    "search.max_tried": (0, lambda c: add_effect(make_state(c)) is None),
    "search.max_ordered": (0, count_fits_of_orders),
    "white.p_value": (np.inf, find_noise),
    "white.most_hidden": (0.0, find_noise),
    "timing.z_score": (np.inf, lambda c: Alignment(Channel(1e-3), 1e-4, 0.0, criterion=c).is_determined),
    "timing.negligible": (np.inf, lambda c: count_shifts(c, 0.5)),
    "timing.correlation": (np.inf, lambda c: len(find_feedback(recorded(Plant(), LOOP), c))),
    "timing.same_ratio": (np.inf, lambda c: have_one_frequency([swing_at(1.0), swing_at(2.0)], c)),
    "agreement.false_alarm": (0.0, list_disagreements),
    "agreement.difference": (np.inf, list_disagreements),
    "agreement.least_windows": (np.inf, list_disagreements),
    "agreement.least_freedom": (np.inf, list_disagreements),
    "agreement.explained": (np.inf, list_explained),
    "agreement.unexplained": (0.0, list_poor),
    "columns.upright_share": (np.inf, find_upright_zero),
    "columns.driven_share": (np.inf, opposes_motion),
    "columns.turned_share": (np.inf, find_turned_load),
    "max_score": (0.5, measure_score),
    "loop.counts_p_value": (-np.inf, lambda c: choose_convention(c, (0.0, 1.0))),
    "loop.same": (np.inf, lambda c: choose_convention(c, (0.0, 0.0, 0.1))),
    "loop.slow_rate": (np.inf, imitates_inertia),
    "loop.torque_scale": (np.inf, has_wrong_scale),
}
# decide in whole diagnoses alone, which take too long here
OF_DIAGNOSES = {
    "white.longest_lag",
    "timing.least_sampled",
    "agreement.scheme_difference",
    "loop.needed",
    "loop.dominant",
    "loop.faithful",
}


@pytest.mark.parametrize("limit", DECISIONS)
def test_a_limit_decides(limit):
    extreme, choose = DECISIONS[limit]
    assert choose(with_limit(limit, extreme)) != choose(Criterion())


def test_each_limit_has_a_decision():
    limits = {field.name for field in fields(Criterion) if not is_dataclass(getattr(Criterion(), field.name))}
    for record in {field.name for field in fields(Criterion)} - limits:
        limits |= {f"{record}.{field.name}" for field in fields(getattr(Criterion(), record))}
    assert limits == OF_POLICIES.keys() | DECISIONS.keys() | OF_DIAGNOSES
