"""The evidence of a run on disk, and which of it may be deleted; nothing is scored from it."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from madrob_console.archive.file_digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE, run_folder_names
from madrob_console.archive.history import History
from madrob_console.archive.run_journal import (
    RunJournal,
    UnusableJournalError,
    ever_protested,
    is_held,
    journal_held,
    read_run_journal,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import free_space, locked_by_another, open_plain, opened_folder
from madrob_console.common.formatting import format_size, time_words
from madrob_console.referee.evidence_account import CUT_OFF, EvidenceAccount
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_summary import RunSummary
from recorder.bag import is_evidence, is_left_of_evidence
from recorder.errors import RecorderError
from recorder.reader import natural_order
from recorder.survey import listing, put_listing, remove_metadata_parts

_LEFT_FREE = 1_000_000_000
"""Room that a repair leaves to the score, bytes: twice what `checks.disk_space` asks for."""


def repair_evidence(folder: Path) -> bool:
    """Repair the evidence of a run that was cut off; returns whether it wrote.

    A run that goes on is left alone. Evidence that `metadata.yaml` lists is not opened.

    Raises:
        MadrobError: it cannot be repaired: the copy of a file would take room that the score needs.
    """
    try:
        names = [name for name in os.listdir(folder) if is_evidence(name)]  # noqa: PTH208
    except OSError:
        return False  # the history says what is wrong with it
    torn = set(names) - set(listed_in(folder))
    if not torn or is_held(folder / JOURNAL_FILE):
        return False
    from recorder.recovery import recover_evidence  # few runs need it

    try:
        needed = max((folder / name).stat().st_size for name in torn) + _LEFT_FREE
        if (free_space(folder) or 0) < needed:
            raise MadrobError(
                f"{folder.name}: its evidence was cut off: free {format_size(needed)} on the disk, "
                "then `madrob recover` repairs it"
            )
        return any(file.changed for file in recover_evidence(folder))
    except OSError as error:
        raise MadrobError(f"{folder.name}: its evidence cannot be read: {error.strerror}") from None
    except RecorderError as error:
        raise MadrobError(str(error)) from None


def evidence_account_of(folder: Path, run: Run) -> EvidenceAccount | None:
    """The journal's account of the evidence; without one, the folder's."""
    if run.evidence is not None or run.removed_evidence:
        return run.evidence
    with suppress(OSError):
        if any(map(is_evidence, os.listdir(folder))):  # noqa: PTH208
            return CUT_OFF
    return None


def settled_account(folder: Path, account: EvidenceAccount) -> EvidenceAccount | None:
    """The account of complete evidence files, by their summaries; None while one is incomplete.

    `account` is the account while they were written.
    """
    from recorder.survey import summarised  # few runs need it

    counts: dict[str, tuple[str, int]] = {}
    problems: list[str] = []
    size = 0
    folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        evidence_files = filter(is_left_of_evidence, os.listdir(folder_fd))  # noqa: PTH208
        names = sorted(evidence_files, key=natural_order)
        for name in names:
            try:
                of_file = os.stat(name, dir_fd=folder_fd, follow_symlinks=False).st_size
            except FileNotFoundError:  # a repair ended meanwhile
                return None
            if not is_evidence(name):
                problems.append(f"{name} is left of a repair, {of_file / 1e6:.1f} MB")
                continue
            if (file := summarised(folder_fd, name)) is None:
                return None
            size += of_file
            for topic in file.topics:
                before = counts.get(topic.name, ("", 0))[1]
                counts[topic.name] = topic.type, before + file.counts.get(topic.name, 0)
    finally:
        os.close(folder_fd)
    return account.settled(counts, problems, size) if any(map(is_evidence, names)) else None


def settle_account(folder: Path, now: float) -> bool:
    """Journal what is in a run's evidence, if that was still being written.

    `now` is in s since the epoch. A run on which somebody works is left alone. Returns whether a
    line was written: then its result may be out of date.
    """
    try:
        names = os.listdir(folder)  # noqa: PTH208
        if not any(map(is_evidence, names)) or _unsettled(folder) is None:
            return False
        with journal_held(folder) as journal:
            unsettled = _unsettled(folder)
            account = None if unsettled is None else settled_account(folder, unsettled)
            if account is None:
                return False
            if not journal.append([account_entry(account, now)]):
                assert journal.refused is not None
                raise MadrobError(f"{folder}: {refusal_words(journal.refused)}")
            return True
    except (FileNotFoundError, NotADirectoryError, BlockingIOError, UnusableJournalError):
        return False  # the history says what is wrong with it
    except OSError as error:
        raise MadrobError(f"{folder}: cannot be written ({error.strerror})") from None


def _unsettled(folder: Path) -> EvidenceAccount | None:
    """The account, if the journal has no final one of the evidence."""
    run = read_run_journal(folder).run
    over = run.phase in (Phase.STOPPED, Phase.FINAL)
    account = evidence_account_of(folder, run) if over else run.evidence
    return None if account is None or account.unwritten == 0 else account


def account_entry(account: EvidenceAccount, now: float) -> Entry:
    """A later line replaces it. `now` is in s since the epoch."""
    details = msgspec.to_builtins(account)
    what = Change.EVIDENCE_RECORDED.value
    return Entry(now, Origin.SYSTEM, what, reason=account.words, details=details)


# The size of the evidence in a results folder.


def evidence_held(results: Path) -> int:
    """Bytes of the evidence of all runs, practice and official, with what repairs have left."""
    held = 0
    for name in run_folder_names(results):
        with suppress(OSError), os.scandir(results / name) as entries:
            for entry in entries:
                if is_left_of_evidence(entry.name):
                    held += entry.stat(follow_symlinks=False).st_size
    return held


# Deleting evidence to make room. No score depends on evidence.


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

    `why_kept` is the reason why it stays; empty = it may go.
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
    evidence: list[RunEvidence] = []
    for run in runs:
        folder = root / run.folder
        if (files := _files(folder)) is None:
            continue
        one = RunEvidence(folder, run, tuple(files), sum(files.values()))
        why_kept = (
            _why_never_removed(one, newest[run.folder])
            or _within(limits, one, newest, now)
            or _may_be_protested(folder, now)
        )
        if not why_kept and limits.until_free is not None and free >= limits.until_free:
            why_kept = "there is room enough"
        free += 0 if why_kept else one.size
        evidence.append(replace(one, why_kept=why_kept))
    return evidence


def run_going_on(root: Path) -> str | None:
    """The folder of a run that is being recorded."""
    open_ones = (run.folder for run in History(root).refresh() if run.outcome is None)
    return next((name for name in open_ones if is_held(root / name / JOURNAL_FILE)), None)


def remove_evidence(of: RunEvidence, now: float) -> None:
    """Remove the evidence of a run for good; its journal says so first.

    The bag stops listing it first, so a kill at any moment leaves a bag that every reader opens.
    Called again, it goes on where it was cut off. `now` is in s since the epoch.
    """
    folder = of.folder
    try:
        with (
            journal_held(folder) as journal,
            opened_folder(folder.parent, folder.name) as folder_fd,
        ):
            journalled = read_run_journal(folder)
            why = _why_not_now(of, journalled) or _protest_words(journalled.run, now)
            if why:
                raise MadrobError(f"{folder}: {why}: nothing of it was removed")
            files = _files(folder) or {}
            _list_without(folder, folder_fd, files, check_only=True)
            if not _says_removed(journalled, files):
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


def _why_never_removed(one: RunEvidence, place: int) -> str:
    """Why the evidence stays whatever the limits; empty = it need not."""
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
    """Why the evidence stays by the limits; empty = it does not."""
    if newest[one.run.folder] <= limits.keep_runs:
        kind = "practice runs" if one.run.practice else "runs"
        return f"it is one of the last {limits.keep_runs} {kind}"
    if now - one.run.started <= limits.older_than:
        return "it is not old enough"
    return ""


_FRESH = 1800.0
"""A result that was signed in the last so many s may still be protested."""


def _may_be_protested(folder: Path, now: float) -> str:
    """Why the evidence stays while a protest may come; empty = it may go."""
    try:
        return _protest_words(read_run_journal(folder).run, now)
    except (UnusableJournalError, OSError) as error:
        return str(error)


def _protest_words(run: Run, now: float) -> str:
    if run.signed is None or now > (until := run.signed + _FRESH):
        return ""
    return f"a protest is possible until {time_words(until)}"


def _is_recorded(one: RunEvidence) -> bool:
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


def _why_not_now(of: RunEvidence, journal: RunJournal) -> str:
    """Why the evidence stays by the journal as it is now, locked; empty = it need not."""
    if journal.run.phase is not Phase.FINAL and not of.run.practice:
        return "its result is not final any more"
    return "it was protested" if ever_protested(of.folder) else ""


def _says_removed(journal: RunJournal, files: Iterable[str]) -> bool:
    """Whether the journal already says that these files are removed: a removal was cut off."""
    removed: Sequence[object] = ()
    for entry in journal.entries:
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
