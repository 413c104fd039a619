"""Environments of the project in Gymnasium: names, and registration as soon as Gymnasium is loaded."""

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"
ARM = "pendulum_env/PlanarArm-v0"
DESIGN = "pendulum_env/ExcitationDesign-v0"
ARM_DESIGN = "pendulum_env/ArmExcitationDesign-v0"

ENTRY_POINTS = {  # one environment, and a batch of them; found only when made: nothing here knows of agents
    PENDULUM: ("pendulum_env.env:DirectDrivePendulum", "pendulum_env.vector_env:DirectDrivePendulumVector"),
    ARM: ("pendulum_env.arms.env:PlanarArm", None),
    DESIGN: ("agents.design_env:ExcitationDesign", "agents.design_env:ExcitationDesignVector"),
    ARM_DESIGN: ("agents.arm_env:ArmExcitationDesign", "agents.arm_env:ArmExcitationDesignVector"),
}
REGISTRY = "gymnasium.envs.registration"


def register_environments() -> None:
    """Register the environments now, or when Gymnasium is imported: recordings and physics do without it."""
    if REGISTRY in sys.modules:
        _register_in(sys.modules[REGISTRY])
    else:
        sys.meta_path.insert(0, _RegistryFinder())


def _register_in(registry: ModuleType) -> None:
    for id, (single, batch) in ENTRY_POINTS.items():
        registry.register(id, entry_point=single, vector_entry_point=batch)


class _RegistryFinder(MetaPathFinder):
    """Find Gymnasium's registry as Python does, with a loader that adds the environments."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != REGISTRY:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _RegistryLoader(spec.loader)
        return spec


class _RegistryLoader(Loader):
    """Load Gymnasium's registry, then add the environments."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        _register_in(module)
