"""Two-link arm by its textbook equations, integrated by SciPy between events; shares no code with the packages.

Joint angles are relative, q = 0 hangs down. Each joint has viscous and set-valued dry friction: it sticks at zero
velocity while its reaction is within +-fc. The torque of each joint is a smooth multisine; recordings hold its mean
over each period, as a DAC would.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81
LEAST_SPEED = 1e-12  # [rad/s], to detect the start of sliding

Signal = Callable[[float], Sequence[float]]  # torques [N m] at a time [s]


@dataclass(frozen=True)
class TwoLink:
    mass: tuple[float, float] = (1.2, 0.8)  # [kg]
    length: float = 0.45  # of the upper arm [m]
    center: tuple[float, float] = (0.2, 0.15)  # of mass, from the joint [m]
    inertia: tuple[float, float] = (0.02, 0.008)  # about the centre of mass [kg m^2]
    viscous: tuple[float, float] = (0.3638, 0.3638)  # the paper's Table 2, at each joint
    coulomb: tuple[float, float] = (0.9163, 0.9163)
    drag: tuple[float, float] = (0.0, 0.0)  # quadratic air drag [N m s^2/rad^2]
    cogging: tuple[float, float] = (0.0, 0.0)  # amplitude at twelve periods per turn [N m]

    def urdf(self) -> str:
        """Return the arm as URDF, with axes for the same gravity torque."""
        links = "".join(
            f'<link name="{name}"><inertial><origin xyz="0 0 {-c}"/><mass value="{m}"/>'
            f'<inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i / 10}"/></inertial></link>'
            for name, m, c, i in zip(("upper", "fore"), self.mass, self.center, self.inertia, strict=True)
        )
        joints = "".join(
            f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 {z}"/><axis xyz="0 -1 0"/></joint>'
            for name, parent, child, z in (("shoulder", "base", "upper", 0.0), ("elbow", "upper", "fore", -self.length))
        )
        return f'<robot name="two-link"><link name="base"/>{links}{joints}</robot>'

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        m11, m12, m22 = self._masses(*q)
        return np.array([[m11, m12], [m12, m22]])

    def bias(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return C(q, q') q' + g(q)."""
        return np.array(self._bias(*q, *v))

    def energy(self, q: np.ndarray, v: np.ndarray) -> float:
        (m1, m2), (c1, c2), l1 = self.mass, self.center, self.length
        height = -(m1 * c1 + m2 * l1) * np.cos(q[0]) - m2 * c2 * np.cos(q[0] + q[1])
        return float(0.5 * v @ self.mass_matrix(q) @ v + GRAVITY * height)

    def _masses(self, q1: float, q2: float) -> tuple[float, float, float]:  # 11, 12, 22
        (m1, m2), (c1, c2), (i1, i2), l1 = self.mass, self.center, self.inertia, self.length
        coupled = m2 * l1 * c2 * cos(q2)
        m22 = m2 * c2**2 + i2
        return m1 * c1**2 + i1 + m2 * l1**2 + m22 + 2 * coupled, m22 + coupled, m22

    def _bias(self, q1: float, q2: float, v1: float, v2: float) -> tuple[float, float]:
        (m1, m2), (c1, c2), l1 = self.mass, self.center, self.length
        h = m2 * l1 * c2 * sin(q2)
        g2 = m2 * c2 * GRAVITY * sin(q1 + q2)
        g1 = (m1 * c1 + m2 * l1) * GRAVITY * sin(q1) + g2
        return g1 - h * (2 * v1 + v2) * v2, g2 + h * v1**2

    def accelerations(
        self, x: Sequence[float], torque: Sequence[float], sliding: Sequence[float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return accelerations with friction in directions `sliding`, and reactions of stuck joints (0 there)."""
        q, v = x[:2], x[2:]
        bias = self._bias(*q, *v)
        r1, r2 = (
            torque[k]
            - bias[k]
            - (self.viscous[k] + self.drag[k] * abs(v[k])) * v[k]
            - self.cogging[k] * sin(12 * q[k])
            - self.coulomb[k] * sliding[k]
            for k in range(2)
        )
        m11, m12, m22 = self._masses(*q)
        if sliding[0] and sliding[1]:
            det = m11 * m22 - m12**2
            return ((m22 * r1 - m12 * r2) / det, (m11 * r2 - m12 * r1) / det), (0.0, 0.0)
        if sliding[0]:
            return (r1 / m11, 0.0), (0.0, r2 - m12 * r1 / m11)
        if sliding[1]:
            return (0.0, r2 / m22), (r1 - m12 * r2 / m22, 0.0)
        return (0.0, 0.0), (r1, r2)

    def simulate(
        self,
        torque: Signal,
        time: np.ndarray,
        q0: tuple[float, float] = (0.0, 0.0),
        v0: tuple[float, float] = (0.0, 0.0),
        rtol: float = 1e-9,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the positions and velocities (N, 2) at the instants."""
        x, t, sliding = np.array([*q0, *v0], dtype=float), float(time[0]), [float(np.sign(v)) for v in v0]
        sliding = self._directions(t, x, torque, sliding) if any(self.coulomb) else [1.0, 1.0]
        done = [x[None]]
        known = 1
        while known < len(time):
            slope, events = self._stretch(torque, sliding)
            found = solve_ivp(slope, (t, time[-1]), x, "DOP853", time[known:], events=events, rtol=rtol, atol=rtol / 10)
            done.append(np.reshape(np.transpose(found.y), (-1, 4)))
            known += len(found.t)
            if found.status != 1:
                break
            joint = next(k for k in range(2) if len(found.t_events[k]))
            t, x = float(found.t_events[joint][-1]), found.y_events[joint][-1].copy()
            sliding = sliding.copy()
            if sliding[joint] != 0:
                x[2 + joint] = 0.0
                sliding[joint] = 0.0
            else:
                sliding[joint] = float(np.sign(self.accelerations(x.tolist(), torque(t), sliding)[1][joint]))
            sliding = self._directions(t, x, torque, sliding)
            x[2:] = np.where(np.abs(x[2:]) <= LEAST_SPEED, LEAST_SPEED * np.array(sliding), x[2:])
        states = np.concatenate(done)
        return states[:, :2], states[:, 2:]

    def _stretch(self, torque: Signal, sliding: list[float]) -> tuple[Callable, list[Callable]]:
        """Return the derivative of the state for constant directions of friction, and the events that change them."""

        def slope(t: float, x: np.ndarray) -> tuple[float, ...]:
            state = x.tolist()
            return *state[2:], *self.accelerations(state, torque(t), sliding)[0]

        def make(joint: int) -> Callable[[float, np.ndarray], float]:
            def event(t: float, x: np.ndarray) -> float:
                if sliding[joint] == 0:
                    return self.coulomb[joint] - abs(self.accelerations(x.tolist(), torque(t), sliding)[1][joint])
                return x[2 + joint] * sliding[joint]

            event.terminal, event.direction = True, -1.0
            return event

        return slope, [make(joint) for joint in range(2)] if any(self.coulomb) else []

    def _directions(self, t: float, x: np.ndarray, torque: Signal, sliding: list[float]) -> list[float]:
        """Return the directions of sliding after stuck joints with reactions beyond the dry friction start to slide.

        A joint at rest sticks again if another one, by starting to slide, accelerates it against its direction.
        """
        for _ in range(4):
            acceleration, reaction = self.accelerations(x.tolist(), torque(t), sliding)
            loose = [sliding[k] == 0 and abs(reaction[k]) >= self.coulomb[k] * (1 - 1e-9) for k in range(2)]
            turned = [abs(x[2 + k]) <= LEAST_SPEED and acceleration[k] * sliding[k] < -1e-6 for k in range(2)]
            if not any(loose + turned):
                break
            sliding = [float(np.sign(reaction[k])) if loose[k] else sliding[k] * (not turned[k]) for k in range(2)]
        return sliding


@dataclass(frozen=True)
class Multisine:
    """Sum of sines for each joint: a call returns torques at a time, `held` their means over periods."""

    amplitude: np.ndarray  # (n, K) [N m]
    frequency: np.ndarray  # (n, K) [rad/s]
    phase: np.ndarray  # (n, K)

    def __call__(self, time: float) -> list[float]:
        return [sum(a * sin(w * time + p) for a, w, p in tones) for tones in self._tones]

    @cached_property
    def _tones(self) -> list[list[list[float]]]:
        return np.stack([self.amplitude, self.frequency, self.phase], axis=-1).tolist()

    def held(self, time: np.ndarray, period: float) -> np.ndarray:
        w = self.frequency[None]
        ends = [np.cos(w * t[:, None, None] + self.phase) for t in (time, time + period)]
        return np.sum(self.amplitude * (ends[0] - ends[1]) / (w * period), axis=2)

    @classmethod
    def paper(cls, seed: int, scale: tuple[float, ...] = (3.0, 1.5)) -> Multisine:
        """Return the paper's two frequencies and a third, shifted by 13 % from joint to joint, with random phases."""
        rng = np.random.default_rng(seed)
        n = len(scale)
        frequency = np.array([[12.07, 2.25, 5.1]]) * (1 + 0.13 * np.arange(n)[:, None])
        amplitude = np.array(scale)[:, None] * np.array([[1.0, 1.0, 0.7]])
        return cls(amplitude, frequency, rng.uniform(0, 2 * np.pi, (n, 3)))
