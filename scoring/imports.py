"""Importing what is large."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def imports_kept() -> Iterator[None]:
    """Import without the garbage collector, and freeze the imported objects afterwards.

    Collecting them takes a sixth of the import time, and later 0.05 s at any moment, in which no
    key is answered and no run goes on.
    """
    modules_before = len(sys.modules)
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
        if len(sys.modules) > modules_before:
            gc.freeze()
    finally:
        if collecting:
            gc.enable()
