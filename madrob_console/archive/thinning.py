"""Room on the disk: which runs' evidence may go, and its removal. No score hangs on evidence."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.archive.digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.history import History, RunSummary, time_words
from madrob_console.archive.run_journal import (
    RunJournal,
    UnusableJournalError,
    ever_protested,
    journal_held,
    read_run_journal,
)
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.files.held import locked_by_another
from madrob_console.files.plain import open_plain, opened_folder
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.protests import USUAL_PROTEST_TIMES
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from recorder.bag import is_left_of_evidence
from recorder.listing import listing, put_listing, remove_metadata_parts


@dataclass(frozen=True, slots=True)
class TidyLimits:
    """How much evidence is to stay beside what always stays.

    Attributes:
        keep_runs: that of so many runs, the newest ones; of official and practice runs each.
        older_than: that of runs of the last so many s.
        until_free: what is left once so many bytes of the disk are free; the oldest goes first.
        filing: that of runs signed in the last so many s: a protest may come.
    """

    keep_runs: int = 0
    older_than: float = 0.0
    until_free: float | None = None
    filing: float = USUAL_PROTEST_TIMES.filing


@dataclass(frozen=True, slots=True)
class RunEvidence:
    """The evidence of one run.

    Attributes:
        folder: of the run.
        run: what the history says of it.
        files: names of the evidence in it, and of what repairs have left of evidence.
        size: of them, bytes.
        kept: why it stays, in words; empty = it may go.
    """

    folder: Path
    run: RunSummary
    files: tuple[str, ...]
    size: int
    kept: str = ""


def evidence_at(root: Path, limits: TidyLimits, now: float, free: float) -> list[RunEvidence]:
    """The evidence of all runs of a results folder, oldest run first, and what of it stays.

    Args:
        root: the results folder.
        limits: what is to stay.
        now: s since the epoch.
        free: bytes that are free on its disk.

    Raises:
        MadrobError: the folder cannot be read.
    """
    runs = History(root).refresh()
    newest: dict[str, int] = {}
    for practice in (True, False):
        kind = [run.folder for run in runs if run.practice is practice]
        newest |= {folder: place for place, folder in enumerate(reversed(kind), start=1)}
    found: list[RunEvidence] = []
    for run in runs:
        folder = root / run.folder
        if (files := _files(folder)) is None:
            continue
        one = RunEvidence(folder, run, tuple(files), sum(files.values()))
        kept = (
            _always_kept(one, newest[run.folder])
            or _within(limits, one, newest, now)
            or _may_be_protested(folder, limits.filing, now)
        )
        if not kept and limits.until_free is not None and free >= limits.until_free:
            kept = "there is room enough"
        free += 0 if kept else one.size
        found.append(replace(one, kept=kept))
    return found


def run_going_on(root: Path) -> str | None:
    """The folder of a run of a results folder that is recorded just now; None = there is none.

    Raises:
        MadrobError: the folder cannot be read.
    """
    open_ones = (run.folder for run in History(root).refresh() if run.outcome is None)
    return next((name for name in open_ones if is_held(root / name / JOURNAL_FILE)), None)


def remove_evidence(
    of: RunEvidence, now: float, filing: float = USUAL_PROTEST_TIMES.filing
) -> None:
    """Remove the evidence of a run for good; its journal says so first.

    The bag lists it no more before it goes: a kill at any moment leaves a bag that every reader
    opens. Done again, it goes on where it was cut off.

    Args:
        of: a run whose evidence may go.
        now: s since the epoch.
        filing: as in `TidyLimits`.

    Raises:
        MadrobError: somebody works on the run or did so since, or the disk refuses.
    """
    folder = of.folder
    try:
        with (
            journal_held(folder) as journal,
            opened_folder(folder.parent, folder.name) as folder_fd,
        ):
            known = read_run_journal(folder)
            why = _why_not_now(of, known) or _protest_words(known.run, filing, now)
            if why:
                raise MadrobError(f"{folder}: {why}: nothing of it was removed")
            files = _files(folder) or {}
            _list_without(folder, folder_fd, files, check_only=True)
            if not _is_told(known, files):
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
    """Names and sizes of the evidence of a run; None where there is none."""
    found: dict[str, int] = {}
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
            found[name] = state.st_size
    return found or None


def _always_kept(one: RunEvidence, place: int) -> str:
    """Why the evidence of a run stays whatever is asked for; empty = it need not."""
    run = one.run
    if run.problem is not None:
        return f"its result cannot be used: {run.problem}"
    if is_held(one.folder / JOURNAL_FILE):
        return "the run goes on" if run.outcome is None else "a console works on it"
    if _is_recorded(one):
        return "it is still recorded"
    if run.outcome is None:
        return "it has no result"
    if not (one.folder / JOURNAL_FILE).is_file():
        return "it has no journal, which has to say so"
    if run.protested or ever_protested(one.folder):
        return "it was protested"
    if not (run.final or run.practice):  # practice counts for nothing: nobody signs it
        return "its result is not final"
    if place == 1:
        return "it is the last practice run" if run.practice else "it is the last run"
    return ""


def _within(limits: TidyLimits, one: RunEvidence, newest: dict[str, int], now: float) -> str:
    """Why the evidence of a run is to stay, by what was asked for; empty = it is not."""
    if newest[one.run.folder] <= limits.keep_runs:
        kind = "practice runs" if one.run.practice else "runs"
        return f"it is one of the last {limits.keep_runs} {kind}"
    if now - one.run.started <= limits.older_than:
        return "it is not old enough"
    return ""


def _may_be_protested(folder: Path, filing: float, now: float) -> str:
    """Why the evidence of a signed run stays for the time of protests; empty = that is over."""
    try:
        return _protest_words(read_run_journal(folder).run, filing, now)
    except (UnusableJournalError, OSError) as error:
        return str(error)


def _protest_words(run: Run, filing: float, now: float) -> str:
    if run.signed is None or now > (until := run.signed + filing):
        return ""
    return f"a protest is possible until {time_words(until)}"


def _is_recorded(one: RunEvidence) -> bool:
    """Whether somebody writes, or repairs, the evidence of a run."""
    for name in one.files:
        try:
            file = open_plain(one.folder / name)
        except OSError:
            continue
        try:
            if locked_by_another(file):
                return True
        finally:
            os.close(file)
    return False


def _why_not_now(of: RunEvidence, known: RunJournal) -> str:
    """Why the evidence has to stay by what its journal says now, held; empty = it has not."""
    if known.run.phase is not Phase.FINAL and not of.run.practice:
        return "its result is not final any more"
    return "it was protested" if ever_protested(of.folder) else ""


def _is_told(known: RunJournal, files: Iterable[str]) -> bool:
    """Whether the journal says already that these files are removed: that was cut off."""
    told: Sequence[object] = ()
    for entry in known.entries:
        if entry.what == Change.EVIDENCE_REMOVED:
            told = entry.details["files"]
    return set(files) <= set(map(str, told))


def _list_without(
    folder: Path, folder_fd: int, files: Iterable[str], *, check_only: bool = False
) -> None:
    """List the files of a bag without some; where its recording is torn they must not be listed.

    Raises:
        MadrobError: they are, and that cannot be changed.
        OSError: the disk refuses.
    """
    without = frozenset(files)
    make = listing if check_only else put_listing
    if make(folder_fd, None, without) is None and without & set(listed_in(folder)):
        raise MadrobError(
            f"{folder}: its recording is not whole: `madrob recover` repairs it: "
            "nothing of its evidence was removed"
        )
