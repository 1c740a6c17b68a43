"""The one root exception of `recorder`, and what to do when the system has too little."""

from __future__ import annotations

import errno

_TOO_LITTLE = {
    errno.EMFILE: "raise `ulimit -n`",
    errno.ENFILE: "end other programs",
    errno.ENOMEM: "end other programs",
    errno.EAGAIN: "end other programs",
}


class RecorderError(Exception):
    """A bag cannot be written or read; the message names it and the remedy."""


def remedy(error: Exception) -> str | None:
    """What to do where file handles, memory or processes run out; None for other causes."""
    if isinstance(error, MemoryError):
        return _TOO_LITTLE[errno.ENOMEM]
    return _TOO_LITTLE.get(error.errno or 0) if isinstance(error, OSError) else None
