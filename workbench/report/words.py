"""Words of the report; they are those by which results describe themselves."""

from pendulum_env.words import duration, estimate, listing, name, number, opening, per, percent, unit, value_and_error

__all__ = ["duration", "estimate", "listing", "name", "number", "opening", "per", "percent", "unit", "value_and_error"]
