"""The environments that Gymnasium knows: id, where they are, and their usual settings."""

from __future__ import annotations

from typing import Any

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"
DESIGN = "pendulum_env/ExcitationDesign-v0"

ENVIRONMENTS: dict[str, dict[str, Any]] = {
    PENDULUM: {
        "entry_point": "pendulum_env.env:DirectDrivePendulum",
        "vector_entry_point": "pendulum_env.vector_env:DirectDrivePendulumVector",
    },
    DESIGN: {
        "entry_point": "agents.design_env:ExcitationDesign",
        "vector_entry_point": "agents.design_env:ExcitationDesignVector",
    },
}
