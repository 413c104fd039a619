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
    """Format in which a file was read.

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
        """Return whether positions are in metres, so that the joint slides."""
        return self.columns["position"].unit in LINEAR["position"]

    def changed(self, **changes: str) -> dict[str, str]:
        """Columns by quantity that read the file with changes, and else with all that was said before."""
        return {**self.named, **changes}

    def in_unit(self, quantity: str, unit: str) -> dict[str, str]:
        """Return the format with a column in another unit."""
        return self.changed(**{quantity: str(replace(self._as_it_is(quantity), unit=unit))})

    def in_counts(self) -> dict[str, str]:
        """Return the format with position in counts, for example 4096 per turn."""
        expression = self._as_it_is("position")
        return self.changed(position=str(replace(expression, unit="counts", factors=("/4096", *expression.factors))))

    def confirmed(self, quantity: str) -> dict[str, str]:
        """Return the format with an explicit column for a quantity."""
        return self.changed(**{quantity: str(self._as_it_is(quantity))})

    def turned(self, quantity: str) -> dict[str, str]:
        """Return the format with the opposite sign of a column and its offset."""
        old = self._as_it_is(quantity)
        offset = None if old.offset is None else ("+" if old.offset[0] == "-" else "-") + old.offset[1:]
        return self.changed(**{quantity: str(replace(old, negative=not old.negative, offset=offset))})

    def without(self, quantity: str) -> dict[str, str]:
        """Without a column that may be missing."""
        return self.changed(**{quantity: NONE})

    def shifted(self, angle: float, digits: int) -> dict[str, str] | None:
        """Return the format with an angle [rad] added to position and reference, written in degrees.

        None if position is no angle.
        """
        places = [quantity for quantity in ("position", "reference") if quantity in self.columns]
        if any(self.columns[quantity].unit not in {None, *UNITS["position"], *RAW["position"]} for quantity in places):
            return None
        return self.changed(**{quantity: str(self._shifted(quantity, angle, digits)) for quantity in places})

    def could_be_degrees(self) -> bool:
        """Return whether position may be in degrees."""
        unit = self.columns["position"].unit
        return unit is None or (UNITS["position"].get(unit, DEGREE) != DEGREE)

    def _as_it_is(self, quantity: str) -> Expression:
        """Return the expression that reads a column as before."""
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
