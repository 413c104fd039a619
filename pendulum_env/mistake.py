"""What a user can get wrong, apart from what a program can."""

import traceback


class Mistake(ValueError):
    """Input that cannot be used; the message is one sentence: what is wrong, where, and what to do about it."""


def told(error: BaseException) -> str:
    """Kind and message of any exception, even of one that cannot say it."""
    return "".join(traceback.format_exception_only(error)).strip()
