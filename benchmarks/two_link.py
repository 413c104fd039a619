"""A two-link arm by its textbook equations, integrated by SciPy between events: shares no code with what it checks.

Joint angles are relative, q = 0 hangs down. Friction of each joint is viscous and set-valued dry friction: a joint
whose velocity reaches zero sticks as long as its reaction is within +-fc. Torque is a multisine of each joint, so that
it is smooth between events; recordings hold its mean over each period, as a DAC would.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81


@dataclass(frozen=True)
class TwoLink:
    mass: tuple[float, float] = (1.2, 0.8)  # [kg]
    length: float = 0.45  # of the upper arm [m]
    center: tuple[float, float] = (0.2, 0.15)  # of mass, from the joint [m]
    inertia: tuple[float, float] = (0.02, 0.008)  # about the centre of mass [kg m^2]
    viscous: tuple[float, float] = (0.3638, 0.3638)  # the paper's Table 2, at each joint
    coulomb: tuple[float, float] = (0.9163, 0.9163)

    def urdf(self) -> str:
        """The same arm for a parser; its axes point so that gravity is the same."""
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
        (m1, m2), (c1, c2), (i1, i2), l1 = self.mass, self.center, self.inertia, self.length
        coupled = m2 * l1 * c2 * np.cos(q[1])
        m22 = m2 * c2**2 + i2
        m12 = m22 + coupled
        return np.array([[m1 * c1**2 + i1 + m2 * l1**2 + m22 + 2 * coupled, m12], [m12, m22]])

    def bias(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """C(q, q') q' + g(q)."""
        (m1, m2), (c1, c2), l1 = self.mass, self.center, self.length
        h = m2 * l1 * c2 * np.sin(q[1])
        g2 = m2 * c2 * GRAVITY * np.sin(q[0] + q[1])
        g1 = (m1 * c1 + m2 * l1) * GRAVITY * np.sin(q[0]) + g2
        return np.array([g1 - h * (2 * v[0] + v[1]) * v[1], g2 + h * v[0] ** 2])

    def energy(self, q: np.ndarray, v: np.ndarray) -> float:
        (m1, m2), (c1, c2), l1 = self.mass, self.center, self.length
        height = -(m1 * c1 + m2 * l1) * np.cos(q[0]) - m2 * c2 * np.cos(q[0] + q[1])
        return float(0.5 * v @ self.mass_matrix(q) @ v + GRAVITY * height)

    def accelerations(
        self, q: np.ndarray, v: np.ndarray, torque: np.ndarray, sliding: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations with friction in the directions `sliding`, and the reactions of joints that stick (0 there)."""
        rest = torque - self.bias(q, v) - np.array(self.viscous) * v - np.array(self.coulomb) * sliding
        matrix, free = self.mass_matrix(q), sliding != 0
        a = np.zeros(2)
        if free.any():
            a[free] = np.linalg.solve(matrix[np.ix_(free, free)], rest[free])
        return a, np.where(free, 0.0, rest - matrix @ a)

    def simulate(
        self,
        torque: Callable[[float], np.ndarray],
        time: np.ndarray,
        q0: tuple[float, float] = (0.0, 0.0),
        v0: tuple[float, float] = (0.0, 0.0),
        rtol: float = 1e-9,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (N, 2) at the instants."""
        dry = np.array(self.coulomb)
        x, t, sliding = np.array([*q0, *v0], dtype=float), float(time[0]), np.sign(np.array(v0, dtype=float))
        sliding = self._directions(t, x, torque, sliding) if dry.any() else np.ones(2)
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
                sliding[joint] = np.sign(self.accelerations(x[:2], x[2:], torque(t), sliding)[1][joint])
                x[2 + joint] = 1e-12 * sliding[joint]  # [rad/s], so that it is seen to leave
            sliding = self._directions(t, x, torque, sliding)
        states = np.concatenate(done)
        return states[:, :2], states[:, 2:]

    def _stretch(self, torque: Callable[[float], np.ndarray], sliding: np.ndarray) -> tuple[Callable, list[Callable]]:
        """Derivative of the state while friction keeps its directions, and the events that end this."""
        dry = np.array(self.coulomb)

        def slope(t: float, x: np.ndarray) -> np.ndarray:
            return np.concatenate([x[2:], self.accelerations(x[:2], x[2:], torque(t), sliding)[0]])

        def make(joint: int) -> Callable[[float, np.ndarray], float]:
            def event(t: float, x: np.ndarray) -> float:
                if sliding[joint] == 0:
                    return dry[joint] - abs(self.accelerations(x[:2], x[2:], torque(t), sliding)[1][joint])
                return x[2 + joint] * sliding[joint]

            event.terminal, event.direction = True, -1.0
            return event

        return slope, [make(joint) for joint in range(2)] if dry.any() else []

    def _directions(
        self, t: float, x: np.ndarray, torque: Callable[[float], np.ndarray], sliding: np.ndarray
    ) -> np.ndarray:
        """Directions once joints at rest whose reactions are beyond dry friction have broken loose."""
        for _ in range(4):
            reaction = self.accelerations(x[:2], x[2:], torque(t), sliding)[1]
            loose = (sliding == 0) & (np.abs(reaction) >= np.array(self.coulomb) * (1 - 1e-9))
            if not loose.any():
                break
            sliding = np.where(loose, np.sign(reaction), sliding)
        return sliding


@dataclass(frozen=True)
class Multisine:
    """A sum of sines of each joint; called with a time it gives the torque (n,), `held` the mean over each period."""

    amplitude: np.ndarray  # (n, K) [N m]
    frequency: np.ndarray  # (n, K) [rad/s]
    phase: np.ndarray  # (n, K)

    def __call__(self, time: float) -> np.ndarray:
        return np.sum(self.amplitude * np.sin(self.frequency * time + self.phase), axis=1)

    def held(self, time: np.ndarray, period: float) -> np.ndarray:
        w = self.frequency[None]
        ends = [np.cos(w * t[:, None, None] + self.phase) for t in (time, time + period)]
        return np.sum(self.amplitude * (ends[0] - ends[1]) / (w * period), axis=2)

    @classmethod
    def paper(cls, seed: int, scale: tuple[float, ...] = (3.0, 1.5)) -> Multisine:
        """The paper's two frequencies at each joint, apart a little so that joints differ, random phases."""
        rng = np.random.default_rng(seed)
        n = len(scale)
        frequency = np.array([[12.07, 2.25, 5.1]]) * (1 + 0.13 * np.arange(n)[:, None])
        amplitude = np.array(scale)[:, None] * np.array([[1.0, 1.0, 0.7]])
        return cls(amplitude, frequency, rng.uniform(0, 2 * np.pi, (n, 3)))
