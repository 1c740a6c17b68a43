"""Deletes the evidence of old runs to make room. No score depends on evidence."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.archive.file_digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.history import History
from madrob_console.archive.run_journal import (
    RunJournal,
    UnusableJournalError,
    ever_protested,
    journal_held,
    read_run_journal,
)
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import locked_by_another
from madrob_console.common.formatting import time_words
from madrob_console.common.plain_files import open_plain, opened_folder
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_summary import RunSummary
from recorder.bag import is_left_of_evidence
from recorder.listing import listing, put_listing, remove_metadata_parts


@dataclass(frozen=True, slots=True)
class TidyLimits:
    """How much evidence stays beside what always stays.

    Attributes:
        keep_runs: that of so many newest runs; of official and practice runs each.
        older_than: that of runs of the last so many s.
        until_free: what is left once so many bytes of the disk are free; the oldest goes first.
    """

    keep_runs: int = 0
    older_than: float = 0.0
    until_free: float | None = None


@dataclass(frozen=True, slots=True)
class RunEvidence:
    """The evidence files of a run and what repairs have left of them; `size` in bytes.

    `why_kept` says why it stays; empty = it may go.
    """

    folder: Path
    run: RunSummary
    files: tuple[str, ...]
    size: int
    why_kept: str = ""


def evidence_at(root: Path, limits: TidyLimits, now: float, free: float) -> list[RunEvidence]:
    """All evidence, oldest run first; `now` in s since the epoch, `free` bytes of the disk."""
    runs = History(root).refresh()
    newest: dict[str, int] = {}
    for practice in (True, False):
        kind = [run.folder for run in runs if run.practice is practice]
        newest |= {folder: place for place, folder in enumerate(reversed(kind), start=1)}
    all_evidence: list[RunEvidence] = []
    for run in runs:
        folder = root / run.folder
        if (files := _files(folder)) is None:
            continue
        evidence = RunEvidence(folder, run, tuple(files), sum(files.values()))
        why = (
            _why_always_kept(evidence, newest[run.folder])
            or _why_within(limits, evidence, newest, now)
            or _why_protestable(folder, now)
        )
        if not why and limits.until_free is not None and free >= limits.until_free:
            why = "there is room enough"
        free += 0 if why else evidence.size
        all_evidence.append(replace(evidence, why_kept=why))
    return all_evidence


def run_going_on(root: Path) -> str | None:
    """The folder of a run that is being recorded."""
    open_ones = (run.folder for run in History(root).refresh() if run.outcome is None)
    return next((name for name in open_ones if is_held(root / name / JOURNAL_FILE)), None)


def remove_evidence(evidence: RunEvidence, now: float) -> None:
    """Remove the evidence of a run for good; its journal says so first.

    The bag stops listing it first, so a kill at any moment leaves a bag that every reader opens.
    Called again, it goes on where it was cut off. `now` is in s since the epoch.
    """
    folder = evidence.folder
    try:
        with (
            journal_held(folder) as journal,
            opened_folder(folder.parent, folder.name) as folder_fd,
        ):
            recorded = read_run_journal(folder)
            why = _why_not_now(evidence, recorded) or _protest_words(recorded.run, now)
            if why:
                raise MadrobError(f"{folder}: {why}: nothing of it was removed")
            files = _files(folder) or {}
            _list_without(folder, folder_fd, files, check_only=True)
            if not _is_journalled(recorded, files):
                details = {"files": sorted(files), "bytes": sum(files.values())}
                entry = Entry(now, Origin.SYSTEM, Change.EVIDENCE_REMOVED, details=details)
                if not journal.append([entry]):
                    assert journal.refused is not None
                    why = refusal_words(journal.refused)
                    raise MadrobError(f"{folder}: {why}: nothing of it was removed")
            remove_metadata_parts(folder_fd)
            _list_without(folder, folder_fd, files)
            for name in files:
                os.unlink(name, dir_fd=folder_fd)
            os.fsync(folder_fd)
    except UnusableJournalError as error:
        raise MadrobError(f"{folder}: {error}") from None
    except BlockingIOError:
        raise MadrobError(f"{folder}: a console works on this run: leave it there") from None
    except OSError as error:
        raise MadrobError(
            f"{folder}: its evidence cannot be removed ({error.strerror}): check the disk and the "
            "folder's permissions, then try again"
        ) from None


def _files(folder: Path) -> dict[str, int] | None:
    sizes: dict[str, int] = {}
    try:
        names = os.listdir(folder)  # noqa: PTH208  of the names only
    except OSError:
        return None
    for name in filter(is_left_of_evidence, names):
        try:
            state = (folder / name).lstat()
        except OSError:
            continue
        if stat.S_ISREG(state.st_mode):
            sizes[name] = state.st_size
    return sizes or None


def _why_always_kept(evidence: RunEvidence, place: int) -> str:
    """Why the evidence stays whatever the limits; empty = it need not."""
    run = evidence.run
    if run.problem is not None:
        return f"its result cannot be used: {run.problem}"
    if is_held(evidence.folder / JOURNAL_FILE):
        return "the run goes on" if run.outcome is None else "a console works on it"
    if _is_recorded(evidence):
        return "it is still recorded"
    if run.outcome is None:
        return "it has no result"
    if not (evidence.folder / JOURNAL_FILE).is_file():
        return "it has no journal, which has to say so"
    if run.protested or ever_protested(evidence.folder):
        return "it was protested"
    if not (run.final or run.practice):  # practice counts for nothing: nobody signs it
        return "its result is not final"
    if place == 1:
        return "it is the last practice run" if run.practice else "it is the last run"
    return ""


def _why_within(
    limits: TidyLimits, evidence: RunEvidence, newest: dict[str, int], now: float
) -> str:
    """Why the evidence stays by the limits; empty = it does not."""
    if newest[evidence.run.folder] <= limits.keep_runs:
        kind = "practice runs" if evidence.run.practice else "runs"
        return f"it is one of the last {limits.keep_runs} {kind}"
    if now - evidence.run.started <= limits.older_than:
        return "it is not old enough"
    return ""


_FRESH = 1800.0
"""A result that was signed in the last so many s may still be protested."""


def _why_protestable(folder: Path, now: float) -> str:
    """Why the evidence stays while a protest may come; empty = it may go."""
    try:
        return _protest_words(read_run_journal(folder).run, now)
    except (UnusableJournalError, OSError) as error:
        return str(error)


def _protest_words(run: Run, now: float) -> str:
    if run.signed is None or now > (until := run.signed + _FRESH):
        return ""
    return f"a protest is possible until {time_words(until)}"


def _is_recorded(evidence: RunEvidence) -> bool:
    for name in evidence.files:
        try:
            file = open_plain(evidence.folder / name)
        except OSError:
            continue
        try:
            if locked_by_another(file):
                return True
        finally:
            os.close(file)
    return False


def _why_not_now(evidence: RunEvidence, recorded: RunJournal) -> str:
    """Why the evidence stays by the journal as it is now, locked; empty = it need not."""
    if recorded.run.phase is not Phase.FINAL and not evidence.run.practice:
        return "its result is not final any more"
    return "it was protested" if ever_protested(evidence.folder) else ""


def _is_journalled(recorded: RunJournal, files: Iterable[str]) -> bool:
    """Whether the journal already says that these files are removed: a removal was cut off."""
    removed: Sequence[object] = ()
    for entry in recorded.entries:
        if entry.what == Change.EVIDENCE_REMOVED:
            removed = entry.details["files"]
    return set(files) <= set(map(str, removed))


def _list_without(
    folder: Path, folder_fd: int, files: Iterable[str], *, check_only: bool = False
) -> None:
    """List a bag's files without some.

    Where its recording is torn they must not be listed: MadrobError if that cannot be changed.
    """
    without = frozenset(files)
    make = listing if check_only else put_listing
    if make(folder_fd, None, without) is None and without & set(listed_in(folder)):
        raise MadrobError(
            f"{folder}: its recording is not whole: `madrob recover` repairs it: "
            "nothing of its evidence was removed"
        )
