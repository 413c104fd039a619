"""Environments are known to Gymnasium without an import.

Gymnasium read the entry points `gymnasium.envs` up to version 0.29 and reads none since 1.0. So a `.pth` file imports
this package when Python starts, and this module, which imports nothing heavy, waits until Gymnasium is imported.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

REGISTRY = "gymnasium.envs"  # the module that registers Gymnasium's own environments


def announce() -> None:
    """Register the environments with Gymnasium: now if it is imported, else as soon as it is."""
    if REGISTRY in sys.modules:
        register_envs()
    elif not any(isinstance(finder, _AfterGymnasium) for finder in sys.meta_path):
        sys.meta_path.insert(0, _AfterGymnasium())


def register_envs() -> None:
    """Add the environments to Gymnasium's registry."""
    from gymnasium.envs.registration import register, registry

    from pendulum_env.registration import ENVIRONMENTS

    for id, what in ENVIRONMENTS.items():
        if id not in registry:
            register(id, **what)


class _AfterGymnasium:
    """Finder that finds nothing itself: it lets the import of Gymnasium happen, then registers."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Spec of Gymnasium's registry as the other finders know it, with the registration behind its execution."""
        if name != REGISTRY:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                register_envs()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
