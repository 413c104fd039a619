"""The report: one self-contained HTML file that tells, shows and explains a diagnosis."""

from workbench.report.page import render, write_comparison_report, write_report

__all__ = ["render", "write_comparison_report", "write_report"]
