"""Words of the command line; they are those by which results describe themselves."""

from pendulum_env.words import bar, plus_minus
from pendulum_env.words import listing as enumerate_words

__all__ = ["bar", "enumerate_words", "plus_minus"]
