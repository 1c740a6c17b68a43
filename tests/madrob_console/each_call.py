"""A fault at one of the calls by which an engine changes its results folder.

`each_call.c` is loaded into the engine before everything else and stands between it and the C
library. A run without a fault lists the calls; then each can be the one at which something happens.
A call is known by its name, its file, and how often that came: the threads of an engine take turns
in another order each time, but what each of them does to its own file is the same.
"""

from __future__ import annotations

import errno
import hashlib
import struct
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory

from madrob_console.common.version import software_version

_SOURCE = Path(__file__).with_name("each_call.c")
_SHARED = struct.Struct("qqqq")  # as in each_call.c


class CallFault(StrEnum):
    """What happens at a call."""

    KILLED = "process killed"
    POWER_CUT = "power cut"
    IO_ERROR = "EIO"
    NO_SPACE = "ENOSPC"
    NO_HANDLES = "EMFILE"
    HANG = "hang"

    @property
    def ends_the_engine(self) -> bool:
        """Whether it is gone after that."""
        return self in (CallFault.KILLED, CallFault.POWER_CUT)

    def fits(self, call: Call) -> bool:
        """Whether it can come at a call; to look changes nothing on the disk."""
        match self:
            case CallFault.NO_HANDLES:
                return call.name in ("open", "look")
            case CallFault.NO_SPACE:
                return call.name not in ("look", "unlink", "rmdir")
            case CallFault.KILLED | CallFault.POWER_CUT:
                return call.name != "look"
            case _:
                return True

    @property
    def word(self) -> str:
        """For each_call.c."""
        match self:
            case CallFault.KILLED:
                return "kill"
            case CallFault.POWER_CUT:
                return "power"
            case CallFault.HANG:
                return "hang"
            case CallFault.IO_ERROR:
                return str(errno.EIO)
            case CallFault.NO_SPACE:
                return str(errno.ENOSPC)
            case CallFault.NO_HANDLES:
                return str(errno.EMFILE)


@dataclass(frozen=True, slots=True)
class Call:
    """One of an engine's calls.

    Attributes:
        name: of the call; `look` opens what is not changed.
        file: the name of what it is for, digits and random parts left out.
        number: from 1: how often it came.
    """

    name: str
    file: str
    number: int

    def __str__(self) -> str:
        return f"{self.name} {self.file} {self.number}"


@dataclass(frozen=True, slots=True)
class Happened:
    """What was noted of a run.

    Attributes:
        at: when the fault came, s of the monotonic clock; None = it did not.
        hangs_until: when a hang ends, on the same clock.
    """

    at: float | None
    hangs_until: float


class Trap:
    """Waits in an engine for one call.

    Args:
        folder: what is changed in there counts.
        notes: a folder for files of its own.
        fault: what happens.
        call: at which one; None = none, they are only listed.
        hang: how long a hang lasts, s.
    """

    def __init__(
        self,
        folder: Path,
        notes: Path,
        fault: CallFault = CallFault.KILLED,
        call: Call | None = None,
        hang: float = 0.0,
    ) -> None:
        self._state = notes / "each_call.state"
        self._state.write_bytes(bytes(_SHARED.size))
        self._log = notes / "each_call.log"
        self._log.touch()
        self.environment = {
            "EACH_CALL_FOLDER": str(folder.resolve()),
            "EACH_CALL_STATE": str(self._state),
            "EACH_CALL_LOG": str(self._log),
        }
        if call is not None:
            self.environment |= {
                "EACH_CALL_NAME": call.name,
                "EACH_CALL_FILE": call.file,
                "EACH_CALL_NUMBER": str(call.number),
                "EACH_CALL_FAULT": fault.word,
                "EACH_CALL_HANG": f"{hang:g}",
            }

    def calls(self) -> tuple[Call, ...]:
        """All that came so far, in their order."""
        count: Counter[str] = Counter()
        calls = []
        for line in self._log.read_text().splitlines():
            name, _, file = line.partition(" ")
            count[line] += 1
            calls.append(Call(name, file, count[line]))
        return tuple(calls)

    def happened(self) -> Happened:
        """What came of it so far."""
        _, fired, hangs_to, came_at = _SHARED.unpack(self._state.read_bytes())
        return Happened(came_at / 1e9 if fired else None, hangs_to / 1e9)


@contextmanager
def compiled() -> Iterator[Path]:
    """`each_call.c` as a library; needs a compiler and the C library's headers."""
    with TemporaryDirectory(prefix="madrob-") as folder:
        library = Path(folder) / "each_call.so"
        command = ["cc", "-shared", "-fPIC", "-O2", "-o", str(library), str(_SOURCE), "-ldl"]
        made = subprocess.run(command, check=False, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        yield library


def share_of_this_commit(shares: int) -> int:
    """Which of so many shares of the calls is this commit's turn: no two have the same version."""
    digest = hashlib.blake2s(software_version().encode(), digest_size=4)
    return int.from_bytes(digest.digest(), "big") % shares
