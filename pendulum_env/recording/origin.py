"""Which columns of its file a recording was read from, and how to change them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pendulum_env.recording.columns import NONE, FileColumn
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

    columns: Mapping[str, FileColumn]
    named: Mapping[str, str] = field(default_factory=dict)
    are_counts: bool = False

    @property
    def slides(self) -> bool:
        """Return whether positions are in metres, so that the joint slides."""
        return self.columns["position"].unit in LINEAR["position"]

    def change_column(self, quantity: str, **changes: Any) -> dict[str, str]:
        """Return columns by quantity that read one with changes of its `Expression`, others as the user named them."""
        return {**self.named, quantity: str(replace(self._get_expression(quantity), **changes))}

    def change_to_counts(self) -> dict[str, str]:
        """Return the columns with position in counts, for example 4096 per turn."""
        factors = ("/4096", *self._get_expression("position").factors)
        return self.change_column("position", unit="counts", factors=factors)

    def flip_sign(self, quantity: str) -> dict[str, str]:
        """Return the columns with the opposite sign of one of them, offset included."""
        old = self._get_expression(quantity)
        offset = None if old.offset is None else ("+" if old.offset[0] == "-" else "-") + old.offset[1:]
        return self.change_column(quantity, negative=not old.negative, offset=offset)

    def omit_column(self, quantity: str) -> dict[str, str]:
        """Return the columns without an optional one."""
        return {**self.named, quantity: NONE}

    def shift_zero(self, angle: float, digits: int) -> dict[str, str] | None:
        """Return the columns with an angle [rad] added to position and reference, written in degrees.

        None if position is no angle.
        """
        places = [quantity for quantity in ("position", "reference") if quantity in self.columns]
        if any(self.columns[quantity].unit not in {None, *UNITS["position"], *RAW["position"]} for quantity in places):
            return None
        return {**self.named, **{quantity: str(self._shift_expression(quantity, angle, digits)) for quantity in places}}

    def can_be_degrees(self) -> bool:
        """Return whether position may be in degrees."""
        unit = self.columns["position"].unit
        return unit is None or (UNITS["position"].get(unit, DEGREE) != DEGREE)

    def _get_expression(self, quantity: str) -> Expression:
        """Return the expression that reads a column as before."""
        column = self.columns[quantity]
        return replace(column.expression, name=column.header, unit=column.expression.unit or column.unit)

    def _shift_expression(self, quantity: str, angle: float, digits: int) -> Expression:
        old, column = self._get_expression(quantity), self.columns[quantity]
        degrees = math.remainder((column.offset + angle) / DEGREE, 360.0)
        text = f"{degrees:+.{digits}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        is_told = column.unit is not None and UNITS["position"].get(column.unit) == DEGREE
        return replace(old, offset=text, offset_unit=None if is_told else "deg")
