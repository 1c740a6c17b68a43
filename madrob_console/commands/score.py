"""`madrob score`: recorded runs to results."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import msgspec

from madrob_console.cli import BAD_INPUT
from madrob_console.commands.table import result_lines
from madrob_console.engine.results import scores
from madrob_console.errors import MadrobError
from madrob_console.rescore import ScoredPath, score_path


def main(arguments: argparse.Namespace) -> int:
    """Score every path; a bad one is named and does not stop the rest."""
    documents: list[Any] = []
    bad = 0
    for path in arguments.paths:
        try:
            scored = score_path(path, arguments.ruleset)
        except MadrobError as error:
            print(f"madrob: {error}", file=sys.stderr)
            bad += 1
            continue
        if arguments.json:
            documents += [{"path": str(s.path)} | scores(s.result) for s in scored]
        else:
            for one in scored:
                _print(one)
    if arguments.json:
        text = msgspec.json.encode({"runs": documents})
        print(msgspec.json.format(text, indent=2).decode())
    return BAD_INPUT if bad else 0


def _print(scored: ScoredPath) -> None:
    print(scored.path)
    for line in result_lines(scored.result):
        print(f"  {line}")
