"""Whether the report in the folder of a run is of the result that lies beside it."""

from __future__ import annotations

from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.files.bounded import read_bounded
from madrob_console.report.markup import made_of

_HEAD = 1000  # bytes of a report in which it says what it was made of


def report_is_old(folder: Path) -> bool:
    """Whether there is a report that says it was made of another journal than the result."""
    try:
        head, _ = read_bounded(str(folder / REPORT_FILE), _HEAD)
        result, _ = read_result(str(folder))
    except (OSError, UnusableResultError):
        return False
    told = made_of(head.decode(errors="replace"))
    return None not in (told, result.journal) and told != result.journal
