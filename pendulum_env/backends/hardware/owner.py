"""One owner for each rig: two programs must not command one motor."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from pendulum_env.backends.hardware.drive import DriveError


class Ownership:
    """A lock on a name, held by one process at a time and let go by the system when that process ends, however.

    The file lies in the folder for temporary files that all users share, as a motor has one owner whoever that is. So
    nothing there is believed: links are not followed, what is no plain file is refused, and only a file of this user's
    own is written to.
    """

    def __init__(self, what: str) -> None:
        """Take the name of what is owned, such as `serial /dev/ttyACM0`."""
        self.what = what
        digest = hashlib.sha256(what.encode()).hexdigest()[:16]
        self._path = Path(tempfile.gettempdir()) / f"pendulum-ident-{digest}.lock"
        self._file: int | None = None

    def acquire(self) -> None:
        """Become the owner, if nobody is.

        Raises:
            DriveError: if another rig owns it, with its process, or its lock cannot be trusted.
        """
        if self._file is not None:
            return
        try:
            file = self._open()
        except OSError as error:
            raise DriveError(
                f"{self.what} cannot be locked: {self._path}: {error.strerror}. This program makes plain files there, "
                "of one name: find out who put anything else in its place, and remove it"
            ) from None
        try:
            _lock(file)
        except OSError:
            owner = os.pread(file, 32, 1).decode(errors="replace") if hasattr(os, "pread") else ""
            os.close(file)
            who = f"process {owner}" if owner.isdigit() else "another program"
            raise DriveError(f"{self.what} is in use by {who}: close its environment, or end it, first") from None
        self._file = file
        if not hasattr(os, "getuid") or os.fstat(file).st_uid == os.getuid():
            with suppress(OSError):  # a full disk
                os.ftruncate(file, 0)
                os.write(file, f" {os.getpid()}".encode())  # the first byte is what is locked

    def _open(self) -> int:
        """The lock's file, and no other that a link might lead to.

        Raises:
            OSError: if it cannot be opened, or is no plain file with this name alone.
        """
        plain = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # unknown to Windows; a pipe would wait
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | plain, 0o644)
        except PermissionError:  # another user has left it, and may have let go
            file = os.open(self._path, os.O_RDONLY | plain)
        status = os.fstat(file)
        if not stat.S_ISREG(status.st_mode) or status.st_nlink != 1:
            os.close(file)
            raise OSError(errno.EINVAL, "is no plain file of one name")
        return file

    def release(self) -> None:
        """Let go; may be called twice."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
