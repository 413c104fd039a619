"""Texts of findings and results for terminal, notebook, report and app."""

from workbench.narrator.findings import describe

__all__ = ["describe"]
