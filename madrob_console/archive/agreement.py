"""Whether the result of a run says what its journal says, which is what counts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.listed_result import ListedResult
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.referee.run import Run


def disagreement(result: ListedResult, folder: Path) -> str | None:
    """Why the result in a run folder is not what the journal beside it says; None = it is.

    A folder without a journal says nothing else.

    Raises:
        UnusableJournalError: the journal cannot be used.
    """
    try:
        run = read_run_journal(folder).run
    except FileNotFoundError:
        return None
    return ", ".join(disagreements(result, run)) or None


def disagreements(result: ListedResult, run: Run) -> Iterator[str]:
    """In what a result differs from the state of its run, in words; cheap, and not in numbers.

    Args:
        result: of this version, or of one that did not note the journal's mark.
        run: after all lines of its journal, with the journal's mark.
    """
    issue = max(1, run.issue)
    if result.issue != issue:
        yield f"issue {result.issue}, the journal has issue {issue}"
    word = "not final" if result.closure is None else result.closure.team_word
    said = "not final" if run.closure is None else run.closure.team_word.value
    if word != said:
        yield f"{word}, in the journal {said}"
    if result.outcome is not run.ending.outcome:
        yield f"{result.outcome}, in the journal {run.ending.outcome}"
    if (result.voided is None) is not (run.voided is None):
        yield "void, in the journal it counts" if result.voided else "void in the journal only"
    if result.journal is not None and result.journal != run.journal and run.journal is not None:
        yield f"made of {result.journal.lines} lines of the journal, which has {run.journal.lines}"


def out_of_date(why: str) -> str:
    """What is said of a result that is not what its journal says."""
    return (
        f"{RESULT_FILE} is not what the journal says ({why}): an engine that starts makes it again,"
        " and so does `madrob recover`"
    )
