"""Rigid bodies of an arm from URDF or MJCF by Pinocchio: regressors of the motion of n joints.

    M(q) q'' + C(q, q') q' + g(q) = Y(q, q', q'') theta,    theta: ten numbers per link, optionally a rotor per joint

Momentum p = M q', dK/dq - dU/dq and the energies are linear in theta, hence also Hamilton's equation p' = tau - f +
dK/dq - dU/dq. With Y0 the regressor without gravity, that of p is Y0(q, 0, q'). Because M' = C + C',

    dK/dq = C' q' = M' q' - C q' has the regressor  d/de p(q + e q', q') - Y0(q, q', 0).

The derivative is a central difference along the motion. With joints that follow others, the joints of all links move at
R q', and R' maps their torques to the leading joints. Sources: Gautier and Khalil, IEEE Transactions on Robotics and
Automation 6(3), 1990 (base parameters); Carpentier et al., SII 2019 (Pinocchio).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pendulum_env._typing import Array, Index
from pendulum_env.formatting import join_words
from pendulum_env.physics.joints import find_mechanism
from pendulum_env.physics.mechanism import BaseParameter, LinkedMechanism
from robots.arms.robot import BodyError, import_pinocchio, read_robot

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")  # of a link in its joint's frame
UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}  # others: kg m^2
NAMED_LAST = ("rotor", "m")  # last to name a base parameter
DIFFERENCE = 2e-6  # [s], step of the central difference; truncation and rounding errors are below 1e-9 at a few rad/s
UNLIMITED = 1e6  # speed or torque from which a limit in a file counts as infinite
LEAST_MASS = 1e-9  # [kg], least mass of a link
ROUNDING = 1e-9  # relative rounding error of inertias in a file
INDEPENDENT = 1e-8  # least relative length of a column's part that is independent of previous columns
DRAWS = 60  # samples of random motion for the rank

__all__ = ["BaseParameter", "Body", "BodyError", "parse_body", "read_body"]


@dataclass(frozen=True, eq=False)
class Body(LinkedMechanism):
    """Links of an arm with n revolute or linear joints, in a tree on a fixed base; made by `read_body`.

    Attributes:
        links: names of the joints that move a link: `joints`, and joints that follow them.
        model: Pinocchio model of the links.
        ratios: R, speed of each link's joint per speed of each independent joint (links, n).
        offsets: r, position of each link's joint with all independent joints at zero (links,) [rad] or [m].
        rotors: whether each joint has a rotor inertia.
    """

    links: tuple[str, ...]
    model: Any
    ratios: Array
    offsets: Array
    rotors: bool

    def __repr__(self) -> str:
        return f"<Body {self.name!r}: {len(self.joints)} joints, {len(self.base)} base parameters>"

    @property
    def weightless(self) -> Body:
        """Return the body without gravity."""
        return replace(self, model=self._weightless)

    @cached_property
    def impossible_links(self) -> dict[str, str]:
        """Return the fault of each link with an impossible inertia, by the name of its joint."""
        faults = {}
        for joint, link in zip(self.links, list(self.model.inertias)[1:], strict=True):
            if not link.mass > LEAST_MASS:
                faults[joint] = "no mass"
            elif np.linalg.eigvalsh(link.inertia).min() < -ROUNDING * np.abs(link.inertia).max():
                faults[joint] = "an inertia that is not positive definite"
            elif np.linalg.eigvalsh(link.toPseudoInertia().toMatrix()).min() < -ROUNDING * link.mass:
                faults[joint] = "an inertia that breaks the triangle inequality"
        return faults

    @property
    def impossible_text(self) -> str:
        """Return a sentence that names all `impossible_links`, or an empty text."""
        links = join_words([f"'{joint}' ({fault})" for joint, fault in self.impossible_links.items()])
        return f"no body has the inertia that the file gives behind joint {links}" if links else ""

    def refuse_impossible_links(self) -> None:
        """Refuse to simulate links with an impossible inertia."""
        if self.impossible_links:
            raise BodyError(f"{self.name}: {self.impossible_text}: mend mass, centre or inertia to simulate the arm")

    # ---------------------------------------------------------------------------------------------- standard parameters

    @property
    def standard(self) -> tuple[str, ...]:
        """Return the names of the S standard parameters."""
        links = [f"{name}@{joint}" for joint in self.links for name in STANDARD]
        return (*links, *(f"rotor@{joint}" for joint in self.joints if self.rotors))

    @property
    def standard_values(self) -> Array:
        """Return the standard parameters of the file (S,)."""
        links = np.concatenate([inertia.toDynamicParameters() for inertia in list(self.model.inertias)[1:]])
        rotors = (self.ratios**2).T @ self.model.armature  # including joints that follow
        return np.concatenate([links, rotors]) if self.rotors else links

    @cached_property
    def values(self) -> Array:
        """Return the base parameters of the file (P,)."""
        return np.asarray(self.combine @ self.standard_values)

    @cached_property
    def base(self) -> tuple[BaseParameter, ...]:
        """Return the base parameters with their combinations."""
        parameters = []
        for place, row in zip(self._independent, self.combine, strict=True):
            further = [k for k in np.flatnonzero(np.abs(row) > INDEPENDENT) if k != place]
            parts = [(self.standard[place], 1.0), *((self.standard[k], float(row[k])) for k in further)]
            parameters.append(BaseParameter(self.standard[place], self.get_unit(self.standard[place]), tuple(parts)))
        return tuple(parameters)

    @property
    def _independent(self) -> Index:
        return self._reduction[0]

    @property
    def combine(self) -> Array:
        """Return the matrix (P, S) from standard to base parameters."""
        return self._reduction[1]

    def link_columns(self, joint: str) -> Array:
        """Return the matrix (P, 10) from the standard parameters of a joint's link to the base parameters."""
        first = len(STANDARD) * self.links.index(joint)
        return self.combine[:, first : first + len(STANDARD)]

    def get_unit(self, name: str) -> str:
        """Return the unit of a standard parameter."""
        quantity, _, joint = name.partition("@")
        return self.units(joint).unit("kg m^2") if quantity == "rotor" else UNITS.get(quantity, "kg m^2")

    @cached_property
    def _reduction(self) -> tuple[Index, Array]:
        """Find the base parameters.

        QR decomposition of the torque regressor over random motion, with columns in the order of preference.
        A column that is a combination of previous ones is skipped.

        Returns:
            Indices of the first standard parameter of each base parameter (P,), and the matrix from standard to base
            parameters (P, S).
        """
        q, v, a = np.random.default_rng(0).uniform(-np.pi, np.pi, (3, DRAWS, len(self.joints)))
        columns = self._torque(q, v, a).reshape(-1, len(self.standard))  # (draws n, S)
        size = np.linalg.norm(columns, axis=0)
        chosen: list[int] = []
        basis = np.empty(columns.shape, order="F")  # orthonormal basis of the chosen columns
        kinds = [name.split("@")[0] for name in self.standard]
        for k in sorted(range(len(size)), key=lambda k: NAMED_LAST.index(kinds[k]) if kinds[k] in NAMED_LAST else -1):
            remainder, chosen_basis = columns[:, k], basis[:, : len(chosen)]
            for _ in range(2):  # the second pass removes rounding errors
                remainder = remainder - chosen_basis @ (chosen_basis.T @ remainder)
            if np.linalg.norm(remainder) > INDEPENDENT * max(size[k], size.max() * 1e-6):
                basis[:, len(chosen)] = remainder / np.linalg.norm(remainder)
                chosen.append(k)
        independent = np.sort(np.array(chosen, dtype=np.intp))
        combine = np.asarray(np.linalg.lstsq(columns[:, independent], columns, rcond=None)[0], dtype=np.float64)
        combine[np.abs(combine) < INDEPENDENT] = 0.0
        return independent, combine

    # ------------------------------------------------------------------------------------------------------- regressors

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torque regressor Y(q, v, a) (N, n, P)."""
        return self._torque(q, v, a)[..., self._independent]

    def momentum(self, q: Array, v: Array) -> Array:
        """Return the regressor of M(q) v (N, n, P)."""
        return self._momentum(q, v)[..., self._independent]

    def exchange(self, q: Array, v: Array) -> Array:
        """Return the regressor of dU/dq - dK/dq, the loss of momentum without friction (N, n, P)."""
        h = DIFFERENCE
        momentum_rate = (self._momentum(q + h * v, v) - self._momentum(q - h * v, v)) / (2 * h)  # M' v
        zero = np.zeros_like(v)
        return (self._torque(q, v, zero) - momentum_rate)[..., self._independent]  # C v + g - M' v

    def mass_matrix(self, q: Array, theta: Array) -> Array:
        """Return the mass matrix M(q) (N, n, n) [kg m^2] of base parameters theta (P,)."""
        columns = [self.momentum(q, np.broadcast_to(unit, q.shape)) @ theta for unit in np.eye(len(self.joints))]
        return np.stack(columns, axis=-1)

    def energy(self, q: Array, v: Array) -> Array:
        """Return the regressor of the energy K + U, up to a constant (N, P)."""
        model, data, pin = self.model, self._data, import_pinocchio()

        def energies(q: Array, v: Array, a: Array) -> Array:
            kinetic = pin.computeKineticEnergyRegressor(model, data, q, v)
            return kinetic + pin.computePotentialEnergyRegressor(model, data, q)

        links = self._apply_to_samples(energies, *self._expand_motion(q, v, v))
        return (np.hstack([links, 0.5 * v**2]) if self.rotors else links)[:, self._independent]

    @cached_property
    def _data(self) -> Any:
        return self.model.createData()

    @cached_property
    def _weightless(self) -> Any:
        model = self.model.copy()
        model.gravity.linear = np.zeros(3)
        return model

    def _torque(self, q: Array, v: Array, a: Array) -> Array:
        return self._append_rotors(self._regress(self.model, q, v, a), a)

    def _momentum(self, q: Array, v: Array) -> Array:
        return self._append_rotors(self._regress(self._weightless, q, np.zeros_like(v), v), v)

    def _regress(self, model: Any, q: Array, v: Array, a: Array) -> Array:
        regressor = partial(import_pinocchio().computeJointTorqueRegressor, model, self._data)
        count = len(self.links)  # for one link, Pinocchio returns a vector
        links = self._apply_to_samples(regressor, *self._expand_motion(q, v, a)).reshape(len(q), count, 10 * count)
        return links if count == len(self.joints) else np.einsum("kn,Nkp->Nnp", self.ratios, links)

    def _expand_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and acceleration of the joints of all links, (N, links) each."""
        ratios = self.ratios.T
        return q @ ratios + self.offsets, v @ ratios, a @ ratios

    def _apply_to_samples(self, law: Callable[[Array, Array, Array], Array], q: Array, v: Array, a: Array) -> Array:
        """Apply a Pinocchio function of one sample to N samples."""
        return np.array([law(*sample) for sample in zip(q, v, a, strict=True)])

    def _append_rotors(self, links: Array, motion: Array) -> Array:
        """Append the columns of the rotors to those of the links (N, n, 10 links)."""
        return np.concatenate([links, motion[:, :, None] * np.eye(len(self.joints))], axis=2) if self.rotors else links

    @property
    def position_limits(self) -> tuple[Array, Array]:
        """Return the least and largest position of each joint (n,) [rad] or [m], infinite by default."""
        low, high = map(self._select_joints, (self.model.lowerPositionLimit, self.model.upperPositionLimit))
        is_unlimited = low >= high  # MJCF without a range
        return np.where(is_unlimited, -np.inf, low), np.where(is_unlimited, np.inf, high)

    @property
    def torque_limits(self) -> Array:
        """Return the largest torque of each joint (n,) [N m] or [N], infinite by default."""
        return _replace_unlimited(np.abs(self._select_joints(self.model.upperEffortLimit)))

    @property
    def velocity_limits(self) -> Array:
        """Return the largest speed of each joint (n,) [rad/s] or [m/s], infinite by default."""
        return _replace_unlimited(self._select_joints(self.model.upperVelocityLimit))

    def _select_joints(self, values: Array) -> Array:
        """Select the values of independent joints (n,) from those of all links."""
        return np.array(values, dtype=float)[[self.links.index(joint) for joint in self.joints]]


