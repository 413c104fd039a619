"""Decisions between models: errors, steps, gates, the criterion and the score."""
