"""The evidence of a run on disk: cameras and other topics, from which nothing is scored."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from madrob_console.archive.digests import listed_in
from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.run_journal import (
    UnusableJournalError,
    journal_held,
    read_run_journal,
)
from madrob_console.archive.unfinished import is_held
from madrob_console.errors import MadrobError
from madrob_console.referee.evidence_account import EvidenceAccount
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.rebuild import Change
from recorder.bag import is_evidence, is_left_of_evidence
from recorder.errors import RecorderError


def repair_evidence(folder: Path) -> bool:
    """Repair the evidence of a run that was cut off; a run that goes on is left alone.

    Only evidence that `metadata.yaml` does not list is opened: what is listed is whole.

    Returns:
        Whether anything was written.

    Raises:
        MadrobError: the folder cannot be read or written.
    """
    try:
        names = [name for name in os.listdir(folder) if is_evidence(name)]  # noqa: PTH208
    except OSError:
        return False  # the history says what is wrong with it
    if not names or set(names) <= set(listed_in(folder)) or is_held(folder / JOURNAL_FILE):
        return False
    from recorder.recovery import recover_evidence  # few runs need it

    try:
        return any(file.changed for file in recover_evidence(folder))
    except RecorderError as error:
        raise MadrobError(str(error)) from None


def settled_account(folder: Path, told: EvidenceAccount) -> EvidenceAccount | None:
    """What is in a run's files of evidence, by their summaries; None while one is not whole.

    Args:
        folder: of the run.
        told: its account while they were still being written.

    Raises:
        OSError: the folder cannot be read.
    """
    from recorder.listing import summarised  # few runs need it

    counts: dict[str, tuple[str, int]] = {}
    problems: list[str] = []
    folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        names = sorted(filter(is_left_of_evidence, os.listdir(folder_fd)))  # noqa: PTH208
        for name in names:
            if not is_evidence(name):
                size = os.stat(name, dir_fd=folder_fd, follow_symlinks=False).st_size
                problems.append(f"{name} is left of a repair, {size / 1e6:.1f} MB")
                continue
            if (file := summarised(folder_fd, name)) is None:
                return None
            for topic in file.topics:
                before = counts.get(topic.name, ("", 0))[1]
                counts[topic.name] = topic.type, before + file.counts.get(topic.name, 0)
    finally:
        os.close(folder_fd)
    return told.settled(counts, problems) if any(map(is_evidence, names)) else None


def settle_account(folder: Path, now: float) -> bool:
    """Have a run's journal say what is in its evidence, if that was still being written.

    A run on which somebody works is left alone.

    Args:
        folder: of the run.
        now: s since the epoch.

    Returns:
        Whether a line was written: then its result may be out of date.

    Raises:
        MadrobError: the disk refuses.
    """
    try:
        names = os.listdir(folder)  # noqa: PTH208
        if not any(map(is_evidence, names)) or _unsettled(folder) is None:
            return False
        with journal_held(folder) as journal:
            told = _unsettled(folder)
            account = None if told is None else settled_account(folder, told)
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
    """What a journal says of evidence that was still being written."""
    told = read_run_journal(folder).run.evidence
    return None if told is None or told.unwritten == 0 else told


def account_entry(account: EvidenceAccount, now: float) -> Entry:
    """The line of a journal that says what was recorded; the last one counts.

    Args:
        account: of the evidence.
        now: s since the epoch.
    """
    details = msgspec.to_builtins(account)
    what = Change.EVIDENCE_RECORDED.value
    return Entry(now, Origin.SYSTEM, what, reason=account.words, details=details)
