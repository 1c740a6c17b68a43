"""A command line that names no testbed: the engine that runs already is meant."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from madrob_console.cli import options
from madrob_console.cli.parsing import Parser
from madrob_console.cli.problems import BAD_INPUT, complain
from madrob_console.engine.process.engines import FoundEngine, all_engines

_NAMING = ("testbed", "domain", "results", "settings", *options.SIMULATION)
"""The options of which any says which engine is meant."""


def engines_meant(arguments: argparse.Namespace, results: Path) -> tuple[FoundEngine, ...]:
    """The engines to which a command line without a testbed could attach; none for any other.

    Args:
        arguments: the command line.
        results: the folder of its settings; the engine that keeps its runs there is meant alone.
    """
    usual = _parsed(())
    if any(getattr(arguments, name) != getattr(usual, name) for name in _NAMING):
        return ()
    found, _ = all_engines()
    engines = tuple(one for one in found if one.presence is not None and one.presence.console)
    return tuple(one for one in engines if one.results == results) or engines


def mean(arguments: argparse.Namespace, engine: FoundEngine) -> None:
    """Let a command line mean an engine, as if what names it had been typed."""
    assert engine.presence is not None
    typed = _parsed(engine.presence.console)
    for name in _NAMING:
        setattr(arguments, name, getattr(typed, name))


def ask_which(engines: Sequence[FoundEngine], command: str, results: Path) -> int:
    """Say which engines run and what to type for each; returns the exit code.

    Args:
        engines: them.
        command: that is to attach, `console` or `watch`.
        results: the folder of the settings; a console starts an engine for it.
    """
    from madrob_console.cli.running_engines import status_line

    count = "1 engine runs" if len(engines) == 1 else f"{len(engines)} engines run"
    complain(f"{count}: type the line of the one that you mean")
    for one in engines:
        print(f"  {status_line(one)}\n    {one.attach_line(command)}", file=sys.stderr)
    if command == "console":
        own = shlex.join(["madrob", command, "--results", str(results)])
        print(f"  none yet for the results folder of your settings\n    {own}", file=sys.stderr)
    return BAD_INPUT


def _parsed(words: Sequence[str]) -> argparse.Namespace:
    """What names a testbed; what a later version says beyond that is left out."""
    parser = Parser(add_help=False)
    options.add_testbed(parser)
    return parser.parse_known_args(list(words))[0]
