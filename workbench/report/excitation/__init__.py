"""The page about excitation policies: how soon the parameters are known, how surely, and what it takes."""

from workbench.report.excitation.page import render, write_excitation_report

__all__ = ["render", "write_excitation_report"]
