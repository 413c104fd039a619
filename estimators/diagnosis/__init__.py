"""Diagnosis: treatments of recordings, verdicts on effects, and the next experiment."""
