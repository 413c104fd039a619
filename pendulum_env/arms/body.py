"""Rigid bodies of an arm, from URDF or MJCF through Pinocchio: what the motion of n joints asks of their parameters.

    M(q) q'' + C(q, q') q' + g(q) = Y(q, q', q'') theta,    theta: ten numbers a link, and perhaps a rotor a joint

Momentum p = M q', its exchange dK/dq - dU/dq and the energies are linear in the same theta, and so Hamilton's equation
p' = tau - f + dK/dq - dU/dq is. With Y0 the regressor without gravity, p has Y0(q, 0, q'), and as M' = C + C',

    dK/dq = C' q' = M' q' - C q' has  d/de p(q + e q', q') - Y0(q, q', 0),

the first by a central difference along the motion. Source: Gautier and Khalil, IEEE Transactions on Robotics and
Automation 6(3), 1990, for the base parameters; Carpentier et al., SII 2019, for Pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pendulum_env._typing import Array, Index
from pendulum_env.mistake import Mistake

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")  # of a link, in its joint's frame
UNITS = {"m": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m"}  # all others kg m^2
LATE = ("rotor", "m")  # to lead a base parameter: a mass shows through the links that carry it
DIFFERENCE = 2e-6  # [s], along the motion: truncation and rounding are both below 1e-9 where joints turn at some rad/s
INDEPENDENT = 1e-8  # relative length of what a column adds to those before it
DRAWS = 60  # of random motion, for the rank
LIGHTEST = 1e-9  # [kg], of a link that moves


class BodyError(Mistake):
    """A robot that cannot be identified; the message is one sentence with the file, what is wrong and what to do."""


@dataclass(frozen=True)
class BaseParameter:
    """A combination of standard parameters that the torque shows."""

    name: str  # of its first part, `Izz@shoulder`
    unit: str
    parts: tuple[tuple[str, float], ...]  # standard parameters with their factors, the first with 1

    @property
    def text(self) -> str:
        """`Izz@shoulder + 0.2025 m@elbow`."""
        words = self.name
        for name, factor in self.parts[1:]:
            size = "" if np.isclose(abs(factor), 1.0) else f"{abs(factor):.4g} "
            words += f" {'-' if factor < 0 else '+'} {size}{name}"
        return words


@dataclass(frozen=True, eq=False)
class Chain:
    """n links in a row as the file has them, in space, where all joints are at zero."""

    axes: Array  # of the joints (n, 3)
    joints: Array  # where they are (n, 3) [m]
    masses: Array  # (n,) [kg]
    centers: Array  # of mass (n, 3) [m]
    inertias: Array  # about the centres (n, 3, 3) [kg m^2]
    rotors: Array  # inertias of the motors (n,) [kg m^2]
    friction: Array  # viscous and dry (n, 2) [N m s/rad], [N m]
    gravity: Array  # (3,) [m/s^2]


@dataclass(frozen=True, eq=False)
class Body:
    """Links of an arm with n revolute joints on a fixed base; build it with `read_body`.

    All regressors broadcast over N samples of q, v and a, each (N, n) in rad, rad/s, rad/s^2, and have one column for
    each of P base parameters.

    Attributes:
        name: of the robot.
        joints: names, from the base on.
        rotors: whether each joint's motor has an inertia of its own.
    """

    name: str
    joints: tuple[str, ...]
    rotors: bool
    _model: Any  # pinocchio's

    def __repr__(self) -> str:
        return f"<Body {self.name!r}: {len(self.joints)} joints, {len(self.base)} base parameters>"

    # ---------------------------------------------------------------------------------------------- standard parameters

    @property
    def standard(self) -> tuple[str, ...]:
        """Names of the S standard parameters."""
        links = [f"{name}@{joint}" for joint in self.joints for name in STANDARD]
        return (*links, *(f"rotor@{joint}" for joint in self.joints if self.rotors))

    @property
    def standard_values(self) -> Array:
        """Standard parameters as the file has them (S,)."""
        links = np.concatenate([inertia.toDynamicParameters() for inertia in list(self._model.inertias)[1:]])
        return np.concatenate([links, self._model.armature]) if self.rotors else links

    @cached_property
    def values(self) -> Array:
        """Base parameters as the file has them (P,)."""
        return np.asarray(self.combine @ self.standard_values)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters."""
        return tuple(parameter.name for parameter in self.base)

    @cached_property
    def base(self) -> tuple[BaseParameter, ...]:
        """The base parameters, in words."""
        found = []
        for own, row in zip(self._independent, self.combine, strict=True):
            others = [k for k in np.flatnonzero(np.abs(row) > INDEPENDENT) if k != own]
            parts = [(self.standard[own], 1.0), *((self.standard[k], float(row[k])) for k in others)]
            found.append(BaseParameter(self.standard[own], _unit(self.standard[own]), tuple(parts)))
        return tuple(found)

    @property
    def _independent(self) -> Index:
        return self._reduction[0]

    @property
    def combine(self) -> Array:
        """What each base parameter is of the standard parameters (P, S)."""
        return self._reduction[1]

    @property
    def standard_units(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the standard parameters."""
        return tuple((name, _unit(name)) for name in self.standard)

    @cached_property
    def _reduction(self) -> tuple[Index, Array]:
        """Standard parameters that lead the base parameters (P,), and what each combines (P, S).

        QR of the torque regressor over random motion, its columns taken in an order of preference, and only those that
        are no combination of others before.
        """
        rng = np.random.default_rng(0)
        q, v, a = rng.uniform(-np.pi, np.pi, (3, max(DRAWS, 3 * len(self.standard)), len(self.joints)))
        columns = self._torque(q, v, a).reshape(-1, len(self.standard))  # (draws n, S)
        size = np.linalg.norm(columns, axis=0)
        chosen: list[int] = []
        basis = np.empty((len(columns), 0))
        kinds = [name.split("@")[0] for name in self.standard]
        for k in sorted(range(len(size)), key=lambda k: LATE.index(kinds[k]) if kinds[k] in LATE else -1):
            rest = columns[:, k]
            for _ in range(2):  # twice is enough
                rest = rest - basis @ (basis.T @ rest)
            if np.linalg.norm(rest) > INDEPENDENT * max(size[k], size.max() * 1e-6):
                chosen.append(k)
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
        lead = np.sort(np.array(chosen, dtype=np.intp))
        combine = np.asarray(np.linalg.lstsq(columns[:, lead], columns, rcond=None)[0], dtype=np.float64)
        combine[np.abs(combine) < INDEPENDENT] = 0.0
        return lead, combine

    @property
    def chain(self) -> Chain | None:
        """The links in space, unless the arm branches."""
        model, data, pin = self._model, self._model.createData(), pinocchio()
        count = len(self.joints)
        if list(model.parents)[1:] != list(range(count)):
            return None
        jacobians = np.asarray(pin.computeJointJacobians(model, data, self._configuration(np.zeros((1, count)))[0]))
        places, links = list(data.oMi)[1:], list(model.inertias)[1:]
        bodies = [place.act(link) for place, link in zip(places, links, strict=True)]
        return Chain(
            axes=jacobians[3:].T,
            joints=np.array([place.translation for place in places]),
            masses=np.array([body.mass for body in bodies]),
            centers=np.array([body.lever for body in bodies]),
            inertias=np.array([body.inertia for body in bodies]),
            rotors=np.array(model.armature, dtype=float),
            friction=np.column_stack([model.damping, model.upperDryFrictionLimit]),
            gravity=np.array(model.gravity.linear, dtype=float),
        )

    # ------------------------------------------------------------------------------------------------------- regressors

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Y(q, v, a) with torque = Y theta (N, n, P)."""
        return self._torque(q, v, a)[..., self._independent]

    def momentum(self, q: Array, v: Array) -> Array:
        """Regressor of M(q) v (N, n, P)."""
        return self._momentum(q, v)[..., self._independent]

    def exchange(self, q: Array, v: Array) -> Array:
        """Regressor of dU/dq - dK/dq, what takes momentum away beside friction (N, n, P)."""
        h = DIFFERENCE
        along = (self._momentum(q + h * v, v) - self._momentum(q - h * v, v)) / (2 * h)  # M' v
        still = np.zeros_like(v)
        return (self._torque(q, v, still) - along)[..., self._independent]  # C v + g - M' v

    def mass_matrix(self, q: Array, theta: Array) -> Array:
        """M(q) at base parameters theta (P,), (N, n, n) [kg m^2]."""
        columns = [self.momentum(q, np.broadcast_to(unit, q.shape)) @ theta for unit in np.eye(len(self.joints))]
        return np.stack(columns, axis=-1)

    def stored(self, q: Array, v: Array) -> Array:
        """Regressor of the energy K + U, up to a constant (N, P)."""
        model, data, pin = self._model, self._data, pinocchio()

        def energies(q: Array, v: Array, a: Array) -> Array:
            return pin.computeKineticEnergyRegressor(model, data, q, v) + pin.computePotentialEnergyRegressor(
                model, data, q
            )

        links = self._each(energies, q, v, v)
        return (np.hstack([links, 0.5 * v**2]) if self.rotors else links)[:, self._independent]

    @cached_property
    def _data(self) -> Any:
        return self._model.createData()

    @cached_property
    def _weightless(self) -> Any:
        model = self._model.copy()
        model.gravity.linear = np.zeros(3)
        return model

    def _torque(self, q: Array, v: Array, a: Array) -> Array:
        return self._with_rotors(self._regress(self._model, q, v, a), a)

    def _momentum(self, q: Array, v: Array) -> Array:
        return self._with_rotors(self._regress(self._weightless, q, np.zeros_like(v), v), v)

    def _regress(self, model: Any, q: Array, v: Array, a: Array) -> Array:
        data, regressor = self._data, pinocchio().computeJointTorqueRegressor
        return self._each(lambda q, v, a: regressor(model, data, q, v, a), q, v, a)

    def _each(self, law: Callable[[Array, Array, Array], Array], q: Array, v: Array, a: Array) -> Array:
        """A law of Pinocchio's, which knows one sample at a time, over N samples."""
        where = self._configuration(q)
        return np.array([law(*sample) for sample in zip(where, v, a, strict=True)])

    def _with_rotors(self, links: Array, motion: Array) -> Array:
        """Links' columns (N, n, 10 n) with those of rotors, each on its own joint alone, behind them."""
        return np.concatenate([links, motion[:, :, None] * np.eye(len(self.joints))], axis=2) if self.rotors else links

    def _configuration(self, q: Array) -> Array:
        """Pinocchio's coordinates (N, nq): joints without limits are a cosine and a sine there."""
        parts = [
            np.column_stack([np.cos(angle), np.sin(angle)]) if size == 2 else angle[:, None]
            for angle, size in zip(q.T, list(self._model.nqs)[1:], strict=True)
        ]
        return np.hstack(parts)

    @property
    def position_limits(self) -> tuple[Array, Array]:
        """Least and largest position of each joint (n,) [rad], infinite where the file has none."""
        bounds = []
        for values, none in ((self._model.lowerPositionLimit, -np.inf), (self._model.upperPositionLimit, np.inf)):
            places = [(int(at), int(size)) for at, size in zip(self._model.idx_qs, self._model.nqs, strict=True)][1:]
            bounds.append(np.array([none if size == 2 else values[at] for at, size in places]))
        endless = bounds[0] >= bounds[1]  # MJCF without a range
        return np.where(endless, -np.inf, bounds[0]), np.where(endless, np.inf, bounds[1])

    @property
    def torque_limits(self) -> Array:
        """Largest torque of each joint (n,) [N m], infinite where the file has none."""
        limits = np.abs(np.asarray(self._model.upperEffortLimit, dtype=float))
        return np.where((limits > 0) & (limits < 1e6), limits, np.inf)

    @property
    def velocity_limits(self) -> Array:
        """Largest speed of each joint (n,) [rad/s], infinite where the file has none."""
        limits = np.asarray(self._model.upperVelocityLimit, dtype=float)
        return np.where((limits > 0) & (limits < 1e6), limits, np.inf)


def read_body(path: str | Path, *, rotors: bool | None = None) -> Body:
    """Read the links of an arm from URDF (`.urdf`) or MJCF (`.xml`, `.mjcf`).

    Args:
        path: of the file.
        rotors: whether joints have a rotor's inertia (MuJoCo's armature) beside their links'; by default, if the file
            gives any.

    Raises:
        BodyError: if the file cannot be read, or the robot is none of links in a tree on a fixed base, joined by
            revolute joints and each with an inertia; or without the extra `arms`.
    """
    path = Path(path)
    pin = pinocchio()
    try:
        tree = ElementTree.parse(path).getroot()
    except OSError as error:
        raise BodyError(f"{path}: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise BodyError(f"{path}: is no XML ({error}): a robot is read from URDF or MJCF") from None
    if tree.tag not in ("robot", "mujoco"):
        raise BodyError(f"{path}: holds <{tree.tag}>, neither <robot> (URDF) nor <mujoco> (MJCF)")
    _refuse_loops(path, tree)
    build = pin.buildModelFromUrdf if tree.tag == "robot" else pin.buildModelFromMJCF
    try:
        model = build(str(path))
    except Exception as error:  # Pinocchio raises what its parsers raise
        raise BodyError(f"{path}: Pinocchio cannot read it: {' '.join(str(error).split())[:200]}") from None
    _refuse_others(path, model)
    joints = tuple(list(model.names)[1:])
    return Body(tree.get("name") or tree.get("model") or path.stem, joints, _rotors(model, rotors), model)


def _rotors(model: Any, asked: bool | None) -> bool:
    return bool(np.any(np.asarray(model.armature) > 0)) if asked is None else asked


def pinocchio() -> ModuleType:
    """Pinocchio, imported where it is needed.

    Raises:
        BodyError: if it is not installed.
    """
    try:
        import pinocchio
    except ImportError:
        raise BodyError("arms need Pinocchio: pip install 'pendulum-ident[arms]'") from None
    return pinocchio


def _refuse_loops(path: Path, tree: ElementTree.Element) -> None:
    """Refuse links that hang on two joints, and joints that follow others."""
    children = [child.get("link") for child in tree.iterfind("joint/child")]
    for link in dict.fromkeys(children):
        if children.count(link) > 1:
            raise BodyError(f"{path}: link '{link}' hangs on two joints: closed loops cannot be identified, cut one")
    for joint in tree.iterfind("joint"):
        if joint.find("mimic") is not None:
            raise BodyError(f"{path}: joint '{joint.get('name')}' mimics another: give it a motor of its own or fix it")
    if any(link.get("name") is None for link in tree.iterfind("worldbody//body")):
        raise BodyError(f"{path}: a <body> has no name, by which Pinocchio tells them apart: give each one")
    for tie in tree.iterfind("equality/*"):
        raise BodyError(f"{path}: <{tie.tag}> of <equality> closes a loop, which cannot be identified: leave it out")


def _refuse_others(path: Path, model: Any) -> None:
    """Refuse what is no arm of revolute joints, or whose links have no inertia."""
    if model.njoints < 2:
        raise BodyError(f"{path}: has no joint that moves")
    for name, joint, inertia in list(zip(model.names, model.joints, model.inertias, strict=True))[1:]:
        kind = joint.shortname().removeprefix("JointModel")
        if "," in name or name.startswith("-"):
            raise BodyError(
                f"{path}: joint '{name}': rename it, as a comma or a first minus names a coupling of joints"
            )
        if not kind.startswith("R"):
            raise BodyError(f"{path}: joint '{name}' is {kind}: only revolute joints, one a link, can be identified")
        if not inertia.mass > LIGHTEST:
            raise BodyError(f"{path}: the link behind joint '{name}' has no inertia: give it mass and <inertial>")
        least = np.linalg.eigvalsh(inertia.toPseudoInertia().toMatrix()).min()
        if least < -1e-9 * inertia.mass:
            raise BodyError(
                f"{path}: the link behind joint '{name}' has an inertia that no body has (its pseudo-inertia is not "
                "positive): mend its mass, centre or inertia"
            )


def _unit(name: str) -> str:
    return UNITS.get(name.split("@")[0], "kg m^2")
