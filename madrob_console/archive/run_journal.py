"""What the journal in a run folder says of its run, whatever somebody has put there."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.errors import MadrobError
from madrob_console.files.held import Hold
from madrob_console.files.plain import refusal
from madrob_console.names import terminal_safe
from madrob_console.referee.acts import FileProtest, Finalise
from madrob_console.referee.journal import Entry, Journal, read_journal
from madrob_console.referee.journal_mark import mark_of
from madrob_console.referee.on_record import TeamWord
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.run import Run


class UnusableJournalError(MadrobError):
    """A journal that says nothing about a run."""


_OF_A_RUN = (Change.COUNTDOWN_BEGINS, Change.RUN_STARTS, Change.RUN_STOPS)
"""Lines that only a run has that began."""


@dataclass(frozen=True, slots=True)
class RunJournal:
    """A journal as it was read.

    Attributes:
        entries: its lines.
        run: the state after all of them, with the journal's mark; the handle zero is not in it.
    """

    entries: tuple[Entry, ...]
    run: Run

    @property
    def never_ran(self) -> str:
        """Why there is nothing to score, in words; empty where a run began or nothing is known."""
        if self.run.start is not None or not self.entries:
            return ""
        last = self.entries[-1]
        why = last.reason if last.what == Change.WITHDRAWN else ""
        return f"the run was never started{f': {why}' if why else ''}"


def read_run_journal(folder: Path) -> RunJournal:
    """The journal of a run folder.

    Raises:
        FileNotFoundError: there is none.
        UnusableJournalError: it cannot be used; the message says why and what to do.
    """
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
        return RunJournal(entries, replace(_run_of(entries), journal=mark_of(entries)))
    except FileNotFoundError:
        raise
    except NotADirectoryError as error:  # the file of a bag alone
        raise FileNotFoundError(*error.args) from None
    except OSError as error:
        raise _unusable(f"cannot be read ({refusal(error)})") from None
    except MadrobError as error:
        raise _unusable(f"is damaged ({error})") from None
    except Exception as error:  # noqa: BLE001  whatever it is, it is this run's and no other's
        raise _unusable(f"is damaged ({type(error).__name__})") from None


@contextmanager
def journal_held(folder: Path, hold: Hold | None = None) -> Iterator[Journal]:
    """The journal of a run, to be gone on with, on which nobody else works meanwhile.

    Args:
        folder: of the run.
        hold: of the caller on the run; None = there is none yet.

    Raises:
        BlockingIOError: somebody does.
        OSError: there is none, or it cannot be written.
    """
    journal = Journal(hold)
    journal.reopen(folder / JOURNAL_FILE)
    try:
        yield journal
    finally:
        journal.close()


def ever_protested(folder: Path) -> bool:
    """Whether a team ever protested against a run, whatever became of it.

    A journal that cannot be used does not say: then somebody may have.
    """
    try:
        entries, _ = read_journal(folder / JOURNAL_FILE)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return any(
        entry.what == FileProtest.name
        or (entry.what == Finalise.name and entry.details.get("team_word") == TeamWord.PROTESTED)
        for entry in entries
    )


def evidence_removed(folder: Path) -> str:
    """When the evidence of a run was removed, in words; empty = it was not, or nobody knows."""
    try:
        return read_run_journal(folder).run.evidence_removed(_utc)
    except (UnusableJournalError, OSError):
        return ""


def _utc(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(at))


def _run_of(entries: tuple[Entry, ...]) -> Run:
    """The state after all lines.

    Raises:
        MadrobError: one is damaged, or it is missing that set the run up or started it.
    """
    run = rebuild(entries)
    if run.start is None and any(entry.what in _OF_A_RUN for entry in entries):
        raise MadrobError("the line of its set-up or of its start cannot be read")
    return run


def _unusable(what: str) -> UnusableJournalError:
    words = f"{JOURNAL_FILE} {what}: put it away, and `madrob score` goes by the recording's own"
    return UnusableJournalError(terminal_safe(words))
