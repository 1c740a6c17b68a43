"""Whether the result of a run says what its journal says, which is what counts."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.listed_result import ListedResult
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.files.bounded import read_all
from madrob_console.referee.journal import LARGEST_JOURNAL, read_journal
from madrob_console.referee.journal_mark import mark_of
from madrob_console.referee.on_record import JournalMark
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Run

Details = dict[str, int | str]

_DIGEST = "sha256"


class _Marked(msgspec.Struct):
    journal: JournalMark | None = None


def written_details(result: bytes | memoryview, issue: int) -> Details:
    """What the journal's line `result written` says of a `result.json`.

    Args:
        result: its content.
        issue: its number.
    """
    mark = msgspec.json.decode(result, type=_Marked).journal
    lines = 0 if mark is None else mark.lines
    return {"issue": issue, "lines": lines, _DIGEST: hashlib.sha256(result).hexdigest()}


def was_changed(data: bytes, folder: Path) -> bool:
    """Whether a `result.json` is another one than the journal beside it says was written.

    The journal's line follows the file. A result made of more lines than the last one that was
    noted waits for its line; a kill can come between the two. A journal of an earlier version has
    no digests, and one that cannot be used says nothing here.

    Args:
        data: its content.
        folder: of the run.

    Raises:
        msgspec.MsgspecError: it is no JSON.
    """
    path = folder / JOURNAL_FILE
    try:
        if hashlib.sha256(data).hexdigest().encode() in read_all(path, LARGEST_JOURNAL):
            return False
        entries, _ = read_journal(path)
    except OSError:
        return False
    noted = [entry.details for entry in entries if entry.what == Change.RESULT_WRITTEN]
    if not noted or _DIGEST not in noted[-1]:
        return False
    mark = msgspec.json.decode(data, type=_Marked).journal
    return mark != mark_of(entries) or noted[-1].get("lines") == mark.lines


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