def _replace_unlimited(largest: Array) -> Array:
    return np.where((largest > 0) & (largest < UNLIMITED), largest, np.inf)


def read_body(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    held: Mapping[str, float] | None = None,
    bolted: bool = False,
    rotors: bool | None = None,
) -> Body:
    """Read an arm from URDF (`.urdf`) or MJCF (`.xml`, `.mjcf`).

    A joint that mimics another joint follows it, or is held with it.

    Args:
        path: path of the file.
        joints: names of the joints that move; the others are held. By default, all joints that neither belong to the
            base nor mimic another joint.
        held: positions of held joints [rad] or [m]; by default zero.
        bolted: whether a floating base is fixed.
        rotors: whether joints have a rotor inertia (MuJoCo's armature); by default, if the file has one.

    Raises:
        BodyError: if the file cannot be read, the robot is not a tree of links on a fixed base with revolute or linear
            joints, or the extra `arms` is missing. Impossible inertias are refused only by simulations, see
            `Body.impossible_links`.
    """
    robot = read_robot(path, joints, held or {}, bolted)
    has_rotors = bool(np.any(np.asarray(robot["model"].armature) > 0)) if rotors is None else rotors
    return Body(**robot, rotors=has_rotors)


def parse_body(urdf: str) -> Body:
    """Read an arm from the text of a URDF file; see `read_body`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(urdf, encoding="utf-8")
        return read_body(path)


def find_body(terms: Sequence[object]) -> Body:
    """Return the body of an arm's terms."""
    body = find_mechanism(terms)
    assert isinstance(body, Body)
    return body
