"""Runs on the command line: a path, or what the results folder calls the run."""

from __future__ import annotations

import argparse
from pathlib import Path

from madrob_console.cli.options import results_folder
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind

_ONE = ("run", "rest", "weight")
"""Arguments that take one run or recording; `paths` takes any number, `testbed` one to replay."""


def find_runs(arguments: argparse.Namespace) -> None:
    """Put the path of each run in the place of its name, in whatever takes runs.

    Raises:
        MadrobError: two runs are called so, or the settings cannot be read that say where they are.
    """
    for name in _ONE:
        if isinstance(named := getattr(arguments, name, None), Path):
            setattr(arguments, name, _found(named, arguments))
    if paths := getattr(arguments, "paths", None):
        arguments.paths = [_found(path, arguments) for path in paths]
    testbed: list[str] = getattr(arguments, "testbed", None) or []
    if testbed[:1] == [SourceKind.REPLAY]:
        arguments.testbed = [testbed[0], str(_found(Path(testbed[1]), arguments))]


def _found(named: Path, arguments: argparse.Namespace) -> Path:
    """What is there stays as it is, and so does what is no name of a run."""
    from madrob_console.archive.folders import PRACTICE_FOLDER, parse_folder_name

    named = named.expanduser()
    if parse_folder_name(str(named)) is None or named.exists():
        return named
    from madrob_console.config import load_settings

    settings = load_settings(getattr(arguments, "settings", None))
    results = results_folder(arguments, settings)
    official, practice = results / named, results / PRACTICE_FOLDER / named
    if official.exists() and practice.exists():
        raise MadrobError(f"{named}: two runs are called so: give {official} or {practice}")
    return practice if practice.exists() else official
