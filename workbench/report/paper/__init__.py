"""The page about the paper's experiment: what was done, Table 2 side by side, what each care buys, figures 2 to 9."""

from workbench.report.paper.page import SECTIONS, render, write_paper_report

__all__ = ["SECTIONS", "render", "write_paper_report"]
