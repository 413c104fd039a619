"""Arguments in messages, formatted for the user: as arguments of a call in Python, or as options of a program."""

from collections.abc import Callable

Writer = Callable[[str, object], str]


class Blank(str):
    """Value that the reader has to fill in."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def format_argument(name: str, value: object) -> str:
    """Write an argument of a call: `unwrap=True`, `columns={'torque': 'tau'}`."""
    return f"{name}={value!r}"


_write: Writer = format_argument


def format_setting(name: str, value: object) -> str:
    """Write an argument of this library as the running program names it."""
    return _write(name, value)


def use_writer(writer: Writer) -> Writer:
    """Set the writer of arguments in messages of this process; return the previous one."""
    global _write
    before, _write = _write, writer
    return before
