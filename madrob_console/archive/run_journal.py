"""Reads the journal of a run on disk, which may be damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.common.plain_files import refusal
from madrob_console.referee.acts import FileProtest, Finalise
from madrob_console.referee.journal import Entry, Journal, read_journal
from madrob_console.referee.rebuild import Change, mark_of, rebuild
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Run


class UnusableJournalError(MadrobError):
    """A journal that cannot be used."""


_OF_A_RUN = (Change.COUNTDOWN_BEGINS, Change.RUN_STARTS, Change.RUN_STOPS)


@dataclass(frozen=True, slots=True)
class RunJournal:
    """A journal as read; `run` has all lines and the journal's mark, but no handle zero."""

    entries: tuple[Entry, ...]
    run: Run

    @property
    def never_ran(self) -> str:
        """Why there is nothing to score; empty where a run began or nothing is known."""
        if self.run.start is not None or not self.entries:
            return ""
        last = self.entries[-1]
        why = last.reason if last.what == Change.WITHDRAWN else ""
        return f"the run was never started{f': {why}' if why else ''}"


def read_run_journal(folder: Path) -> RunJournal:
    """The journal of a run folder; FileNotFoundError if there is none."""
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


def recorded_competition(folder: Path) -> str | None:
    """The competition of a run by its journal; None = that does not say."""
    try:
        setup = read_run_journal(folder).run.setup
    except (OSError, UnusableJournalError):
        return None
    return None if setup is None else setup.competition


@contextmanager
def journal_held(folder: Path) -> Iterator[Journal]:
    """Opens a run's journal to append, under its lock.

    Raises:
        BlockingIOError: somebody else works on the run.
    """
    journal = Journal()
    journal.reopen(folder / JOURNAL_FILE)
    try:
        yield journal
    finally:
        journal.close()


def ever_protested(folder: Path) -> bool:
    """Whether a team ever protested, or may have: the journal cannot be used."""
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


def _run_of(entries: tuple[Entry, ...]) -> Run:
    run = rebuild(entries)
    if run.start is None and any(entry.what in _OF_A_RUN for entry in entries):
        raise MadrobError("the line of its set-up or of its start cannot be read")
    return run


def _unusable(what: str) -> UnusableJournalError:
    words = f"{JOURNAL_FILE} {what}: put it away, and `madrob score` goes by the recording's own"
    return UnusableJournalError(terminal_safe(words))
