"""`madrob watch`: the referee's screens for spectators."""

from __future__ import annotations

import argparse

from madrob_console.cli.console import show
from madrob_console.engine.shown.client import Role


def main(arguments: argparse.Namespace) -> int:
    """Show the screens; no key of theirs does anything to the run."""
    return show(arguments, Role.WATCH)
