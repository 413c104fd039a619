"""Hidden effects and true parameters of recordings, in the names and signs of this project's models."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, sin, sqrt
from pathlib import Path
from typing import Any

from pendulum_env.recording import Recording, read_recording


@dataclass(frozen=True)
class Truth:
    """Entry of truth.json.

    Attributes:
        name: of the pair of recordings NAME.train.csv.gz and NAME.holdout.csv.gz.
        hidden: ids of the hidden effects, perhaps outside the library.
        parameters: true values of model parameters by name, for effects with the library's law.
        rate: sample rate [Hz].
        counts: encoder counts per turn; None for an exact encoder.
        noise: RMS of white noise on the torque [N m].
        excitation: its name, "" if unknown.
        share: residual of the refitted base model over the RMS torque; None if unknown.
    """

    name: str
    hidden: tuple[str, ...]
    parameters: Mapping[str, float]
    rate: float
    counts: int | None
    noise: float
    excitation: str = ""
    share: float | None = None

    @classmethod
    def of(cls, name: str, entry: Mapping[str, Any]) -> Truth:
        """Return the truth from an entry of truth.json."""
        shares = entry.get("effect_share")
        hidden, rate = tuple(entry["hidden"]), float(entry["rate_hz"])
        return cls(
            name=name,
            hidden=hidden,
            parameters=true_parameters(hidden, entry["plant"], entry["effect_parameters"], rate),
            rate=rate,
            counts=entry["encoder_counts"],
            noise=float(entry["torque_noise_rms"]),
            excitation=str(entry.get("excitation", "")),
            share=float(shares["train"]["refit"]) if shares else None,
        )

    @property
    def label(self) -> str:
        """Return the hidden effects as text."""
        return "+".join(self.hidden) or "nothing"


def read_truth(folder: str | Path) -> list[Truth]:
    """Read every entry of a folder's truth.json.

    Raises:
        FileNotFoundError: if there is no truth.json, or a recording that it names is missing.
    """
    entries: dict[str, Any] = json.loads((Path(folder) / "truth.json").read_text())
    for name in entries:
        for path in paths(folder, name):
            if not path.exists():
                raise FileNotFoundError(2, "truth.json names a recording that is not there", str(path))
    return [Truth.of(name, entry) for name, entry in entries.items()]


def paths(folder: str | Path, name: str) -> tuple[Path, Path]:
    """Return the paths of the fitted and the held-out recording."""
    return Path(folder) / f"{name}.train.csv.gz", Path(folder) / f"{name}.holdout.csv.gz"


def read_pair(folder: str | Path, name: str) -> tuple[Recording, Recording]:
    """Read both recordings of a case."""
    train, holdout = paths(folder, name)
    return read_recording(train), read_recording(holdout)


def true_parameters(
    hidden: tuple[str, ...], plant: Mapping[str, float], given: Mapping[str, Any], rate: float
) -> dict[str, float]:
    """Return the true values of model parameters, without effects outside the library or of other laws."""
    values = dict(plant)
    if given:  # empty for other simulators
        for id in hidden:
            values |= _effect_parameters(id, plant, given, rate)
    return values


def _effect_parameters(id: str, plant: Mapping[str, float], p: Mapping[str, Any], rate: float) -> dict[str, float]:
    """Return the parameters of one effect; offset, cogging and disturbance have opposite signs in plant and model."""
    match id:
        case "torque_offset":
            return {id: -p["offset"]}
        case "gravity_tilt":
            return {id: p["tilt_cos"]}
        case "coulomb_asymmetry":
            return {id: p["asym_c"]}
        case "viscous_asymmetry":
            return {id: p["asym_v"]}
        case "stribeck":
            law = p.get("strib_p", 2.0)
            given = {f"{id}.exponent": law} if law != 2.0 else {}
            return {id: p["strib_d"], f"{id}.stribeck_velocity": p["strib_v"], **given}
        case "quadratic_drag":
            return {id: p["drag"]}
        case "load_dependent_friction":
            return {id: p.get("load_mu", 0.0), f"{id}.output": p.get("load_out", 0.0), f"{id}.weight": 1.0}
        case "position_dependent_friction":
            return {f"{id}.sin": p["pos_s"], f"{id}.cos": p["pos_c"]}
        case "cogging":
            return {f"{id}.order": p["cog_n"], f"{id}.sin": -p["cog_s"], f"{id}.cos": -p["cog_c"]}
        case "torque_ripple":
            return {f"{id}.order": p["rip_n"], f"{id}.sin": -p["rip_s"], f"{id}.cos": -p["rip_c"]}
        case "spring":
            return {f"{id}.stiffness": p["spring_k"], f"{id}.preload": -p["spring_k"] * p["spring_q0"]}
        case "actuator_lag":
            return {f"{id}.time_constant": p["lag_T"]}
        case "dead_time":
            return {f"{id}.dead_time": p["dead_n"] / rate}
        case "torque_saturation" if p.get("sat_law", 0.0) == 0.0:
            return {f"{id}.limit": p["sat"]}
        case "friction_drift":
            share, warm_up = p["drift"]
            fluid = p.get("drift_b", 1.0) * share * plant["viscous"]
            return {f"{id}.viscous": fluid, f"{id}.coulomb": share * plant["coulomb"], f"{id}.warm_up": warm_up}
        case "payload_change":
            return {f"{id}.inertia": p["pay_I"], f"{id}.gravity": p["pay_mgl"], f"{id}.moment": p["pay_t"]}
        case "periodic_disturbance":
            a, phase = p["dist_a"], p["dist_ph"]  # a sin(wt + phase)
            return {f"{id}.sin": -a * cos(phase), f"{id}.cos": -a * sin(phase), f"{id}.frequency": p["dist_w"]}
        case "backlash" if p.get("bl_grip", 1.0) == 1.0:
            return _link(id, plant, p) | {f"{id}.gap": p["bl_gap"]}
        case "joint_flexibility":
            return _link(id, plant, p)
        case "presliding" if p.get("dahl_n", 1.0) == 1.0 and not p.get("dahl_d"):
            return {id: plant["coulomb"], f"{id}.displacement": plant["coulomb"] / p["dahl_sigma"]}
        case "encoder_eccentricity":
            e, phase = p["ecc"]  # e sin(q + phase)
            return {f"{id}.sin": e * cos(phase), f"{id}.cos": e * sin(phase)}
        case "hard_stop":
            both = p.get("wall_q")  # symmetric walls
            lower, upper = (-both, both) if both else (p.get("wall_lo"), p.get("wall_hi"))
            stops = {"lower": lower, "upper": upper}
            losses = {"hysteresis": p.get("wall_c"), "damping_time": p.get("wall_d", 0.0) / p["wall_k"]}
            shapes = {f"{id}.{name}": value for name, value in (stops | losses).items() if value}
            return {f"{id}.stiffness": p["wall_k"], **shapes}
    return {}


def _link(id: str, plant: Mapping[str, float], p: Mapping[str, Any]) -> dict[str, float]:
    inertia = plant["inertia"] - p["Jm"]  # of the link
    return {
        id: inertia,
        f"{id}.resonance": sqrt(p["bl_k"] / inertia),
        f"{id}.damping": p["bl_d"] / inertia,
        f"{id}.gravity": plant["gravity"] / inertia,
    }
