"""Findings and results in words: the one place that makes sentences for terminal, notebook, report and app."""
