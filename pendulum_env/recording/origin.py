"""Columns of the file of a recording, and options that read them differently."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pendulum_env.recording.columns import NONE, FileColumn, write_unit
from pendulum_env.recording.expression import Expression
from pendulum_env.recording.vocabulary import LINEAR, RAW, UNITS

DEGREE = UNITS["position"]["deg"]  # [rad]


@dataclass(frozen=True)
class Origin:
    """Columns from which a recording was read.

    Attributes:
        columns: recognised or given columns by quantity.
        named_columns: expressions of the user by quantity.
        are_counts: whether position may be encoder counts: integers without a unit with a range above 720.
    """

    columns: Mapping[str, FileColumn]
    named_columns: Mapping[str, str] = field(default_factory=dict)
    are_counts: bool = False

    @property
    def is_prismatic(self) -> bool:
        """Return whether positions are in metres, as of a linear joint."""
        return self.columns["position"].unit in LINEAR["position"]

    @property
    def has_integral(self) -> bool:
        """Return whether position is the integral of a velocity."""
        return self.columns["position"].is_integral

    def change_column(self, quantity: str, **changes: Any) -> dict[str, str]:
        """Return the option `columns` with changes of the `Expression` of a quantity."""
        return {**self.named_columns, quantity: str(replace(self._get_expression(quantity), **changes))}

    def change_to_counts(self) -> dict[str, str]:
        """Return the option `columns` with position in counts, for example 4096 per turn."""
        factors = ("/4096", *self._get_expression("position").factors)
        return self.change_column("position", unit="counts", factors=factors)

    def change_to_counter(self, jump: float) -> dict[str, str] | None:
        """Return the option `columns` with position in counts of a counter that starts again, by its jump [rad].

        The counter has a whole number of turns, each of the counts that the user gave. Return None without counts.
        """
        column = self.columns["position"]
        first, *others = column.expression.factors or ("",)
        if column.unit not in RAW["position"] or not first.startswith("/"):
            return None
        turns = round(jump / column.turn)
        return self.change_column("position", factors=(f"/{turns * float(first[1:]):g}", f"*{turns}", *others))

    def flip_sign(self, quantity: str) -> dict[str, str] | None:
        """Return the option `columns` with the opposite sign of a quantity, including its offset; None without it."""
        if quantity not in self.columns or self.columns[quantity].is_integral:
            return None
        column = self._get_expression(quantity)
        offset = None if column.offset is None else ("+" if column.offset[0] == "-" else "-") + column.offset[1:]
        return self.change_column(quantity, is_negative=not column.is_negative, offset=offset)

    def apply_gear(self, quantity: str, ratio: float) -> dict[str, str] | None:
        """Return the option `columns` with the last factors of position, which a quantity lacks.

        Return None if no product of them is within a tenth of the ratio, in size.
        """
        factors, column = self.columns["position"].expression.factors, self._get_expression(quantity)
        for k in range(len(factors)):
            gain = Expression("", factors=factors[k:]).gain
            if 0.9 < abs(gain / ratio) < 1.1 and not 0.5 < abs(gain) < 2.0:
                is_negative = column.is_negative ^ (gain * ratio < 0)
                return self.change_column(quantity, factors=(*column.factors, *factors[k:]), is_negative=is_negative)
        return None

    def omit_column(self, quantity: str) -> dict[str, str]:
        """Return the option `columns` without an optional quantity."""
        return {**self.named_columns, quantity: NONE}

    def shift_zero(self, angle: float, digits: int) -> dict[str, str] | None:
        """Return the option `columns` with an angle [rad] added to position and reference, written in degrees.

        Return None if position is not an angle, or the integral of a velocity.
        """
        if self.has_integral:
            return None
        places = [quantity for quantity in ("position", "reference") if quantity in self.columns]
        if any(self.columns[quantity].unit not in {None, *UNITS["position"], *RAW["position"]} for quantity in places):
            return None
        shifted = {quantity: str(self._shift_expression(quantity, angle, digits)) for quantity in places}
        return {**self.named_columns, **shifted}

    def can_be_degrees(self) -> bool:
        """Return whether position may be in degrees: its unit is unknown, or radians by its name or the user."""
        if self.has_integral:
            return False
        unit = self.columns["position"].unit
        return unit is None or UNITS["position"].get(unit) == 1.0

    def _get_expression(self, quantity: str) -> Expression:
        """Return the current expression of a column."""
        column = self.columns[quantity]
        unit = column.expression.unit or (column.unit and write_unit(quantity, column.unit))
        return replace(column.expression, name=column.header, unit=unit)

    def _shift_expression(self, quantity: str, angle: float, digits: int) -> Expression:
        expression, column = self._get_expression(quantity), self.columns[quantity]
        degrees = math.remainder((column.offset + angle) / DEGREE, 360.0)
        text = f"{degrees:+.{digits}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        is_in_degrees = column.unit is not None and UNITS["position"].get(column.unit) == DEGREE
        return replace(expression, offset=text, offset_unit=None if is_in_degrees else "deg")
