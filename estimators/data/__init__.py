"""Recordings prepared for fits of models."""
