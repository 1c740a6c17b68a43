"""Waiting for what a thread or a process does, as long as it takes and no longer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE = 30.0  # s; only a test that fails waits so long
_BETWEEN_LOOKS = 0.005  # s
_T = TypeVar("_T")


def until(look: Callable[[], _T], patience: float = PATIENCE) -> _T:
    """Look again and again until what is seen is true; what was seen.

    Raises:
        AssertionError: it did not become true within `patience` seconds; with what was seen last.
    """
    end, pause = time.monotonic() + patience, threading.Event()
    while not (seen := look()):
        assert time.monotonic() < end, f"waited {patience:g} s in vain, last seen: {seen!r}"
        pause.wait(_BETWEEN_LOOKS)
    return seen
