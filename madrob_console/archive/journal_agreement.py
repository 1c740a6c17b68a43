"""Compares a result with its journal, which is what counts."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import read_all
from madrob_console.common.stored_json import decode
from madrob_console.referee.journal import LARGEST_JOURNAL, read_journal
from madrob_console.referee.rebuild import Change, mark_of, marks_of
from madrob_console.referee.records import JournalMark
from madrob_console.referee.run import Run

Details = dict[str, int | str]


class _Marked(msgspec.Struct):
    issue: int = 0
    journal: JournalMark | None = None


def written_details(result: bytes | memoryview) -> Details:
    """What the journal's line `result written` says of a `result.json`."""
    said = decode(result, _Marked)
    lines = 0 if said.journal is None else said.journal.lines
    return {"issue": said.issue, "lines": lines, "sha256": hashlib.sha256(result).hexdigest()}


def is_noted(data: bytes, folder: Path) -> bool:
    """Whether the journal has the digest of a `result.json`: it is as it was written."""
    digest = hashlib.sha256(data).hexdigest().encode()
    try:
        return digest in read_all(folder / JOURNAL_FILE, LARGEST_JOURNAL)
    except OSError:
        return False


def was_changed(data: bytes, folder: Path) -> bool:
    """Whether a `result.json` differs from the one that the journal says was written.

    The journal's line follows the file, and a kill can come between. So a result of more lines
    than the last one noted waits for its line. An unusable journal counts as none.
    """
    if is_noted(data, folder):
        return False
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
    except OSError:
        return False
    noted = [entry.details for entry in entries if entry.what == Change.RESULT_WRITTEN]
    if not noted:
        return False
    try:
        mark = decode(data, _Marked).journal
    except MadrobError:
        return True
    return mark != mark_of(entries) or noted[-1].get("lines") == mark.lines


def disagreement(result: ResultDocument, folder: Path) -> str | None:
    """Why a result does not agree with its journal; None = it does, or there is none."""
    try:
        run = read_run_journal(folder).run
    except FileNotFoundError:
        return None
    return ", ".join(disagreements(result, run)) or None


def disagreements(result: ResultDocument, run: Run) -> Iterator[str]:
    """The differences between a result and the state of its run; cheap, numbers left out.

    `run` has all lines and the journal's mark.
    """
    issue = max(1, run.issue)
    if result.issue != issue:
        yield f"version {result.issue}, the journal has version {issue}"
    word = "not final" if result.closure is None else result.closure.team_word
    said = "not final" if run.closure is None else run.closure.team_word.value
    if word != said:
        yield f"{word}, in the journal {said}"
    if result.outcome is not run.ending.outcome:
        yield f"{result.outcome}, in the journal {run.ending.outcome}"
    if (result.voided is None) is not (run.voided is None):
        yield "void, in the journal it counts" if result.voided else "void in the journal only"
    made_of = result.journal
    if run.journal and made_of != run.journal:
        yield f"made of {made_of.lines} lines of the journal, which has {run.journal.lines}"


def is_of_earlier_lines(result: ResultDocument, folder: Path) -> bool:
    """Whether the journal has only grown since a result: lines that it was made of are there."""
    entries, _ = read_journal(folder / JOURNAL_FILE)
    return any(mark == result.journal for mark in marks_of(entries))


def out_of_date(why: str) -> str:
    return (
        f"{RESULT_FILE} is not what the journal says ({why}): an engine that starts makes it again,"
        " and so does `madrob recover`"
    )
