"""Which columns of its file a recording was read from, and columns that read it otherwise."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pendulum_env.recording.columns import NONE, Column
from pendulum_env.recording.expression import Expression
from pendulum_env.recording.vocabulary import LINEAR, RAW, UNITS

DEGREE = UNITS["position"]["deg"]  # [rad]


@dataclass(frozen=True)
class Origin:
    """How a file was read.

    Attributes:
        columns: by quantity, as they were recognised or told.
        named: what the user said of columns, by quantity.
        are_counts: whether position is whole numbers without a unit that cover more than 720.
    """

    columns: Mapping[str, Column]
    named: Mapping[str, str] = field(default_factory=dict)
    are_counts: bool = False

    @property
    def slides(self) -> bool:
        """Whether positions were told in metres, so that the joint is an axis that slides."""
        return self.columns["position"].unit in LINEAR["position"]

    def changed(self, **changes: str) -> dict[str, str]:
        """Columns by quantity that read the file with changes, and else with all that was said before."""
        return {**self.named, **changes}

    def in_unit(self, quantity: str, unit: str) -> dict[str, str]:
        """With a column in another unit."""
        return self.changed(**{quantity: str(replace(self._as_it_is(quantity), unit=unit))})

    def in_counts(self) -> dict[str, str]:
        """With position in counts, for example 4096 per turn."""
        expression = self._as_it_is("position")
        return self.changed(position=str(replace(expression, unit="counts", factors=("/4096", *expression.factors))))

    def confirmed(self, quantity: str) -> dict[str, str]:
        """With a column named as the quantity that it was taken for."""
        return self.changed(**{quantity: str(self._as_it_is(quantity))})

    def turned(self, quantity: str) -> dict[str, str]:
        """With a column of the other sign, what is added to it included."""
        old = self._as_it_is(quantity)
        offset = None if old.offset is None else ("+" if old.offset[0] == "-" else "-") + old.offset[1:]
        return self.changed(**{quantity: str(replace(old, negative=not old.negative, offset=offset))})

    def without(self, quantity: str) -> dict[str, str]:
        """Without a column that may be missing."""
        return self.changed(**{quantity: NONE})

    def shifted(self, angle: float, digits: int) -> dict[str, str] | None:
        """With an angle added to position, and to the reference if there is one [rad], told in degrees.

        None if position is no angle.
        """
        places = [quantity for quantity in ("position", "reference") if quantity in self.columns]
        if any(self.columns[quantity].unit not in {None, *UNITS["position"], *RAW["position"]} for quantity in places):
            return None
        return self.changed(**{quantity: str(self._shifted(quantity, angle, digits)) for quantity in places})

    def could_be_degrees(self) -> bool:
        """Whether position may be in degrees that were taken for something else."""
        unit = self.columns["position"].unit
        return unit is None or (UNITS["position"].get(unit, DEGREE) != DEGREE)

    def _as_it_is(self, quantity: str) -> Expression:
        """What would read a column as it was read."""
        column = self.columns[quantity]
        told = column.expression or Expression(column.header)
        return replace(told, unit=told.unit or column.unit)

    def _shifted(self, quantity: str, angle: float, digits: int) -> Expression:
        old, column = self._as_it_is(quantity), self.columns[quantity]
        degrees = math.remainder((column.offset + angle) / DEGREE, 360.0)
        text = f"{degrees:+.{digits}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        is_told = column.unit is not None and UNITS["position"].get(column.unit) == DEGREE
        return replace(old, offset=text, offset_unit=None if is_told else "deg")
