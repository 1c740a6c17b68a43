"""The socket at which screens attach: made again, elsewhere if need be, when it is lost.

Whoever ends a login may remove its runtime folder. Consoles ask the engine where its socket lies
(`control.py`), so that it may lie in any folder that is the user's own.
"""

from __future__ import annotations

import os
import socket
import tempfile
from contextlib import suppress
from pathlib import Path

from madrob_console.engine.process.place import make_private
from madrob_console.errors import MadrobError


class Listening:
    """A Unix socket with a path, mode 0600.

    Args:
        path: where it is wanted; one of an engine that was killed is replaced.

    Attributes:
        path: where it is.
        problem: why it is nowhere, in words; None while it is there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem: str | None = None
        self._wanted = path
        self._made: tuple[int, int] | None = None

    def open(self) -> socket.socket:
        """Make it; it listens as soon as it can be seen.

        Raises:
            MadrobError: it cannot be made; the message says what to do.
        """
        try:
            return self._at(self._wanted)
        except OSError as error:
            raise MadrobError(
                f"{self._wanted}: no socket can be made there ({error}); set XDG_RUNTIME_DIR to "
                "another folder of your own, with a short path"
            ) from None

    def open_again(self) -> socket.socket | None:
        """Make it again if it is lost or another's; None while it is there, or cannot be made.

        The folder is made again, too. Where that is not allowed the socket goes to a folder of its
        own among the temporary ones.
        """
        if self._is_there():
            return None
        for find in (self._wanted_place, self._temporary_place):
            try:
                listening = self._at(find())
            except OSError as error:
                self.problem = f"screens cannot attach: {self._wanted} is lost ({error.strerror})"
            else:
                self.problem = None
                return listening
        return None

    def close(self) -> None:
        """Take it away, if it is still this one."""
        if self._is_there():
            with suppress(OSError):
                self.path.unlink()
        if self.path.parent != self._wanted.parent:
            with suppress(OSError):
                self.path.parent.rmdir()

    def _is_there(self) -> bool:
        try:
            found = self.path.lstat()
        except OSError:
            return False
        return (found.st_dev, found.st_ino) == self._made

    def _wanted_place(self) -> Path:
        make_private(self._wanted.parent)
        folder = self._wanted.parent.lstat()
        if folder.st_uid != os.getuid() or folder.st_mode & 0o077:
            raise PermissionError(0, "others may enter its folder")
        if _answers(self._wanted):  # another engine's
            return self._wanted.with_stem(f"{self._wanted.stem}_{os.getpid()}")
        return self._wanted

    def _temporary_place(self) -> Path:
        return Path(tempfile.mkdtemp(prefix="madrob-")) / self._wanted.name

    def _at(self, path: Path) -> socket.socket:
        part = path.with_suffix(".new")
        part.unlink(missing_ok=True)
        listening = socket.socket(socket.AF_UNIX)
        try:
            os.fchmod(listening.fileno(), 0o600)  # before it has a path: nobody sees it otherwise
            listening.bind(str(part))
            listening.listen()
            found = part.lstat()
            part.replace(path)
        except OSError:
            listening.close()
            raise
        self.path, self._made = path, (found.st_dev, found.st_ino)
        return listening


def _answers(path: Path) -> bool:
    """Whether somebody listens there."""
    with socket.socket(socket.AF_UNIX) as knock:
        knock.settimeout(1.0)
        try:
            knock.connect(str(path))
        except (BlockingIOError, TimeoutError):
            return True
        except OSError:
            return False
        return True
