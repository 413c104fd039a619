"""What a user can get wrong, apart from what a program can."""


class Mistake(ValueError):
    """Input that cannot be used; the message is one sentence: what is wrong, where, and what to do about it."""
