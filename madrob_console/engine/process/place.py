"""Where an engine can be found: one folder of the user, one name for each testbed."""

from __future__ import annotations

import fcntl
import hashlib
import os
import stat
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_runtime_path

from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind


@dataclass(frozen=True, slots=True)
class Place:
    """The files of the engine of one testbed.

    Attributes:
        folder: the user's own; nobody else may enter it.
        name: of the testbed; the same for every console that means the same testbed.
    """

    folder: Path
    name: str

    @property
    def socket(self) -> Path:
        """Where it listens; only while it runs."""
        return self.folder / f"{self.name}.sock"

    @property
    def log(self) -> Path:
        """What it says, for people."""
        return self.folder / f"{self.name}.log"

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Be the testbed's one engine while inside.

        Raises:
            MadrobError: another one is.
        """
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        lock = os.open(self.folder / f"{self.name}.lock", flags, 0o600)
        try:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise MadrobError(
                    f"an engine for {self.name} runs already: `madrob console` attaches to it, "
                    "`madrob engine stop` ends it"
                ) from None
            yield
        finally:
            os.close(lock)


def runtime_folder() -> Path:
    """The user's folder for sockets, made with mode 0700 if there is none.

    Raises:
        MadrobError: it cannot be made, or others may enter it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a fallback in /tmp: it is checked below
        folder = user_runtime_path("madrob")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be used for the engine's socket ({error.strerror}); set "
            "XDG_RUNTIME_DIR to a folder of your own"
        ) from None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    if not own or stat.S_IMODE(found.st_mode) & 0o077:
        raise MadrobError(
            f"{folder}: others may enter it; make it yours with `chmod 700`, or set "
            "XDG_RUNTIME_DIR to a folder of your own"
        )
    return folder


def place_of(kind: str, *what: object) -> Place:
    """The place of a testbed: its kind, and what tells it from others of that kind.

    Raises:
        MadrobError: there is no folder for it.
    """
    if kind == SourceKind.ROS:
        name = f"ros_domain_{what[0]}"
    else:
        digest = hashlib.blake2s("\n".join(map(str, what)).encode(), digest_size=4).hexdigest()
        name = f"{kind}_{digest}"
    return Place(runtime_folder(), name)


def known_places() -> tuple[Place, ...]:
    """Every place with a socket; its engine may have been killed.

    Raises:
        MadrobError: there is no folder for them.
    """
    folder = runtime_folder()
    return tuple(Place(folder, path.stem) for path in sorted(folder.glob("*.sock")))
