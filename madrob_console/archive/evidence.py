"""The evidence of a run on disk: repairs, account and size; nothing is scored from it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import msgspec

from madrob_console.archive.file_digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE, run_folder_names
from madrob_console.archive.run_journal import UnusableJournalError, journal_held, read_run_journal
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import free_space
from madrob_console.common.formatting import format_size
from madrob_console.referee.evidence_account import CUT_OFF, EvidenceAccount
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from recorder import RecorderError
from recorder.bag import is_evidence, is_left_of_evidence
from recorder.reader import natural_order

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
    from recorder.evidence import summarised  # few runs need it

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


def evidence_held(results: Path) -> int:
    """Bytes of the evidence of all runs, practice and official, with what repairs have left."""
    held = 0
    for name in run_folder_names(results):
        with suppress(OSError), os.scandir(results / name) as entries:
            for entry in entries:
                if is_left_of_evidence(entry.name):
                    held += entry.stat(follow_symlinks=False).st_size
    return held
