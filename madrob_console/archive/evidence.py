"""The evidence of a run on disk: cameras and other topics, from which nothing is scored."""

from __future__ import annotations

import os
from contextlib import suppress
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
from madrob_console.clock import seconds
from madrob_console.errors import MadrobError
from madrob_console.referee.evidence_account import CUT_OFF, EvidenceAccount
from madrob_console.referee.journal import Entry, Origin, refusal_words
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase, Run
from recorder.bag import is_evidence, is_left_of_evidence
from recorder.errors import RecorderError
from recorder.reader import natural_order


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


def evidence_told(folder: Path, run: Run) -> EvidenceAccount | None:
    """What a run's journal says of its evidence; where it says nothing, what its folder does.

    Args:
        folder: of the run.
        run: as its journal tells it.
    """
    if run.evidence is not None or run.removed_evidence:
        return run.evidence
    with suppress(OSError):
        if any(map(is_evidence, os.listdir(folder))):  # noqa: PTH208
            return CUT_OFF
    return None


def settled_account(
    folder: Path, told: EvidenceAccount, start: float | None
) -> EvidenceAccount | None:
    """What is in a run's files of evidence, by their summaries; None while one is not whole.

    Args:
        folder: of the run.
        told: its account while they were still being written.
        start: of the run, s since the epoch; None = unknown.

    Raises:
        OSError: the folder cannot be read.
    """
    from recorder.listing import summarised  # few runs need it

    counts: dict[str, tuple[str, int]] = {}
    problems: list[str] = []
    spans: list[tuple[float, float]] = []
    size = 0
    folder_fd = os.open(folder, os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        found = filter(is_left_of_evidence, os.listdir(folder_fd))  # noqa: PTH208
        names = sorted(found, key=natural_order)
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
            if start is not None and file.start_ns is not None and file.end_ns is not None:
                spans.append((_since(file.start_ns, start), _since(file.end_ns, start)))
            for topic in file.topics:
                before = counts.get(topic.name, ("", 0))[1]
                counts[topic.name] = topic.type, before + file.counts.get(topic.name, 0)
    finally:
        os.close(folder_fd)
    return told.settled(counts, problems, spans, size) if any(map(is_evidence, names)) else None


def _since(time_ns: int, start: float) -> float:
    return round(seconds(time_ns) - start, 2)


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
            account = None if told is None else settled_account(folder, *told)
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


def _unsettled(folder: Path) -> tuple[EvidenceAccount, float | None] | None:
    """What a journal says of evidence that was still being written, or does not; and the start."""
    run = read_run_journal(folder).run
    over = run.phase in (Phase.STOPPED, Phase.FINAL)
    told = evidence_told(folder, run) if over else run.evidence
    return None if told is None or told.unwritten == 0 else (told, run.start)


def account_entry(account: EvidenceAccount, now: float) -> Entry:
    """The line of a journal that says what was recorded; the last one counts.

    Args:
        account: of the evidence.
        now: s since the epoch.
    """
    details = msgspec.to_builtins(account)
    what = Change.EVIDENCE_RECORDED.value
    return Entry(now, Origin.SYSTEM, what, reason=account.words, details=details)
