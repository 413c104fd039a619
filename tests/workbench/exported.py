"""Exported models at work: a module, a compiled file of C, a run of MuJoCo."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from workbench.export import Exported

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")


def load_module(text: str) -> ModuleType:
    """The module of a text in Python."""
    made = ModuleType("exported")
    exec(text, made.__dict__)
    return made


def compile_library(text: str, folder: Path) -> ctypes.CDLL:
    """A file of C, compiled without a warning; a folder holds one, as a library is loaded once."""
    folder.mkdir(exist_ok=True)
    source, made = folder / "exported.c", folder / "exported.so"
    source.write_text(text)
    options = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["gcc", *options, "-o", made, source, "-lm"], check=True)
    return ctypes.CDLL(str(made))


def simulate_in_mujoco(exported: Exported, commands: np.ndarray, on: np.ndarray | None = None) -> np.ndarray:
    """Position (N + 1,) from rest under torques or goals (N,), of a motor that may be off."""
    mujoco = pytest.importorskip("mujoco")
    world = mujoco.MjModel.from_xml_string(exported.content)
    data, path = mujoco.MjData(world), [0.0]
    for k, value in enumerate(commands.tolist()):
        data.ctrl[0], world.opt.disableactuator = value, int(on is not None and not on[k])
        mujoco.mj_step(world, data)
        path.append(data.qpos[0])
    return np.array(path)


def compute_error(path: np.ndarray, own: np.ndarray) -> float:
    """How far one path is from another, of its motion."""
    return float(np.sqrt(np.mean((path - own) ** 2)) / np.std(own))
