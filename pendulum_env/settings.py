"""Arguments that mend a mistake, as messages name them: those of a call in Python, or the options of a program."""

from collections.abc import Callable

Writer = Callable[[str, object], str]


class Blank(str):
    """A value that the reader has to fill in."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def as_argument(name: str, value: object) -> str:
    """Write an argument of a call: `unwrap=True`, `columns={'torque': 'tau'}`."""
    return f"{name}={value!r}"


_write: Writer = as_argument


def setting(name: str, value: object) -> str:
    """Write an argument of this library in the words of the program that runs."""
    return _write(name, value)


def use_writer(writer: Writer) -> Writer:
    """Let messages of this process name arguments as a program does, by its options; return the writer of before."""
    global _write
    before, _write = _write, writer
    return before
