"""Format arguments in messages: as Python arguments, or as options of the command line."""

from collections.abc import Callable

Writer = Callable[[str, object], str]


class Blank(str):
    """Placeholder in a message for a value of the user."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def format_argument(name: str, value: object) -> str:
    """Format an argument of a call: `unwrap=True`, `columns={'torque': 'tau'}`."""
    return f"{name}={value!r}"


_write: Writer = format_argument


def format_setting(name: str, value: object) -> str:
    """Format an argument by the current writer: as a Python argument or a command line option."""
    return _write(name, value)


def use_writer(writer: Writer) -> Writer:
    """Set the writer of arguments for this process; return the previous writer."""
    global _write
    previous, _write = _write, writer
    return previous
