"""Findings and results in words: the one place that makes sentences for terminal, notebook, report and app."""

from workbench.narrator.findings import describe

__all__ = ["describe"]
