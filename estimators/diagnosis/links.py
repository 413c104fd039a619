"""Results on the links of a machine that a case may have."""

from collections.abc import Mapping
from typing import Protocol

from pendulum_env._typing import JSON
from pendulum_env.physics import Estimate


class NearestLinks(Protocol):
    """Physically possible links that are nearest to estimated base parameters; `summarise` has their text."""

    def json(self) -> JSON:
        """Return a dictionary for JSON."""


class LinkPayload(Protocol):
    """Body at a link in some recordings, relative to a model."""

    @property
    def joint(self) -> str:
        """Joint in front of the link."""

    @property
    def estimates(self) -> Mapping[str, Estimate]:
        """Determined parameters by name; `m` is the mass."""

    @property
    def center(self) -> Mapping[str, Estimate]:
        """Centre of mass [m] by axis."""

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of parameters that no motion determines."""

    @property
    def exists(self) -> bool | None:
        """Return whether a body can have the parameters of the free fit; None if some are undetermined."""

    @property
    def torque_rms(self) -> Mapping[str, tuple[float, float]]:
        """RMS residual torque of each joint without and with it [N m]."""

    @property
    def is_significant(self) -> bool:
        """Return whether the payload is significant."""

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
