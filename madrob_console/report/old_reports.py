"""Whether the report in the folder of a run is of the result that lies beside it."""

from __future__ import annotations

from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.files.bounded import read_bounded
from madrob_console.report.markup import made_of, team_of

_HEAD = 1000  # bytes of a report in which it says what it was made of


def report_is_old(folder: Path) -> bool:
    """Whether there is a report that says it was made of another journal than the result."""
    try:
        told = made_of(_head(folder))
        result, _ = read_result(str(folder))
    except (OSError, UnusableResultError):
        return False
    return None not in (told, result.journal) and told != result.journal


def team_told(folder: Path) -> str | None:
    """Digest of the team's other runs that the report tells of; None where it tells of none."""
    try:
        return team_of(_head(folder))
    except OSError:
        return None


def _head(folder: Path) -> str:
    head, _ = read_bounded(str(folder / REPORT_FILE), _HEAD)
    return head.decode(errors="replace")
