"""Rows of a survey that tests share."""

from datetime import UTC, datetime, timedelta

import numpy as np

from pendulum_env._typing import JSON

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)


def surveyed_rows() -> list[JSON]:
    """Rows of three machines over 12 weeks: coulomb drifts in one, inertia jumps in another."""
    rng, rows = np.random.default_rng(0), []
    for machine in ("drifts", "jumps", "stays"):
        for week in range(12):
            coulomb = 0.9 + 0.01 * week * (machine == "drifts")
            inertia = 0.09 + 0.05 * (week >= 8) * (machine == "jumps")
            row: JSON = {
                "recording": f"{machine}/{week}.csv",
                "machine": machine,
                "joint": "",
                "date": BEGAN + timedelta(weeks=week),
                "effects": "",
                "selected": [],
                "unexplained": False,
                "biased": False,
                "error_after": 0.01,
                "error_unit": "N m",
                "parameters": {
                    name: {"value": value + rng.normal(0, 0.004), "std": 0.004, "unit": unit}
                    for name, value, unit in (("coulomb", coulomb, "N m"), ("inertia", inertia, "kg m^2"))
                },
            }
            rows.append(row)
    return rows
