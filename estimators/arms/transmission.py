"""What lies between motor and link of a joint where both sides were measured: how stiff it is, and how loose.

The motor's side has nothing of the links but what comes through the transmission:

    I q'' + b q' + fc sgn q' + k s + d s' = tau,    s = q - q_link beyond a play to either side of its middle

so that k, d and the play follow joint by joint, whatever the links are. Where both encoders disagree by a function of
the angle (scale, eccentricity), that looks like a spring that carries the links' weight: a deflection has to explain
more than a torque of the angle does, q and two harmonics of a turn.
Source: Spong, ASME Journal of Dynamic Systems 109(4), 1987.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares as search

from estimators.regression.equations import Equations
from estimators.regression.least_squares import Fit, least_squares, solve
from estimators.schemes.six import GUARD
from estimators.signals.differentiation import white_noise
from estimators.signals.measurements import choose_smoothing, measure
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Estimate
from pendulum_env.words import along


@dataclass(frozen=True)
class TransmissionSettings:
    """Numbers of the search for a transmission."""

    length: float = 0.5  # [s] of a cluster, longer than residuals stay correlated
    errors: float = 5.0  # standard errors of a play or a stiffness that make it significant
    worse: float = 1.1  # times the residual that is left without a play, from which there is one
    seen: float = 3.0  # times the noise of both encoders, from which a deflection is seen
    fewest: int = 100  # samples
    starts: tuple[float, ...] = tuple(np.linspace(0.05, 0.95, 13).tolist())  # quantiles of the deflection, as plays
    turns: int = 60  # of the search
    step: float = 1e-3  # of the deflection, for slopes by middle and play


ELASTIC = TransmissionSettings()


@dataclass(frozen=True)
class Transmission:
    """Between motor and link of a joint.

    Attributes:
        joint: its name.
        stiffness, damping: of the transmission beyond its play; None where neither is seen.
        play: from the middle to either side; None if there is none.
        left: torque that remains [N m].
        hindrance: why neither could be told; empty if they could.
    """

    joint: str
    stiffness: Estimate | None
    damping: Estimate | None
    play: Estimate | None
    left: float
    hindrance: str = ""

    @property
    def effect(self) -> str:
        """`joint_flexibility@elbow`, or `backlash@elbow`."""
        return f"{'joint_flexibility' if self.play is None else 'backlash'}@{self.joint}"

    @property
    def text(self) -> str:
        """`joint_flexibility@elbow: 120 ± 2 N m/rad, ...`."""
        if self.hindrance:
            return self.hindrance
        if self.stiffness is None or self.damping is None:
            return f"the transmission of {self.joint} is as stiff as its encoders can tell"
        play = "" if self.play is None else f", play {self.play} to either side"
        return f"{self.effect}: stiffness {self.stiffness}, damping {self.damping}{play}"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        parts = {"stiffness": self.stiffness, "damping": self.damping, "play": self.play}
        known = {name: None if own is None else own.json() for name, own in parts.items()}
        return {"joint": self.joint, **known, "torque_rms": self.left}


def find_transmissions(recordings: Sequence[ArmRecording], sliding: Collection[str] = ()) -> tuple[Transmission, ...]:
    """Transmissions of all joints of the recordings that have positions of their links, too; none without.

    Args:
        recordings: of an arm, some with `link_position`.
        sliding: joints that slide.

    Raises:
        IdentificationError: if a recording is too short.
    """
    both = [recording for recording in recordings if recording.link_position is not None]
    return tuple(_between(both, k, joint in sliding) for k, joint in enumerate(both[0].names if both else ()))


@dataclass(frozen=True)
class _Rows:
    """What was measured of both sides, clear of stick (R,) each, and the noise of the deflection [rad]."""

    motor: Array  # acceleration, velocity and its sign (R, 3)
    angle: Array  # functions of it (R, 5)
    deflection: Array
    rate: Array
    torque: Array
    clusters: Index
    noise: float

    @classmethod
    def of(cls, recordings: Sequence[ArmRecording], k: int) -> _Rows:
        parts: list[Array] = []
        clusters: list[Index] = []
        noise, first = [], 0
        for segment in (own for recording in recordings for own in recording.segments):
            assert segment.link_position is not None
            motor = segment.joints[k]
            link = replace(motor, position=segment.link_position[:, k])
            smoothing = max(choose_smoothing(motor), choose_smoothing(link), key=lambda own: own.half_width)
            m, beyond = measure(motor, smoothing), measure(link, smoothing)
            use = m.clear(GUARD)
            deflection, rate = m.position - beyond.position, m.velocity - beyond.velocity
            motion = (m.acceleration, m.velocity, np.sign(m.velocity), deflection, rate, m.torque)
            harmonics = (function(order * m.position) for order in (1, 2) for function in (np.sin, np.cos))
            parts.append(np.column_stack([*motion, m.position, *harmonics])[use])
            names, own = np.unique(m.time[use] // ELASTIC.length, return_inverse=True)
            clusters.append(first + own)
            first += len(names)
            noise.append(np.hypot(white_noise(motor.position), white_noise(link.position)))
        rows = np.concatenate(parts)
        moving = rows[:, :3], rows[:, 6:], rows[:, 3], rows[:, 4], rows[:, 5]
        return cls(*moving, np.concatenate(clusters), float(max(noise)))

    def columns(self, middle: float, play: float) -> Array:
        """Regressor (R, 5) with the transmission's two columns last."""
        off = self.deflection - middle
        beyond = off - np.clip(off, -play, play)
        return np.column_stack([self.motor, beyond, self.rate * (beyond != 0)])

    def is_elastic(self, middle: float, play: float) -> bool:
        """Whether the deflection surely explains more of the torque than the angle does."""
        phi = np.column_stack([self.columns(middle, play), self.angle])
        fit = solve(Equations(phi, self.torque), np.ones(len(phi)), self.clusters)
        return bool(fit.theta[3] > ELASTIC.errors * fit.std[3])

    def residual(self, shape: Array) -> Array:
        """Torque (R,) that is left with a middle and a play."""
        phi = self.columns(float(shape[0]), float(abs(shape[1])))
        return self.torque - phi @ least_squares(phi, self.torque)

    def fit(self, middle: float, play: float) -> tuple[Fit, Array]:
        """The fit with a middle and a play, and the standard errors of all parameters, of these two last (7,)."""
        phi, moved = self.columns(middle, play), ELASTIC.step * float(np.std(self.deflection))
        theta = least_squares(phi, self.torque)
        slopes = [
            (self.columns(middle + a, play + b) - self.columns(middle - a, play - b)) @ theta / (2 * moved)
            for a, b in ((moved, 0.0), (0.0, moved))
        ]
        jacobian = np.column_stack(slopes if play > 0 else slopes[:1])
        fit = solve(Equations(phi, self.torque), np.ones(len(phi)), self.clusters, jacobian)
        return fit, np.sqrt(np.diag(fit.covariance))


