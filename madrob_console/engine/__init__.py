"""RECORD, DETECT, SCORE: the run that goes on, in a process that any number of screens share.

What stands in `__all__` is the interface for programs, and nothing else is.
"""

from __future__ import annotations

from typing import Any

__all__ = ["state_schemas"]


def state_schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON schemas (draft 2020-12) of what robots and spectators read.

    `state` and `event` are of the topics `/madrob/referee/state` and `/madrob/referee/event`,
    `watch` is of a line of `madrob watch --json`.
    """
    from madrob_console.engine import public_state

    return public_state.state_schemas()
