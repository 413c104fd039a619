"""Packages that offer entry points, made for a test."""

import sys
import tomllib
from pathlib import Path

import pytest

from pendulum_env.backends.hardware.adapter import ENTRY_POINTS
from tools.prose import ROOT, blocks

PAGE = ROOT / "docs" / "how-to" / "drive.md"


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, module: str, text: str, points: dict[str, str]) -> None:
    """Put a package of one module onto the path, which offers these drives by name."""
    (folder / f"{module}.py").write_text(text)
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [f"{name} = {value}" for name, value in points.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{ENTRY_POINTS}]", *lines, ""]))
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, module, raising=False)


def install_bench(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the adapter that the page shows, by the entry point that it shows."""
    shown = blocks(PAGE.read_text(encoding="utf-8"))
    adapter = next(block.text for block in shown if block.language == "python")
    project = tomllib.loads(next(block.text for block in shown if block.language == "toml"))["project"]
    install(folder, monkeypatch, "bench_drive", adapter, project["entry-points"][ENTRY_POINTS])
