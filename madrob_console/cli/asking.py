"""What a command asks whoever sits at the terminal."""

from __future__ import annotations

import sys


def somebody_there() -> bool:
    """Whether there is somebody to ask."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def says_yes(question: str) -> bool:
    """Whether somebody at a terminal says yes."""
    if not somebody_there():
        return False
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False
