"""Search for the effects that a model lacks."""
