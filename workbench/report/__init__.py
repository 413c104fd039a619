"""The report: one self-contained HTML file that tells, shows and explains a diagnosis."""

from workbench.report.whole import render, render_comparison, write_report

__all__ = ["render", "render_comparison", "write_report"]
