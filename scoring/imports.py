"""Importing what is large."""

from __future__ import annotations

import gc
import sys
from importlib import import_module
from types import ModuleType


def import_kept(name: str) -> ModuleType:
    """Import a module and set everything that is there apart from the search for rubbish.

    What an import makes stays as long as the process. Searching it takes a sixth of the import,
    and later 0.05 s at any moment, in which neither a key is answered nor a run goes on.

    Args:
        name: full name of the module.

    Raises:
        ImportError: it is not installed.
    """
    if name in sys.modules:
        return import_module(name)
    searched = gc.isenabled()
    gc.disable()
    try:
        module = import_module(name)
        gc.freeze()
    finally:
        if searched:
            gc.enable()
    return module