def _between(recordings: Sequence[ArmRecording], k: int, slides: bool) -> Transmission:
    """The transmission of a joint: elastic, or loose as well where a play surely leaves less."""
    joint, rows = recordings[0].names[k], _Rows.of(recordings, k)
    if len(rows.torque) < ELASTIC.fewest:
        hindrance = f"{joint} is hardly ever clear of stick and reversals: its transmission needs wider motion"
        return Transmission(joint, None, None, None, float("nan"), hindrance)
    size, unit_of = float(np.std(rows.deflection)), along if slides else str
    if size < ELASTIC.seen * rows.noise or size == 0:
        left = rows.torque - rows.motor @ least_squares(rows.motor, rows.torque)
        return Transmission(joint, None, None, None, float(np.sqrt(np.mean(left**2))))
    rigid = np.column_stack([rows.columns(0.0, 0.0), np.ones(len(rows.torque))])
    theta = least_squares(rigid, rows.torque)
    middle = -float(theta[-1] / theta[3]) if theta[3] else 0.0
    off = np.abs(rows.deflection - np.median(rows.deflection))
    plays = np.quantile(off, ELASTIC.starts).tolist()
    starts = [(float(np.median(rows.deflection)), play) for play in plays]
    best = min(starts, key=lambda shape: float(np.sum(rows.residual(np.array(shape)) ** 2)))
    found = search(rows.residual, best, x_scale=size, diff_step=1e-3, max_nfev=ELASTIC.turns).x
    (elastic, std), (loose, wide) = rows.fit(middle, 0.0), rows.fit(float(found[0]), float(abs(found[1])))
    play = Estimate(float(abs(found[1])), float(wide[-1]), unit_of("rad"))
    is_loose = (
        play.value > ELASTIC.errors * play.std
        and elastic.rms > ELASTIC.worse * loose.rms
        and loose.theta[3] > ELASTIC.errors * wide[3]
    )
    fit, errors = (loose, wide) if is_loose else (elastic, std)
    if not rows.is_elastic(*((float(found[0]), play.value) if is_loose else (middle, 0.0))):
        return Transmission(joint, None, None, None, fit.rms)
    stiffness, damping = (
        Estimate(float(fit.theta[n]), float(errors[n]), unit_of(unit)) for n, unit in ((3, "N m/rad"), (4, "N m s/rad"))
    )
    return Transmission(joint, stiffness, damping, play if is_loose else None, fit.rms)
