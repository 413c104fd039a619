"""A page on a fleet: what is missing where, what drifts, which joints differ, and every case."""

from workbench.report.fleet.page import render, write_fleet_report

__all__ = ["render", "write_fleet_report"]
