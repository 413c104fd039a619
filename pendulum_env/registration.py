"""Names of the environments, and their registration when Gymnasium is imported."""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"
ARM = "pendulum_env/PlanarArm-v0"
DESIGN = "pendulum_env/ExcitationDesign-v0"
ARM_DESIGN = "pendulum_env/ArmExcitationDesign-v0"

ENTRY_POINTS = {  # environment and batch, imported by Gymnasium at the first use
    PENDULUM: ("pendulum_env.env:DirectDrivePendulum", "pendulum_env.vector_env:DirectDrivePendulumVector"),
    ARM: ("robots.arms.env:PlanarArm", None),
    DESIGN: ("agents.design_env:ExcitationDesign", "agents.design_env:ExcitationDesignVector"),
    ARM_DESIGN: ("robots.arms.design_env:ArmExcitationDesign", "robots.arms.design_env:ArmExcitationDesignVector"),
}
REGISTRY = "gymnasium.envs.registration"


def register_environments() -> None:
    """Register the environments now, or later when Gymnasium is imported."""
    if REGISTRY in sys.modules:
        _register_in(sys.modules[REGISTRY])
    else:
        sys.meta_path.insert(0, _RegistryFinder())


def _register_in(registry: ModuleType) -> None:
    for id, (single, batch) in ENTRY_POINTS.items():
        registry.register(id, entry_point=single, vector_entry_point=batch)


class _RegistryFinder(MetaPathFinder):
    """Find Gymnasium's registry module, and let its loader register the environments."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != REGISTRY:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register_in(module)

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
