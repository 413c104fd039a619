"""Recordings as models are fitted to them."""
