"""The report: one self-contained HTML file that tells, shows and explains a diagnosis."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from workbench.report.page import render, render_comparison, write_report
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["render", "render_comparison", "write_report"]
